"""From rows that nobody owns to places that explain some of them: candidate fixes of one scan.

Every combination of as many rows as a position has coordinates, one value each, is solved for
the places that it allows; the other rows say which of those places more values agree with. What
is left is fitted to all its values, and judged by how much likelier they are from one emitter
than from false alarms.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import attrs
import numpy as np
from scipy.special import chdtri

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.locate.closed_form import closed_form_points
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.locate.problem import Problem
from imm_tdoa.scans import Scans
from imm_tdoa.tracking.merit import merit
from imm_tdoa.tracking.rows import Unlabelled

GATE = 4.0  # standard deviations between a place's prediction and a value that may be its own
CONTRADICTION = 0.999  # a fix whose chi2 lies beyond this quantile is none
REGION = 20.0  # times the spread of the stations: how wide the emitters are expected to be
UNLIKELY = -5.0  # log-odds under which a fix is a ghost
SURE = 5.0  # a fix that much likelier than another that shares rows with it displaces it
SEARCHES = 200  # most combinations that are searched for, where there is no closed form


class Candidates(NamedTuple):
    """Places that explain rows of one scan.

    Attributes
    ----------
    position, covariance : (F, d), (F, d, d)
        The places, m.
    members : (F, m)
        Index in the scan of the value of each row; -1 where it has none.
    log_odds : (F,)
        Log of how much likelier its values are from one emitter, anywhere, than false.
    merit : (F,)
        How well it explains its values (`imm_tdoa.tracking.merit`).
    """

    position: Array
    covariance: Array
    members: Index
    log_odds: Array
    merit: Array

    @classmethod
    def none(cls, dims: int, size: int) -> Candidates:
        """No candidates."""
        members = np.zeros((0, size), dtype=np.int64)
        return cls(
            np.zeros((0, dims)), np.zeros((0, dims, dims)), members, np.zeros(0), np.zeros(0)
        )

    def part(self, which: Index | Mask) -> Candidates:
        """Return some of them."""
        return Candidates(
            self.position[which],
            self.covariance[which],
            self.members[which],
            self.log_odds[which],
            self.merit[which],
        )


@attrs.frozen
class Combining:
    """Candidate fixes of one scan.

    Parameters
    ----------
    most : int
        Most combinations of values that are tried in one scan; rows with few values go first.
    detection_probability : float
        Probability that a row of a target is measured.
    """

    most: int = 20000
    detection_probability: float = 0.9

    def __call__(
        self, measurement: MeasurementModel, time: float, scan: Unlabelled, density: Array
    ) -> tuple[Candidates, int]:
        """Return the candidates, and how many combinations were left out.

        Parameters
        ----------
        measurement : MeasurementModel
            What is measured.
        time : float
            Time of the scan, s.
        scan : Unlabelled
            The rows, internal units; with emissions each of them is one combination.
        density : (m,)
            Density of false values of each row.
        """
        d, m = measurement.dims, measurement.size
        if scan.emission is not None:
            members = _by_emission(scan, m)
            if not len(members):
                return Candidates.none(d, m), 0
            return self._fitted(measurement, time, scan, density, members, None), 0
        columns = _ranging(measurement, time, scan)
        if len(columns) < d:
            return Candidates.none(d, m), 0
        seeds, left_out = _seeds(scan, columns, d, m, self.most)
        places, members = _places(measurement, time, scan, seeds)
        left_out += max(len(seeds) - SEARCHES, 0) if not len(places) else 0
        members, places = _supported(measurement, time, scan, columns, places, members)
        if not len(members):
            return Candidates.none(d, m), left_out
        found = self._fitted(measurement, time, scan, density, members, places)
        return _unrivalled(found.part(found.log_odds >= UNLIKELY)), left_out

    def _fitted(
        self,
        measurement: MeasurementModel,
        time: float,
        scan: Unlabelled,
        density: Array,
        members: Index,
        places: Array | None,
    ) -> Candidates:
        """Fit each combination to all its values and judge it."""
        d = measurement.dims
        fix = _fix(measurement, time, scan, members, places)
        loose = scan.emission is None
        agrees = (fix.dof == 0) | (fix.chi2 <= chdtri(np.maximum(fix.dof, 1), 1 - CONTRADICTION))
        good = fix.converged & agrees & np.isfinite(fix.position).all(axis=-1)
        if fix.mirror is not None and not loose:
            good &= _upright(fix.position, fix.mirror)
        position, covariance = fix.position[good], fix.covariance[good][:, :d, :d]
        members, chi2 = members[good], fix.chi2[good]
        if not loose:
            nothing = np.zeros(len(position))
            return Candidates(position, covariance, members, nothing, nothing)
        here = members >= 0
        rest = np.zeros_like(position)
        R = np.broadcast_to(
            measurement.noise_covariance(position, rest, time),
            (len(position), members.shape[1], members.shape[1]),
        )
        own = gaussian.mask_rows(np.zeros(here.shape), np.zeros((*here.shape, 1)), R, here)[2]
        heard = np.isin(np.arange(members.shape[1]), scan.row)
        hit = np.log(self.detection_probability) - np.log(density) - 0.5 * gaussian.LOG_2PI
        miss = np.where(heard, np.log1p(-min(self.detection_probability, 0.999)), 0.0)
        odds = np.sum(np.where(here, hit, miss), axis=-1) - 0.5 * chi2
        odds += 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(own)[1])
        odds += d * (0.5 * gaussian.LOG_2PI - np.log(extent(measurement, time)))
        variance = np.einsum("fmm->m", R) / max(len(R), 1)
        worth = merit(
            chi2,
            fix.dof[good].astype(float),
            here,
            np.broadcast_to(heard, here.shape),
            variance,
            density,
            self.detection_probability,
        )
        return Candidates(position, covariance, members, odds, worth)


def _upright(position: Array, mirror: Array) -> Mask:
    """Which fixes (F,) have no rival, or only their mirror image below ground."""
    alone: Mask = np.asarray(np.isnan(mirror).all(axis=-1))
    if position.shape[-1] < 3:
        return alone
    apart = position - mirror
    up = apart[:, 2] > 0.9 * np.linalg.norm(np.where(np.isnan(apart), 0.0, apart), axis=-1)
    result: Mask = alone | (up & ~alone)
    return result


def extent(measurement: MeasurementModel, time: float) -> float:
    """Width of the region in which emitters are expected, m."""
    d = measurement.dims
    s = measurement.anchors(time, np.ones(measurement.size, dtype=bool)).reshape(-1, d)
    s = s[np.isfinite(s).all(axis=-1)]
    spread = float(np.sqrt(np.mean(np.sum((s - s.mean(axis=0)) ** 2, axis=-1)))) if len(s) else 1.0
    return REGION * max(spread, 1.0)


def _by_emission(scan: Unlabelled, m: int) -> Index:
    """Members (E, m) of the scan's emissions."""
    there = np.flatnonzero(np.isfinite(scan.values))
    names, which = np.unique(scan.emission[there], return_inverse=True)
    members = np.full((len(names), m), -1, dtype=np.int64)
    members[which, scan.row[there]] = there
    return members


