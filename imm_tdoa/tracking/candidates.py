"""From rows that nobody owns to places that explain some of them: candidate fixes of one scan.

Combinations of values (`imm_tdoa.tracking.combinations`) are fitted to all they have, and judged
by how much likelier their values are from one emitter than from false alarms.
"""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np
from scipy.special import chdtri

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.scans import Scans
from imm_tdoa.tracking.clutter import extent
from imm_tdoa.tracking.combinations import (
    SEARCHES,
    own_values,
    places_of,
    ranging,
    seeds_of,
    supported,
)
from imm_tdoa.tracking.merit import merit
from imm_tdoa.tracking.messages import locate, messages
from imm_tdoa.tracking.rows import Unlabelled

CONTRADICTION = 0.999  # a fix whose chi2 lies beyond this quantile is none
UNLIKELY = -5.0  # log-odds under which a fix is a ghost
SURE = 5.0  # a fix that much likelier than another that shares rows with it displaces it


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
            members = messages(scan, m)
            members = members[locate(measurement, members)]
            if not len(members):
                return Candidates.none(d, m), 0
            return self._fitted(measurement, time, scan, density, members, None), 0
        columns = ranging(measurement, time, scan)
        if len(columns) < d:
            return Candidates.none(d, m), 0
        seeds, left_out = seeds_of(scan, columns, d, m, self.most)
        places, members = places_of(measurement, time, scan, seeds)
        left_out += max(len(seeds) - SEARCHES, 0) if not len(places) else 0
        members, places = supported(measurement, time, scan, columns, places, members)
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
