"""Which of several solutions is the fix, and which other one explains the scans as well."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index, Mask

TIE = 1e-6  # chi2 difference below which two solutions fit equally well
RIVAL = 9.0  # a second solution within this of the best chi2 is a rival
APART = 0.01  # squared distance, in the sharper of the two covariances, that makes it another


def choose(
    points: Array, rank: Array, usable: Mask, information: Array, centre: Array
) -> tuple[Index, Array]:
    """Return the index (B,) of each fit's best solution, and its mirror (B, d) or NaN.

    The best is the usable solution that fits best; of several that fit equally well the one
    nearest the stations, and of several equally near the one with the greatest last coordinate.

    Parameters
    ----------
    points : (B, K, d)
        Solutions, m.
    rank : (B, K)
        What fitting them costs, on the scale of chi2.
    usable : (B, K)
        Which of them are minima that the geometry determines.
    information : (B, K, d, d)
        Inverse position covariance at each; read where usable.
    centre : (B, d)
        Middle of the stations, m.
    """
    cost = np.where(np.isfinite(rank), rank, np.inf)
    cost = np.where(usable | ~np.any(usable, axis=-1, keepdims=True), cost, np.inf)
    least = np.min(cost, axis=-1, keepdims=True)
    tied = cost <= least + TIE * (1.0 + np.abs(least))
    away = np.where(tied, np.linalg.norm(points - centre[:, None, :], axis=-1), np.inf)
    near = np.min(away, axis=-1, keepdims=True)
    tied &= away <= (1.0 + 1e-6) * near
    for axis in reversed(range(points.shape[-1])):
        height = np.where(tied, points[..., axis], -np.inf)
        tied &= height >= np.max(height, axis=-1, keepdims=True) - 1e-6 * near
    best = np.argmax(tied, axis=-1)
    one = np.arange(len(points))
    delta = points - points[one, best][:, None, :]
    distance = np.maximum(
        _squared(delta, information[one, best][:, None]), _squared(delta, information)
    )
    rival: Mask = usable & usable[one, best][:, None] & (distance > APART)
    rival &= cost <= least + RIVAL
    second = np.argmin(np.where(rival, cost, np.inf), axis=-1)
    mirror = np.where(np.any(rival, axis=-1)[:, None], points[one, second], np.nan)
    return best, mirror


def _squared(delta: Array, information: Array) -> Array:
    result: Array = np.einsum("bki,bkij,bkj->bk", delta, information, delta)
    return result
