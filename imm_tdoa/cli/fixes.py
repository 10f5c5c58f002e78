"""A fix per scan of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import metrics
from imm_tdoa.contract import AXES, Array, Mask
from imm_tdoa.locate import Fix, fix_scans
from imm_tdoa.recording import Recording
from imm_tdoa.recording.table import Table
from imm_tdoa.scans import Scans

TOGETHER = 100  # scans located at once
SPEED_STD = 3000.0  # m/s; what is known beforehand of a velocity that range rates are to tell


@attrs.frozen(eq=False)
class Fixes:
    """The fixes of one target: one per scan, at `times` (T,) s."""

    times: Array
    fix: Fix

    @property
    def good(self) -> Mask:
        """Which scans (T,) determined a position."""
        return np.asarray(self.fix.converged) & np.isfinite(self.fix.position).all(axis=-1)

    @property
    def ambiguous(self) -> Mask:
        """Which of them (T,) have a mirror solution."""
        if self.fix.mirror is None:
            return np.zeros(len(self.times), dtype=bool)
        return self.good & np.isfinite(self.fix.mirror).all(axis=-1)

    @property
    def located(self) -> Fix:
        """The good ones among the fixes (N,)."""
        return _rows(self.fix, self.good)

    def errors(self, recording: Recording, target: str) -> tuple[Array, Array]:
        """Errors (T, a) of the position along the truth's axes, NaN where there is none, m.

        And the radius (T,) that the fixes give them with 95 % probability, m.
        """
        true, _ = recording.truth_at(target, self.times)
        axes = recording.truth_scoring.axes or AXES
        i = np.array([k for k in range(recording.dims) if AXES[k] in axes])
        error = np.where(self.good[:, None], (self.fix.position - true)[:, i], np.nan)
        covariance = np.where(
            self.good[:, None, None], self.fix.covariance[:, i[:, None], i], np.nan
        )
        return error, metrics.error_radius(covariance)


def together(found: Mapping[str, Fixes]) -> Fixes:
    """Return the fixes of all targets as those of one."""
    times = np.concatenate([fixes.times for fixes in found.values()])
    return Fixes(times, _joined([fixes.fix for fixes in found.values()]))


def gauss_newton(
    recording: Recording, names: Sequence[str], robust: bool, advance: Callable[[str], None]
) -> tuple[dict[str, Fixes], dict[str, str]]:
    """Locate every scan of the targets `names` by least squares, many scans at once.

    Returns the fixes by target, and why there are none of the other targets. `advance` is
    called with what comes next.
    """
    found: dict[str, Fixes] = {}
    failed: dict[str, str] = {}
    groups: list[dict[str, Scans]] = []
    for name in names:
        try:
            scans = recording.scans(name)
        except ValueError as error:
            failed[name] = str(error)
            continue
        alike = (g for g in groups if _go_together(next(iter(g.values())), scans))
        group = next(alike, None)
        if group is None:
            groups.append({name: scans})
        else:
            group[name] = scans
    moving = recording.range_rate is not None or recording.fdoa is not None
    for group in groups:
        advance(next(iter(group)) if len(group) == 1 else f"{len(group)} targets")
        try:
            fix = _least_squares(list(group.values()), moving, robust)
        except ValueError as error:
            reason = (
                f"no scan has enough rows for a position of its own ({error}); imm-tdoa track "
                f"takes them together"
            )
            failed |= dict.fromkeys(group, reason)
            continue
        first = 0
        for name, scans in group.items():
            found[name] = Fixes(scans.times, _rows(fix, slice(first, first + scans.count)))
            first += scans.count
    return {name: found[name] for name in names if name in found}, failed


def _least_squares(group: Sequence[Scans], moving: bool, robust: bool) -> Fix:
    """Fixes of the scans of targets that share a measurement model, one after another."""
    measurement = group[0].measurement
    times = np.concatenate([scans.times for scans in group])
    values = np.concatenate([scans.values for scans in group])
    std = np.full(measurement.dims, SPEED_STD) if moving else None
    parts = []
    for first in range(0, len(times), TOGETHER):
        some = slice(first, first + TOGETHER)
        pairs = None if group[0].pairs is None else group[0].pairs[some, None]
        single = Scans(measurement, times[some, None], values[some, None, :], pairs)
        how: Any = "student-t" if robust else None
        parts.append(fix_scans(single, moving=moving, velocity_std=std, robust=how))
    return _joined(parts)


def _go_together(a: Scans, b: Scans) -> bool:
    """Whether the scans of two targets may be rows of one batch."""
    return a.pairs is None and b.pairs is None and _same(a.measurement, b.measurement)


def _same(a: Any, b: Any) -> bool:
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, tuple):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if attrs.has(type(a)):
        return all(_same(getattr(a, f.name), getattr(b, f.name)) for f in attrs.fields(type(a)))
    return bool(a == b)


def _rows(fix: Fix, rows: Any) -> Fix:
    """Return some fixes of a batch."""
    some: dict[str, Any] = {}
    for field in attrs.fields(Fix):
        value = getattr(fix, field.name)
        some[field.name] = None if value is None else np.asarray(value)[rows]
    return Fix(**some)


def _joined(parts: list[Fix]) -> Fix:
    """Return the fixes of successive batches as one batch."""

    def every(name: str) -> Any:
        return np.concatenate([np.asarray(getattr(part, name)) for part in parts])

    mirror = None
    if any(part.mirror is not None for part in parts):
        nothing = [np.full(p.position.shape, np.nan) for p in parts]
        mirrors = [n if p.mirror is None else p.mirror for p, n in zip(parts, nothing, strict=True)]
        mirror = np.concatenate(mirrors)
    return Fix(
        position=every("position"),
        velocity=None if parts[0].velocity is None else every("velocity"),
        covariance=every("covariance"),
        converged=every("converged"),
        iterations=every("iterations"),
        chi2=every("chi2"),
        dof=every("dof"),
        mirror=mirror,
    )


def table(found: Mapping[str, Fixes], recording: Recording) -> Table:
    """Return what fixes.csv holds: a row per scan, target by target."""
    parts = [_columns(name, fixes, recording) for name, fixes in found.items()]
    return Table({key: np.concatenate([part[key] for part in parts]) for key in parts[0]})


def _columns(name: str, fixes: Fixes, recording: Recording) -> dict[str, Any]:
    fix, d, good = fixes.fix, recording.dims, fixes.good
    position = np.where(good[:, None], fix.position, np.nan)
    sigma = np.sqrt(np.einsum("tii->ti", np.where(good[:, None, None], fix.covariance, np.nan)))
    columns: dict[str, Any] = {"time_s": fixes.times, "target": np.full(len(good), name)}
    columns |= {f"{AXES[k]}_m": position[:, k] for k in range(d)}
    columns |= {f"s{AXES[k]}_m": sigma[:, k] for k in range(d)}
    if fix.velocity is not None:
        velocity = np.where(good[:, None], fix.velocity, np.nan)
        columns |= {f"v{AXES[k]}_mps": velocity[:, k] for k in range(d)}
        columns |= {f"sv{AXES[k]}_mps": sigma[:, d + k] for k in range(d)}
    columns["chi2"] = np.where(good, fix.chi2, np.nan)
    columns["dof"] = [str(n) for n in fix.dof]
    columns["converged"] = np.where(good, "true", "false")
    mirror = np.full(position.shape, np.nan) if fix.mirror is None else fix.mirror
    columns |= {f"mirror_{AXES[k]}_m": mirror[:, k] for k in range(d)}
    if recording.frame is not None:
        flat = np.zeros((len(position), 3 - d))
        place = recording.frame.to_geodetic(np.concatenate([position, flat], axis=1))
        columns |= dict(zip(("lat_deg", "lon_deg", "height_m"), place, strict=True))
    return columns
