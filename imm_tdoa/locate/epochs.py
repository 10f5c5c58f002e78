"""Epochs as differences against one station each: what estimators with uncertain receivers take.

Whatever differences a scan holds (arrival times with an unknown emission time, any pairs, rows
missing), their best linear estimate against one station and its covariance say the same about
the emitter. The station heard with the most others is that reference; it comes first.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.locate.merged import Merged
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations


@attrs.frozen(eq=False)
class Epochs:
    """N epochs of up to K stations each, the reference in column 0.

    Attributes
    ----------
    stations : Stations
        The receivers.
    declared : two of (N, S, d)
        Their declared positions and velocities then, m and m/s; NaN where they are not known.
    station : (N, K) int
        Which station each column is; -1 where an epoch has fewer.
    s, vs : (N, K, d)
        The same by column, stations that are not there where the reference is.
    z : (N, k)
        Range differences of columns 1 to K - 1 against column 0, m; with `moving` the range-rate
        differences behind them, m/s. Zero where missing.
    present : (N, k)
        Which of them are known.
    root : (N, k, k)
        L with L L' the covariance of z; rows of missing values are zero.
    position_root, velocity_root : (N, K, d, d) or None
        Likewise of the errors of the receivers' positions and velocities, where declared.
    excess : (N,)
        What rows that repeat others (closed loops) add to chi2, whatever the emitter does.
    rows : (N,) int
        Number of independent rows.
    moving : bool
        Whether range rates are there.
    """

    stations: Stations
    declared: tuple[Array, Array]
    station: Index
    s: Array
    vs: Array
    z: Array
    present: Mask
    root: Array
    position_root: Array | None
    velocity_root: Array | None
    excess: Array
    rows: Index
    moving: bool

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return self.stations.dims

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the emitter."""
        return self.dims * (2 if self.moving else 1)

    def part(self, which: Any) -> Epochs:
        """Return some of the epochs.

        Parameters
        ----------
        which : slice, or array of int or bool
            Which of the N.
        """
        some: dict[str, Any] = {
            name: None if getattr(self, name) is None else getattr(self, name)[which]
            for name in _PER_EPOCH
        }
        s, vs = self.declared
        return attrs.evolve(self, declared=(s[which], vs[which]), **some)

    @classmethod
    def of(cls, scans: Scans) -> Epochs:
        """Return every scan as an epoch, N = those of all targets.

        Parameters
        ----------
        scans : Scans
            Values (..., T, m) of time differences, with or without range-rate differences.

        Raises
        ------
        ValueError
            A measurement of something else, or by more than one set of stations.
        """
        single = scans.apart()
        measurement, times, values = single.measured_at(0), single.times[:, 0], single.values[:, 0]
        time_part, rate_part, stations = _parts(measurement)
        s, vs = (np.broadcast_to(a, (len(values), *a.shape[-2:])) for a in stations.at(times))
        z = values * measurement.scale
        known: Mask = np.isfinite(z) & measurement.independent(np.isfinite(z))
        heard: Mask = np.asarray(np.isfinite(s).all(axis=-1))
        merged = [
            Merged.of(part, times, z[:, rows], known[:, rows], heard)
            for part, rows in (time_part, rate_part)
            if part is not None
        ]
        return cls._arranged(stations, s, vs, merged)

    @classmethod
    def _arranged(cls, stations: Stations, s: Array, vs: Array, merged: list[Merged]) -> Epochs:
        N, S = s.shape[:2]
        one = np.arange(N)
        score = sum(
            np.count_nonzero(m.connected, axis=-1) * (S + 1) ** (len(merged) - 1 - i)
            for i, m in enumerate(merged)
        )
        reference = np.argmax(score, axis=-1)
        joined = [m.connected[one, reference] for m in merged]  # includes the reference
        used = np.any(np.stack(joined), axis=0)
        used[one, reference] = True
        first = np.arange(S) == reference[:, None]
        order = np.argsort(np.where(first, 0, np.where(used, 1, 2)), axis=-1, kind="stable")
        K = max(int(np.count_nonzero(used, axis=-1).max(initial=1)), 2)
        column = order[:, :K]
        there = used[one[:, None], column]
        place = one[:, None]

        def taken(rows: Array) -> Array:  # absent stations stand where the reference does
            chosen = rows[place, np.where(there, column, column[:, :1])]
            return np.where(np.isfinite(chosen), chosen, 0.0)

        z, present, blocks = [], [], []
        excess, rows = np.zeros(N), np.zeros(N, dtype=np.int64)
        for m, together in zip(merged, joined, strict=True):
            known = (together[place, column] & there)[:, 1:] & together[one, reference][:, None]
            x, root, left, count = m.against(column, known)
            z.append(x)
            present.append(known)
            blocks.append(root)
            excess, rows = excess + left, rows + count
        k = len(blocks) * (K - 1)
        root = np.zeros((N, k, k))
        for i, block in enumerate(blocks):
            here = slice(i * (K - 1), (i + 1) * (K - 1))
            root[:, here, here] = block
        errors = []
        for Q in (stations.position_covariance, stations.velocity_covariance):
            errors.append(None if Q is None else square_root(Q)[np.where(there, column, 0)])
        if errors[1] is not None and len(merged) == 1:
            errors[1] = None  # without range rates velocities do not matter
        return cls(
            stations=stations,
            declared=(s, vs),
            station=np.where(there, column, -1),
            s=taken(s),
            vs=taken(vs),
            z=np.concatenate(z, axis=-1),
            present=np.concatenate(present, axis=-1),
            root=root,
            position_root=errors[0],
            velocity_root=errors[1],
            excess=excess,
            rows=rows,
            moving=len(merged) == 2,
        )


_PER_EPOCH = (
    "station",
    "s",
    "vs",
    "z",
    "present",
    "root",
    "position_root",
    "velocity_root",
    "excess",
    "rows",
)


def _parts(measurement: Any) -> tuple[tuple[Any, slice], tuple[Any, slice], Stations]:
    """The model of time differences, that of range-rate differences or None, and the stations."""
    models = getattr(measurement, "models", (measurement,))
    times = tuple(registry.load(name) for name in ("tdoa", "toa"))
    rates = tuple(registry.load(name) for name in ("fdoa", "range-rate"))
    found: list[tuple[Any, slice]] = [(None, slice(0)), (None, slice(0))]
    start = 0
    for model in models:
        kind = 0 if isinstance(model, times) else 1 if isinstance(model, rates) else None
        if kind is None or found[kind][0] is not None:
            names = ", ".join(type(m).__name__ for m in models)
            raise ValueError(
                f"measurement: expected time differences of arrival, with or without range-rate "
                f"differences, got {names}"
            )
        found[kind] = model, slice(start, start + model.size)
        start += model.size
    if found[0][0] is None:
        raise ValueError("measurement: expected time differences of arrival, got range rates only")
    if found[1][0] is not None and found[1][0].stations is not found[0][0].stations:
        raise ValueError("measurement: expected one set of stations for times and range rates")
    return found[0], found[1], found[0][0].stations


def square_root(Q: Array) -> Array:
    """Return L (..., n, n) with L L' = Q, which may be singular."""
    w, V = np.linalg.eigh(Q)
    result: Array = V * np.sqrt(np.maximum(w, 0.0))[..., None, :]
    return result
