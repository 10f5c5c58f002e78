"""From what the runs of one scenario come to, to the figures that a user reads."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.study.results.gather import Gathered
from imm_tdoa.study.results.statistics import (
    Interval,
    chi_square_region,
    holm,
    letters,
    mean_interval,
    mean_share_interval,
    mean_square_interval,
    ratio_interval,
    ratio_p,
    share_interval,
)


def per_bank(found: Gathered, bound: Array, confidence: float) -> dict[str, Interval]:
    """Return the figures (B,) of each bank with their intervals.

    Parameters
    ----------
    found : Gathered
        The scenario.
    bound : (T,)
        Least possible mean squared position error of each scan, m², NaN where there is none.
    confidence : float
        Share of intervals that cover.
    """

    def square(name: str) -> Interval:
        m = found.moments[name]
        return mean_square_interval(m.average, m.variance, m.count, confidence, m.skewness)

    hit, delay = found.moments["mode_hit"], found.moments["recognition_delay_s"]
    rmse = square("position_mse").map(np.sqrt)
    nis = ratio_interval(
        found.nis.mean, found.nis.variance, found.nis.covariance, found.nis.count, confidence
    )
    least = _least(found, bound)
    return {
        "position_rmse": rmse,
        "position_error": square("position_error"),
        "velocity_rmse": square("velocity_mse").map(np.sqrt),
        "nees_ratio": square("nees").map(lambda x: x / found.dims),
        "nis_ratio": nis,
        "recognition": mean_share_interval(hit.average, hit.variance, hit.count, confidence),
        "recognition_delay": mean_square_interval(
            delay.average, delay.variance, delay.count, confidence, delay.skewness
        ),
        "failed": share_interval(found.failed, found.runs, confidence),
        "evidence_wins": share_interval(found.wins, found.judged, confidence),
        "evidence_gap": _evidence_gap(found, confidence),
        "bound_ratio": rmse.map(lambda x: x / least),
    }


def _least(found: Gathered, bound: Array) -> Array:
    """Root mean square (B,) of the bound over the scans that each bank is scored in."""
    scored = found.scans["position_square"].count > 0
    count = np.count_nonzero(scored, axis=-1)
    total = np.sum(np.where(scored, bound, 0.0), axis=-1)  # NaN where a scored scan has no bound
    return np.asarray(np.sqrt(np.where(count > 0, total, np.nan) / np.maximum(count, 1)))


def _evidence_gap(found: Gathered, confidence: float) -> Interval:
    """Log-likelihood of each bank over the best on average, nats; paired, at most zero.

    NaN for banks that did not judge the same data as the best: their likelihoods are of
    different things.
    """
    joint = found.evidence
    mean = joint.mean_x - joint.mean_y
    own = np.where(np.diagonal(joint.count) > 0, np.diagonal(joint.mean_x), -np.inf)
    best = int(np.argmax(own))
    column = (slice(None), best)
    dof = found.nis.mean[1]
    same = np.isclose(dof, dof[best], rtol=1e-9) & (joint.count[column] > 0)
    return mean_interval(
        np.where(same, mean[column], np.nan),
        joint.difference_variance[column],
        joint.count[column],
        confidence,
    )


def nees_inside(found: Gathered, confidence: float) -> Array:
    """Share (B,) of the scored scans whose average NEES lies where a consistent filter's does.

    Runs are independent, so the sum over N of them has a chi-square law with N d degrees of
    freedom at any one scan; scans of one run are not, so there is no such law over time.
    """
    scans = found.scans["nees"]
    low, high = chi_square_region(scans.count * found.dims, confidence)
    ratio = scans.mean / found.dims
    known = np.isfinite(ratio)
    with np.errstate(invalid="ignore"):
        inside = known & (ratio >= low) & (ratio <= high)
    count = np.count_nonzero(known, axis=-1)
    return np.where(count > 0, np.count_nonzero(inside, axis=-1) / np.maximum(count, 1), np.nan)


def per_scan(found: Gathered, confidence: float) -> dict[str, Interval]:
    """Return errors and NEES over time (B, T); an interval covers at each scan by itself."""
    result = {}
    for name, kind in (("position_rmse", "position_square"), ("velocity_rmse", "velocity_square")):
        s = found.scans[kind]
        result[name] = mean_square_interval(s.mean, s.variance, s.count, confidence).map(np.sqrt)
    nees = found.scans["nees"]
    region = chi_square_region(nees.count * found.dims, confidence)
    result["nees_ratio"] = Interval(nees.mean / found.dims, *region)
    return result


def shares(counts: Array, confidence: float) -> Interval:
    """Return how often each of r things was chosen (..., r), NaN where nothing was."""
    total = counts.sum(axis=-1, keepdims=True)
    return share_interval(counts, np.broadcast_to(total, counts.shape), confidence)


def compare(found: Gathered, confidence: float) -> tuple[Interval, Array, Array]:
    """Compare every two banks over the same runs.

    Returns
    -------
    ratio : Interval of (B, B)
        RMSE of the row's bank over the column's.
    p, adjusted : (B, B)
        p-values, and the same adjusted for all pairs of the scenario (Holm); NaN on the diagonal.
    """
    j = found.pairs
    ratio = ratio_interval(j.mean, j.variance, j.covariance, j.count, confidence).map(np.sqrt)
    p = ratio_p(j.mean, j.variance, j.covariance, j.count)
    size = len(p)
    upper = np.triu_indices(size, 1)
    adjusted = np.full((size, size), np.nan)
    adjusted[upper] = holm(p[upper])
    adjusted = np.fmax(adjusted, adjusted.T)
    return ratio, np.where(np.eye(size, dtype=bool), np.nan, p), adjusted


def rank(rmse: Array, adjusted: Array, confidence: float) -> tuple[Index, Mask, tuple[str, ...]]:
    """Order banks by error, and say which cannot be told apart.

    Parameters
    ----------
    rmse : (B,)
        NaN comes last.
    adjusted : (B, B)
        p-values adjusted for many comparisons.
    confidence : float
        Told apart are pairs with p below 1 - confidence.

    Returns
    -------
    place : (B,) int
        1 is the smallest error.
    different : (B, B) bool
        Pairs told apart.
    letters : tuple of str
        Banks that share a letter cannot be told apart; "" for a bank without any error.
    """
    order = np.argsort(rmse, kind="stable")
    place = np.empty(len(rmse), dtype=np.int64)
    place[order] = np.arange(1, len(rmse) + 1)
    with np.errstate(invalid="ignore"):
        different: Mask = adjusted < 1.0 - confidence
    known = order[np.isfinite(rmse[order])]
    named = dict(zip(known, letters(different[np.ix_(known, known)]), strict=True))
    return place, different, tuple(named.get(b, "") for b in range(len(rmse)))


def padded(rows: list[Any], size: int) -> Array:
    """Stack arrays (B, T, ...) of different T along a new first axis, NaN at the end."""
    result = []
    for row in rows:
        array = np.asarray(row, dtype=float)
        width = [(0, 0)] * array.ndim
        width[1] = (0, size - array.shape[1])
        result.append(np.pad(array, width, constant_values=np.nan))
    return np.stack(result)
