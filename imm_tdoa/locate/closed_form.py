"""Places in closed form from pseudo-ranges (Bancroft 1985), to begin a search from."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.locate.problem import Problem
from imm_tdoa.locate.pseudo_ranges import pseudo_ranges

SUBSETS = 40  # most subsets of the stations that a robust search solves
LEAST_HEIGHT = 0.05  # of the spread: how far off a flat array to begin at least


def closed_form_points(problem: Problem, *, robust: bool = False) -> Array:
    """Return points (B, K, d) that solve one scan of ranging rows, NaN where there are none.

    With `robust`, subsets of the stations are solved too, of which some are hoped to be free of
    gross errors.

    References
    ----------
    S. Bancroft, "An algebraic solution of the GPS equations", IEEE Trans. Aerospace and
    Electronic Systems 21(1), 56-59, 1985.
    """
    B, d = len(problem.z), problem.dims
    s, tau, heard = pseudo_ranges(problem)
    most = int(np.max(np.count_nonzero(heard, axis=-1), initial=0))
    if d == 1 or most <= d:
        return np.full((B, 1, d), np.nan)
    chosen = heard[:, None]
    if robust and most > d + 2:
        ordinal = np.maximum(np.cumsum(heard, axis=-1) - 1, 0)
        some = _subsets(most, d + 2)[:, ordinal].swapaxes(0, 1)
        chosen = np.concatenate([chosen, some & heard[:, None]], axis=1)
    M, S = chosen.shape[1:]
    s, tau = np.repeat(s, M, axis=0), np.repeat(tau, M, axis=0)
    return places(s, tau, chosen.reshape(B * M, S)).reshape(B, -1, d)


def places(s: Array, tau: Array, heard: Mask) -> Array:
    """Return up to four places (B, 4, d) where ranges to stations are `tau` plus a constant.

    Two roots of the quadratic that `heard` stations pose, and two places off the plane (2-D:
    line) nearest to them, which the quadratic misses where they lie in it. NaN where fewer than
    d + 1 are heard.

    Parameters
    ----------
    s : (B, S, d)
        Stations, m.
    tau : (B, S)
        Pseudo-ranges, m.
    heard : (B, S)
        Stations that count.
    """
    d = s.shape[-1]
    count = np.count_nonzero(heard, axis=-1)
    share = heard / np.maximum(count, 1)[:, None]
    centre = np.einsum("bs,bsi->bi", share, np.where(heard[..., None], s, 0.0))
    s = np.where(heard[..., None], s - centre[:, None, :], 0.0)
    spread = np.sqrt(np.sum(s**2, axis=(-2, -1)) / np.maximum(count, 1))
    spread = np.where(spread > 0.0, spread, 1.0)
    s, tau = s / spread[:, None, None], tau / spread[:, None]
    tau = tau - np.sum(share * tau, axis=-1, keepdims=True)
    tau = np.where(heard, tau + 1.0, 0.0)  # with a mean of zero the columns would be dependent
    points = np.concatenate([_quadratic(s, tau, heard), _off_plane(s, tau, heard)], axis=-2)
    points = np.where((count > d)[:, None, None], points, np.nan)
    result: Array = centre[:, None, :] + spread[:, None, None] * points
    return result


def _quadratic(s: Array, tau: Array, heard: Mask) -> Array:
    """Two roots (B, 2, d) of s_i' p - tau_i b = (|s_i|² - tau_i²)/2 + L, L = (|p|² - b²)/2."""
    A = np.concatenate([s, -tau[..., None]], axis=-1)
    a = 0.5 * (np.sum(s**2, axis=-1) - tau**2)
    both = np.linalg.pinv(A, rcond=1e-9) @ np.stack([a, np.where(heard, 1.0, 0.0)], axis=-1)
    u, v = both[..., 0], both[..., 1]  # [p; b] = u + L v
    metric = np.append(np.ones(s.shape[-1]), -1.0)
    qa = 0.5 * np.sum(metric * v * v, axis=-1)
    qb = np.sum(metric * u * v, axis=-1) - 1.0
    qc = 0.5 * np.sum(metric * u * u, axis=-1)
    root = np.sqrt(np.maximum(qb**2 - 4.0 * qa * qc, 0.0))
    t = -0.5 * (qb + np.where(qb < 0.0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        L = np.stack([t / qa, qc / t], axis=-1)
        points = u[:, None, :-1] + L[..., None] * v[:, None, :-1]
    return np.where(np.isfinite(points), points, np.nan)


def _off_plane(s: Array, tau: Array, heard: Mask) -> Array:
    """Two places (B, 2, d) on either side of the plane (2-D: line) nearest the stations.

    The stations are taken to lie in it: position in the plane, b and L are then linear.
    """
    axes = np.linalg.svd(s, full_matrices=False)[2]
    flat = s @ np.swapaxes(axes[:, :-1], -1, -2)
    A = np.concatenate([flat, -tau[..., None], -np.where(heard, 1.0, 0.0)[..., None]], axis=-1)
    a = 0.5 * (np.sum(s**2, axis=-1) - tau**2)
    theta = (np.linalg.pinv(A, rcond=1e-9) @ a[..., None])[..., 0]
    p, b, L = theta[:, :-2], theta[:, -2], theta[:, -1]
    height = np.sqrt(np.maximum(2.0 * L + b**2 - np.sum(p**2, axis=-1), LEAST_HEIGHT**2))
    foot = np.einsum("bi,bij->bj", p, axes[:, :-1])
    off = height[:, None] * axes[:, -1]
    return np.stack([foot + off, foot - off], axis=1)


def _subsets(n: int, size: int) -> Mask:
    """Masks (M, n) of subsets of `size` of n things: all of them, or SUBSETS at random."""
    if comb(n, size) <= SUBSETS:
        members = np.array(list(combinations(range(n), size)))
    else:
        members = np.argsort(np.random.default_rng(0).random((SUBSETS, n)), axis=-1)[:, :size]
    mask = np.zeros((len(members), n), dtype=bool)
    np.put_along_axis(mask, members, True, axis=-1)
    return mask
