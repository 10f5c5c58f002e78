"""How far a set of tracks is from a set of targets: OSPA and GOSPA."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from imm_tdoa import _validate
from imm_tdoa.contract import Array


class Gospa(NamedTuple):
    """GOSPA and its parts: ``distance**order == localisation + missed + false``.

    Attributes
    ----------
    distance : float or (T,)
        The metric, in the unit of the positions.
    localisation : float or (T,)
        Distances of matched pairs to the power of `order`, summed.
    missed, false : float or (T,)
        What targets without a track, and tracks without a target, cost.
    """

    distance: Any
    localisation: Any
    missed: Any
    false: Any


def ospa(x: Any, y: Any, cutoff: float, order: float = 2.0) -> float:
    """Optimal sub-pattern assignment distance between two sets of points.

    Schuhmacher, Vo & Vo, IEEE Trans. Signal Process. 56(8):3447-3457 (2008). The
    mean error per point of the bigger set to the power of `order`, where a point without a
    partner counts as `cutoff`. A metric, never above `cutoff`.

    Parameters
    ----------
    x, y : (n, d), (k, d)
        Points; one with NaN does not exist. Either set may be empty.
    cutoff : float
        c: the most a point may cost, in the unit of the points.
    order : float
        p, 1 or more; infinity gives the largest cost of a point.

    Raises
    ------
    ValueError
        Points of different dimension, infinite ones, a cutoff or order out of range.
    """
    c, p = _parameters(cutoff, order, finite=False)
    X, Y = _points(x, y)
    n = max(len(X), len(Y))
    if n == 0:
        return 0.0
    D = np.minimum(distances(X, Y), c)
    if np.isinf(p):
        return c if len(X) != len(Y) else _bottleneck(D)
    D = D / c  # powers of large distances overflow
    i, j = linear_sum_assignment(D**p)
    total = np.sum(D[i, j] ** p) + abs(len(X) - len(Y))
    return float(c * (total / n) ** (1.0 / p))


def gospa(x: Any, y: Any, cutoff: float, order: float = 2.0, alpha: float = 2.0) -> Gospa:
    """Generalised optimal sub-pattern assignment of targets `x` and tracks `y`.

    Rahmathullah, García-Fernández & Svensson, FUSION 2017, def. 1 and prop. 1. Not averaged
    over the points. With `alpha` 2 it is the cheapest way to match some pairs, each costing its
    distance, and to leave the other points, each costing ``cutoff**order / 2``; a pair as far
    apart as `cutoff` counts as one missed target and one false track. With another `alpha`
    everything that can be matched is, and only the surplus of one set is missed or false.

    Parameters
    ----------
    x : (n, d)
        Targets; one with NaN does not exist.
    y : (k, d)
        Tracks.
    cutoff : float
        c: the most a pair may cost, in the unit of the points.
    order : float
        p, 1 or more and finite.
    alpha : float
        Above 0, at most 2. Only 2 makes missed and false the number of missed and false.

    Raises
    ------
    ValueError
        Points of different dimension, infinite ones, a parameter out of range.
    """
    c, p = _parameters(cutoff, order, finite=True)
    if not _validate.positive("alpha", alpha) <= 2.0:
        raise ValueError(f"alpha: expected a number above 0, at most 2, got {alpha!r}")
    X, Y = _points(x, y)
    D = np.minimum(distances(X, Y), c) / c
    i, j = linear_sum_assignment(D**p)
    pair = D[i, j]
    left = (len(X) - len(pair), len(Y) - len(pair))
    near = pair < 1.0
    if alpha == 2.0:
        far = int(np.count_nonzero(~near))
        left = (left[0] + far, left[1] + far)
        pair = pair[near]
    unit = c**p
    parts = np.array([np.sum(pair**p), left[0] / alpha, left[1] / alpha])
    distance = c * float(parts.sum()) ** (1.0 / p)
    localisation, missed, false = (float(part * unit) for part in parts)
    return Gospa(distance, localisation, missed, false)


def ospa_curve(truth: Any, tracks: Any, cutoff: float, order: float = 2.0) -> Array:
    """OSPA (T,) of each scan.

    Parameters
    ----------
    truth : (M, T, d)
        Where each target is at each scan; NaN where it does not exist.
    tracks : (N, T, d)
        Where each track is; NaN where it does not exist.
    cutoff, order
        As for `ospa`.
    """
    x, y = aligned(truth, tracks)
    scans = range(x.shape[1])
    return np.array([ospa(x[:, k], y[:, k], cutoff, order) for k in scans])


def gospa_curve(
    truth: Any, tracks: Any, cutoff: float, order: float = 2.0, alpha: float = 2.0
) -> Gospa:
    """GOSPA and its parts (T,) of each scan.

    Parameters
    ----------
    truth, tracks
        As for `ospa_curve`.
    cutoff, order, alpha
        As for `gospa`.
    """
    x, y = aligned(truth, tracks)
    each = [gospa(x[:, k], y[:, k], cutoff, order, alpha) for k in range(x.shape[1])]
    return Gospa(*np.array(each).reshape(-1, 4).T)


def aligned(truth: Any, tracks: Any) -> tuple[Array, Array]:
    """Return truth (M, T, d) and tracks (N, T, d) checked.

    Raises
    ------
    ValueError
        No such arrays, or of different scans or axes.
    """
    x = _validate.array("truth", truth, ("M", "T", "d"), finite=False)
    y = _validate.array("tracks", tracks, ("N", "T", "d"), finite=False)
    if x.shape[1:] != y.shape[1:]:
        raise ValueError(
            f"tracks: expected the {x.shape[1]} scans and {x.shape[2]} axes of truth, "
            f"got {y.shape[1]} and {y.shape[2]}"
        )
    return x, y


def distances(x: Array, y: Array) -> Array:
    """Distances (n, k) between points (n, d) and (k, d); NaN where one does not exist."""
    result: Array = np.linalg.norm(x[:, None, :] - y[None, :, :], axis=-1)
    return result


def _parameters(cutoff: float, order: float, *, finite: bool) -> tuple[float, float]:
    c = _validate.positive("cutoff", cutoff)
    if not finite and order == np.inf:
        return c, float(np.inf)
    p = _validate.positive("order", order)
    if p < 1.0:
        raise ValueError(f"order: expected a number of at least 1, got {order!r}")
    return c, p


def _points(x: Any, y: Any) -> tuple[Array, Array]:
    X = _validate.array("x", x, ("n", "d"), finite=False)
    Y = _validate.array("y", y, ("k", "d"), finite=False)
    if X.shape[1] != Y.shape[1]:
        raise ValueError(f"y: expected points of {X.shape[1]} components, got {Y.shape[1]}")
    return X[np.isfinite(X).all(axis=1)], Y[np.isfinite(Y).all(axis=1)]


def _bottleneck(D: Array) -> float:
    """Least largest entry of a complete assignment of the square matrix `D`."""
    levels = np.unique(D)
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high) // 2
        allowed = csr_array((levels[middle] >= D).astype(np.int8))
        matched = maximum_bipartite_matching(allowed)
        low, high = (low, middle) if np.all(matched >= 0) else (middle + 1, high)
    return float(levels[low])
