"""Fixes in closed form (Chan & Ho 1994; ALGORITHMS §3.2)."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.geometry import difference_covariance, ranges
from imm_tdoa.locate.fix import Fix
from imm_tdoa.stations import Stations, pair_index


def chan_ho(
    stations: Stations,
    tdoa: Any,
    *,
    toa_sigma: Any = None,
    tdoa_sigma: Any = None,
    speed: float = 299792458.0,
    reweight: int = 2,
) -> Fix:
    """Locate an emitter by the two-stage weighted least squares of Chan & Ho.

    Stage 1 solves for position and range to station 0 as if they were independent; stage 2
    imposes their relation. With just d + 1 stations a quadratic gives up to two roots, with
    stations in a straight line (or plane) a mirror image: both are reported.

    Parameters
    ----------
    stations : Stations
        The receivers; station 0 is the reference. Fixed.
    tdoa : (..., S - 1)
        Arrival time of stations 1 … S-1 minus that of station 0, s. Leading axes are separate
        fixes. All must be present.
    toa_sigma, tdoa_sigma : float or (S,) / (S - 1,)
        Exactly one: standard deviation per arrival, or per independent difference, s.
    speed : float
        Signal speed, m/s.
    reweight : int
        Times the weights are recomputed from the ranges of the current estimate.

    Returns
    -------
    Fix
        `mirror` holds the second root or mirror image; the first is the one that fits the
        measurements better, or the nearer one where both fit exactly.

    References
    ----------
    Y. T. Chan and K. C. Ho, "A simple and efficient estimator for hyperbolic location", IEEE
    Trans. Signal Processing 42(8), 1905-1915, 1994; equations (14), (22), (24).
    """
    s, Q = _arguments(stations, toa_sigma, tdoa_sigma, speed)
    r = _validate.array("tdoa", tdoa, (None, len(stations) - 1)) * speed
    S, d = s.shape
    array = s[1:] - s[0]
    sv = np.linalg.svd(array, compute_uv=False)
    rank = int(np.count_nonzero(sv > 1e-9 * sv[0]))
    if S < d + 1:
        raise ValueError(
            f"stations: {S} stations cannot fix a position in {d} dimensions; expected at least "
            f"{d + 1}"
        )
    if rank < d - 1:
        raise ValueError(
            "stations: they stand in a straight line, which fixes no position in three "
            "dimensions; expected stations that span at least a plane"
        )
    if rank < d:
        candidates = _flat_array(s, r, Q, reweight)
    elif d + 1 == S:
        candidates = _two_roots(s, r, Q)
    else:
        candidates = _two_stages(s, r, Q, reweight)
    return _choose(s, r, Q, candidates, reweight)


def _arguments(
    stations: Stations, toa_sigma: Any, tdoa_sigma: Any, speed: float
) -> tuple[Array, Array]:
    """Station positions (S, d) and covariance (S-1, S-1) of the range differences, m²."""
    if stations.moving:
        raise ValueError("stations: chan_ho takes fixed stations; use gauss_newton for moving ones")
    if (toa_sigma is None) == (tdoa_sigma is None):
        raise ValueError("give exactly one of toa_sigma and tdoa_sigma")
    _validate.positive("speed", speed)
    S = len(stations)
    name, sigma, n = (
        ("toa_sigma", toa_sigma, S) if tdoa_sigma is None else ("tdoa_sigma", tdoa_sigma, S - 1)
    )
    value = _validate.array(name, sigma)
    if value.shape not in ((), (n,)):
        raise ValueError(f"{name}: expected one number or {n}, got shape {value.shape}")
    if np.any(value <= 0.0):
        raise ValueError(f"{name}: expected standard deviations above 0, got {value.min():g}")
    variance = np.broadcast_to((speed * value) ** 2, (n,))
    if tdoa_sigma is None:
        return stations.positions, difference_covariance(variance, pair_index("reference", S))
    return stations.positions, np.diag(variance)


def _weighted(G: Array, h: Array, C: Array) -> tuple[Array, Array]:
    """Weighted least squares (G' C^-1 G)^-1 G' C^-1 h and its covariance, by QR of the whitened.

    G (..., m, n), h (..., m), C (..., m, m).
    """
    L = np.linalg.cholesky(C)
    batch = np.broadcast_shapes(G.shape[:-2], h.shape[:-1], L.shape[:-2])
    A = np.linalg.solve(L, np.broadcast_to(G, (*batch, *G.shape[-2:])))
    b = np.linalg.solve(L, np.broadcast_to(h, (*batch, h.shape[-1]))[..., None])
    q, R = np.linalg.qr(A)
    theta = np.linalg.solve(R, np.swapaxes(q, -1, -2) @ b)[..., 0]
    Ri = np.linalg.inv(R)
    return theta, Ri @ np.swapaxes(Ri, -1, -2)


def _linear_system(s: Array, r: Array) -> tuple[Array, Array]:
    """Equation (5): h = G [p - s_0; r_0], relative to station 0."""
    a = s[1:] - s[0]
    h = 0.5 * (r**2 - np.sum(a**2, axis=-1))
    G = -np.concatenate([np.broadcast_to(a, (*r.shape, a.shape[-1])), r[..., None]], axis=-1)
    return G, h


def _two_stages(s: Array, r: Array, Q: Array, reweight: int) -> list[Array]:
    """S >= d + 2 stations spanning the space: equations (14a), (22a), (24)."""
    G, h = _linear_system(s, r)
    scale = np.sqrt(np.trace(Q) / len(Q))
    theta, cov = _weighted(G, h, Q / scale**2)  # far-field weights (14b)
    for _ in range(max(reweight, 1)):
        B = ranges(theta[..., :-1] + s[0], s[1:])[0]
        theta, cov = _weighted(G, h, B[..., :, None] * Q * B[..., None, :])
    return [_second_stage(theta, cov) + s[0]]


def _second_stage(theta: Array, cov: Array) -> Array:
    """Impose r_0² = |p - s_0|² on stage 1's theta (..., d + 1); equation (22a)."""
    d = theta.shape[-1] - 1
    G = np.concatenate([np.eye(d), np.ones((1, d))])
    floor = 1e-9 * np.linalg.norm(theta, axis=-1, keepdims=True) + 1e-300
    B = 2.0 * np.where(np.abs(theta) > floor, theta, floor)
    squared, _ = _weighted(G, theta**2, B[..., :, None] * cov * B[..., None, :])
    sign = np.where(theta[..., :d] < 0.0, -1.0, 1.0)
    result: Array = sign * np.sqrt(np.abs(squared))
    return result


def _two_roots(s: Array, r: Array, Q: Array) -> list[Array]:
    """S = d + 1: p = alpha + beta r_0 in r_0² = |p|², up to two roots with r_0 > 0."""
    G, h = _linear_system(s, r)
    A = -G[..., :-1]
    both = np.linalg.solve(A, np.stack([-h, -r], axis=-1))
    alpha, beta = both[..., 0], both[..., 1]
    a = np.sum(beta**2, axis=-1) - 1.0
    b = 2.0 * np.sum(alpha * beta, axis=-1)
    c = np.sum(alpha**2, axis=-1)
    root = np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0))
    q = -0.5 * (b + np.where(b < 0.0, -1.0, 1.0) * root)
    with np.errstate(divide="ignore", invalid="ignore"):
        r0 = np.stack([q / a, c / q], axis=-1)
    valid = np.isfinite(r0) & (r0 >= 0.0) & np.all(r0[..., None] + r[..., None, :] >= 0.0, axis=-1)
    r0 = np.where(valid, r0, np.nan)
    return [alpha + beta * r0[..., k, None] + s[0] for k in range(2)]


