"""Which values of a scan one emitter can have sent, when nobody knows whose they are.

Every combination of as many rows as a position has coordinates, one value each, is solved for
the places that it allows; the other rows say which of those places more values agree with.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.locate.closed_form import closed_form_points
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.locate.problem import Problem
from imm_tdoa.scans import Scans
from imm_tdoa.tracking.rows import Unlabelled

GATE = 4.0  # standard deviations between a place's prediction and a value that may be its own
SEARCHES = 200  # most combinations that are searched for, where there is no closed form


def ranging(measurement: MeasurementModel, time: float, scan: Unlabelled) -> Index:
    """Rows with values that say something of the position alone, no offset shared."""
    d, m = measurement.dims, measurement.size
    heard = np.unique(scan.row[np.isfinite(scan.values)])
    s = measurement.anchors(time, np.ones(m, dtype=bool)).reshape(-1, d)
    s = s[np.isfinite(s).all(axis=-1)]
    near = (s.mean(axis=0) if len(s) else np.zeros(d)) + 0.37
    Hp, Hv = measurement.jacobian(near, np.zeros(d), time)
    good = Hp.any(axis=-1) & ~Hv.any(axis=-1) & (measurement.offset_group < 0)
    return heard[good[heard]]


def seeds_of(
    scan: Unlabelled, columns: Index, d: int, m: int, most: int, among: int | None = None
) -> tuple[Index, int]:
    """Combinations (B, m) of one value in each of d rows, and how many were left out.

    With `among` only of rows among which this one is.
    """
    own = [np.flatnonzero((scan.row == i) & np.isfinite(scan.values)) for i in columns]
    count = np.array([len(k) for k in own])
    some = combinations(range(len(columns)), d)
    chosen = [c for c in some if among is None or among in columns[list(c)]]
    chosen.sort(key=lambda c: np.prod(count[list(c)]))
    seeds, total, left_out = [], 0, 0
    for rows in chosen:
        size = int(np.prod(count[list(rows)]))
        if total + size > most:
            left_out += size
            continue
        total += size
        grid = np.stack(np.meshgrid(*(own[i] for i in rows), indexing="ij"), -1).reshape(-1, d)
        part = np.full((len(grid), m), -1, dtype=np.int64)
        part[:, columns[list(rows)]] = grid
        seeds.append(part)
    if not seeds:
        return np.zeros((0, m), dtype=np.int64), left_out
    return np.concatenate(seeds), left_out


def own_values(measurement: MeasurementModel, scan: Unlabelled, members: Index) -> Array:
    """Values (F, m) of combinations in the measurement's own units; NaN where there is none."""
    if not len(scan.values):
        return np.full(members.shape, np.nan)
    result: Array = np.where(members >= 0, scan.values[members] / measurement.scale, np.nan)
    return result


def places_of(
    measurement: MeasurementModel, time: float, scan: Unlabelled, seeds: Index
) -> tuple[Array, Index]:
    """Places (P, d) that the seeds allow, and the seed (P, m) of each."""
    if not len(seeds):
        return np.zeros((0, measurement.dims)), seeds
    scans = Scans(measurement, np.array([time]), own_values(measurement, scan, seeds)[:, None])
    points = closed_form_points(Problem.of(scans, False, None))
    known = np.isfinite(points).all(axis=-1)
    if known.any():
        return points[known], seeds[np.nonzero(known)[0]]
    few = seeds[:SEARCHES]
    fix = fix_scans(scans.__class__(measurement, scans.times, scans.values[: len(few)]))
    both = [fix.position] if fix.mirror is None else [fix.position, fix.mirror]
    points = np.stack(both, axis=1)
    known = np.isfinite(points).all(axis=-1)
    return points[known], few[np.nonzero(known)[0]]


def supported(
    measurement: MeasurementModel,
    time: float,
    scan: Unlabelled,
    columns: Index,
    places: Array,
    members: Index,
) -> tuple[Index, Array]:
    """Add to each seed the nearest value of every other row; keep the well supported, once each."""
    d = measurement.dims
    needed = d + 1 if len(columns) > d else d
    if not len(places):
        return members[:0], places
    rest = np.zeros_like(places)
    h = measurement.predict(places, rest, time)
    H = measurement.jacobian(places, rest, time)[0]
    R = np.broadcast_to(measurement.noise_covariance(places, rest, time), (*h.shape, h.shape[1]))
    seed = members >= 0
    nu, Rs, C = seed_spread(h, H, R, scan, members)
    variance = np.einsum("fmi,fij,fmj->fm", H, C, H) + np.einsum("fmm->fm", R)
    solved = np.all(np.abs(nu) <= GATE * np.sqrt(np.einsum("fmm->fm", Rs)), axis=-1)
    members = members.copy()
    for i in columns.tolist():
        own = np.flatnonzero((scan.row == i) & np.isfinite(scan.values))
        away = np.abs(scan.values[own] - h[:, i, None])
        nearest = np.argmin(away, axis=-1)
        distance = np.take_along_axis(away, nearest[:, None], axis=-1)[:, 0]
        take = ~seed[:, i] & (distance <= GATE * np.sqrt(variance[:, i]))
        members[take, i] = own[nearest[take]]
    good = solved & (np.count_nonzero(members >= 0, axis=-1) >= needed)
    members, places = members[good], places[good]
    # mirror places of one combination stay apart: each is fitted from its own place
    cell = np.round(places / (1.0 + 0.01 * np.abs(places).max(initial=1.0)))
    _, first = np.unique(np.concatenate([members, cell], axis=1), axis=0, return_index=True)
    first = np.sort(first)
    return members[first], places[first]


def seed_spread(
    h: Array, H: Array, R: Array, scan: Unlabelled, members: Index
) -> tuple[Array, Array, Array]:
    """Innovations (F, m) of seeds, their noise (F, m, m), and how wide (F, d, d) places are.

    `h`, `H` and `R` are what the places predict; rows that are not of the seed count for nothing.
    """
    d, seed = H.shape[-1], members >= 0
    z = np.where(seed, scan.values[members], 0.0)
    nu, Hs, Rs = gaussian.mask_rows(z - h, H, R, seed)
    J = np.swapaxes(Hs, -1, -2) @ np.linalg.solve(Rs, Hs)
    size = np.einsum("fii->fi", J)
    J = J + 1e-9 * np.max(size, axis=-1)[:, None, None] * np.eye(d) + 1e-30 * np.eye(d)
    return nu, Rs, np.linalg.inv(J)