def _ranging(measurement: MeasurementModel, time: float, scan: Unlabelled) -> Index:
    """Rows with values that say something of the position alone, no offset shared."""
    d, m = measurement.dims, measurement.size
    heard = np.unique(scan.row[np.isfinite(scan.values)])
    s = measurement.anchors(time, np.ones(m, dtype=bool)).reshape(-1, d)
    s = s[np.isfinite(s).all(axis=-1)]
    near = (s.mean(axis=0) if len(s) else np.zeros(d)) + 0.37
    Hp, Hv = measurement.jacobian(near, np.zeros(d), time)
    good = Hp.any(axis=-1) & ~Hv.any(axis=-1) & (measurement.offset_group < 0)
    return heard[good[heard]]


def _seeds(scan: Unlabelled, columns: Index, d: int, m: int, most: int) -> tuple[Index, int]:
    """Combinations (B, m) of one value in each of d rows, and how many were left out."""
    own = [np.flatnonzero((scan.row == i) & np.isfinite(scan.values)) for i in columns]
    count = np.array([len(k) for k in own])
    chosen = sorted(combinations(range(len(columns)), d), key=lambda c: np.prod(count[list(c)]))
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


def _places(
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


def _supported(
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
    z = np.where(seed, scan.values[members], 0.0)
    nu, Hs, Rs = gaussian.mask_rows(z - h, H, R, seed)
    J = np.swapaxes(Hs, -1, -2) @ np.linalg.solve(Rs, Hs)
    size = np.einsum("fii->fi", J)
    J = J + 1e-9 * np.max(size, axis=-1)[:, None, None] * np.eye(d) + 1e-30 * np.eye(d)
    C = np.linalg.inv(J)
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


def _fix(
    measurement: MeasurementModel,
    time: float,
    scan: Unlabelled,
    members: Index,
    places: Array | None,
) -> Fix:
    values = own_values(measurement, scan, members)[:, None]
    return fix_scans(Scans(measurement, np.array([time]), values), initial=places)


def _unrivalled(found: Candidates) -> Candidates:
    """The candidates that no much likelier one shares values with, the likeliest first."""
    found = found.part(np.argsort(-found.log_odds, kind="stable"))
    kept: list[int] = []
    for f in range(len(found.members)):
        own = found.members[f]
        rival = False
        for k in kept:
            shared = np.any((own == found.members[k]) & (own >= 0))
            same = shared and np.all((own == found.members[k]) | (own < 0))
            near = same and _same_place(found, f, k)
            if (shared and found.log_odds[k] > found.log_odds[f] + SURE) or near:
                rival = True
                break
        if not rival:
            kept.append(f)
    return found.part(np.array(kept, dtype=np.int64))


def _same_place(found: Candidates, f: int, k: int) -> bool:
    delta = found.position[f] - found.position[k]
    C = found.covariance[f] + found.covariance[k]
    return bool(delta @ np.linalg.solve(C, delta) < 9.0)