def _flat_array(s: Array, r: Array, Q: Array, reweight: int) -> list[Array]:
    """Stations in a line (2-D) or plane (3-D): solve within it, the height is ± (§3.2)."""
    S, d = s.shape
    _, _, axes = np.linalg.svd(s[1:] - s[0])
    flat = np.concatenate([np.zeros((1, d - 1)), (s[1:] - s[0]) @ axes[: d - 1].T])
    if S < d + 1:
        raise ValueError(f"stations: expected at least {d + 1}, got {S}")
    G, h = _linear_system(flat, r)
    scale = np.sqrt(np.trace(Q) / len(Q))
    theta, _ = _weighted(G, h, Q / scale**2)
    for _ in range(max(reweight, 1)):
        height2 = np.maximum(theta[..., -1] ** 2 - np.sum(theta[..., :-1] ** 2, axis=-1), 0.0)
        r_flat, _ = ranges(theta[..., :-1], flat[1:])
        B = np.sqrt(r_flat**2 + height2[..., None])
        theta, _ = _weighted(G, h, B[..., :, None] * Q * B[..., None, :])
    height = np.sqrt(np.maximum(theta[..., -1] ** 2 - np.sum(theta[..., :-1] ** 2, axis=-1), 0.0))
    along = theta[..., :-1] @ axes[: d - 1]
    return [s[0] + along + sign * height[..., None] * axes[d - 1] for sign in (1.0, -1.0)]


