"""A fix per complete scan of a recording by Chan & Ho's closed form."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa.cli.fixes import Fixes
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.locate import Fix, chan_ho
from imm_tdoa.recording import Recording
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations


def closed_form(recording: Recording, target: str) -> Fixes:
    """Locate every complete scan of `target` by Chan & Ho's method; the others are failures.

    Raises
    ------
    ValueError
        Moving stations, no time differences, differences without a common reference, no scan
        that has them all.
    """
    if recording.stations.moving:
        raise ValueError(
            "--method chan-ho: expected stations that stand still, these move; use gauss-newton"
        )
    if recording.toa is None and recording.tdoa is None:
        raise ValueError("--method chan-ho: the recording has no time differences of arrival")
    alone = attrs.evolve(recording, range_rate=None, fdoa=None, height=None)
    if recording.toa is not None:
        alone = attrs.evolve(alone, tdoa=None)
    scans = alone.scans(target)
    stations, tdoa, sigma = _complete(scans)
    whole: Mask = np.asarray(np.isfinite(tdoa).all(axis=-1))
    if not np.any(whole):
        raise ValueError(
            f"--method chan-ho: no scan of target {target!r} has all {len(stations)} stations; "
            f"use gauss-newton"
        )
    fix = _empty(len(tdoa), stations.dims, 2)
    for name, value, rows in _groups(scans, sigma, whole):
        found = chan_ho(stations, tdoa[rows], speed=recording.speed_mps, **{name: value})
        fix = _inserted(fix, rows, found)
    mirror = fix.mirror
    if mirror is not None and np.isnan(mirror).all():
        fix = attrs.evolve(fix, mirror=None)
    return Fixes(scans.times, fix)


def _complete(scans: Scans) -> tuple[Stations, Array, str]:
    """Stations, reference first; differences (T, S - 1) against it; which sigma they have."""
    measurement: Any = scans.measurement
    stations: Stations = measurement.stations
    S = len(stations)
    if isinstance(measurement, registry.load("toa")):
        return stations, scans.values[:, 1:] - scans.values[:, :1], "sigma"
    pairs = scans.pairs if scans.pairs is not None else np.asarray(measurement.pairs)[None]
    pairs = np.broadcast_to(pairs, (scans.count, *pairs.shape[-2:]))
    there = np.isfinite(scans.values)
    references = np.unique(pairs[..., 1][there])
    if len(references) != 1:
        raise ValueError(
            "--method chan-ho: expected differences against one common reference station, got "
            f"{len(references)}; use gauss-newton"
        )
    order = np.concatenate([references, np.setdiff1d(np.arange(S), references)])
    place = np.argsort(order)
    tdoa = np.full((scans.count, S), np.nan)
    t, row = np.nonzero(there)
    tdoa[t, place[pairs[t, row, 0]]] = scans.values[t, row]
    arranged = Stations(stations.positions[order], names=tuple(stations.names[i] for i in order))
    own = "toa_sigma" if measurement.toa_sigma is not None else "tdoa_sigma"
    return arranged, tdoa[:, 1:], own


def _groups(scans: Scans, sigma: str, whole: Mask) -> list[tuple[str, Any, Index]]:
    """Standard deviations by the name chan_ho gives them, and the complete scans they hold for."""
    measurement: Any = scans.measurement
    value = np.asarray(getattr(measurement, sigma))
    name = "toa_sigma" if sigma == "sigma" else sigma
    every = np.flatnonzero(whole)
    if measurement.sigma_times is None and value.ndim == 0:
        return [(name, float(value), every)]
    if name == "tdoa_sigma" or measurement.sigma_times is None:
        raise ValueError(
            "--method chan-ho: expected one standard deviation for all rows, or one per arrival; "
            "use gauss-newton"
        )
    at = np.searchsorted(measurement.sigma_times, scans.times[every])
    return [(name, value[k], every[at == k]) for k in np.unique(at)]


def _empty(T: int, d: int, iterations: int) -> Fix:
    return Fix(
        position=np.full((T, d), np.nan),
        velocity=None,
        covariance=np.full((T, d, d), np.nan),
        converged=np.zeros(T, dtype=bool),
        iterations=np.full(T, iterations),
        chi2=np.full(T, np.nan),
        dof=np.zeros(T, dtype=np.int64),
        mirror=np.full((T, d), np.nan),
    )


def _inserted(fix: Fix, rows: Index, part: Fix) -> Fix:
    """Return `fix` with its `rows` replaced by those of `part`."""
    changed: dict[str, Any] = {}
    for name in ("position", "covariance", "converged", "iterations", "chi2", "dof", "mirror"):
        value = getattr(part, name)
        if value is not None:
            changed[name] = np.array(getattr(fix, name))
            changed[name][rows] = value
    return attrs.evolve(fix, **changed)