def _choose(s: Array, r: Array, Q: Array, candidates: list[Array], reweight: int) -> Fix:
    """Rank the candidates (…, d) by how they explain the measurements; make a Fix."""
    L = np.linalg.cholesky(Q)
    points = np.stack(candidates, axis=-2)
    r_all, u = ranges(points, s)
    residual = r[..., None, :] - (r_all[..., 1:] - r_all[..., :1])
    white = np.linalg.solve(L, residual[..., None])[..., 0]
    chi2 = np.einsum("...i,...i->...", white, white)
    usable = np.isfinite(chi2)
    tie = 1e-6 * (1.0 + np.nanmin(np.where(usable, chi2, np.inf), axis=-1, keepdims=True))
    nearness = np.where(usable, r_all[..., 0], np.inf)
    rank = np.where(usable, chi2, np.inf)
    close = rank <= np.min(rank, axis=-1, keepdims=True) + tie
    first = np.argmin(np.where(close, nearness, np.inf), axis=-1)[..., None]

    def pick(a: Array, which: Array) -> Array:
        index = which.reshape(which.shape + (1,) * (a.ndim - which.ndim))
        return np.take_along_axis(a, index, axis=which.ndim - 1).squeeze(which.ndim - 1)

    position, best = pick(points, first), pick(chi2, first)
    J = np.linalg.solve(L, pick(u, first)[..., 1:, :] - pick(u, first)[..., :1, :])
    information = np.einsum("...ki,...kj->...ij", J, J)
    found = np.isfinite(position).all(axis=-1) & (
        np.linalg.cond(np.where(np.isfinite(information), information, 0.0)) < 1e14
    )
    d = s.shape[1]
    covariance = np.linalg.inv(np.where(found[..., None, None], information, np.eye(d)))
    covariance = np.where(found[..., None, None], covariance, np.nan)
    mirror = None
    if points.shape[-2] == 2:
        other = pick(points, 1 - first)
        rival = pick(usable, 1 - first) & (pick(chi2, 1 - first) <= best + 9.0)
        apart = np.sum((other - position) ** 2, axis=-1) > 1e-12 * np.sum(
            (position - s[0]) ** 2, axis=-1
        )
        mirror = np.where((rival & apart)[..., None], other, np.nan)
        mirror = None if np.all(np.isnan(mirror)) else mirror
    return Fix(
        position=np.where(found[..., None], position, np.nan),
        velocity=None,
        covariance=covariance,
        converged=found,
        iterations=np.full(found.shape, max(reweight, 1) if len(s) > d + 1 else 1),
        chi2=best,
        dof=np.full(found.shape, len(s) - 1 - d),
        mirror=mirror,
    )
