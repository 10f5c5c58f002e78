"""Fixes in closed form (Chan & Ho 1994; ALGORITHMS §3.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from imm_tdoa import _validate, registry
from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.geometry import incidence, ranges
from imm_tdoa.locate.choice import choose
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.normal import inverse
from imm_tdoa.stations import Stations, pair_index

Whitener = Callable[[Array], Array]  # position (N, d) -> L^-1 (..., S-1, S-1), L L' = covariance


def chan_ho(
    stations: Stations,
    tdoa: Any,
    *,
    toa_sigma: Any = None,
    tdoa_sigma: Any = None,
    pairs: Any = "reference",
    speed: float = 299792458.0,
    reweight: int = 2,
) -> Fix:
    """Locate an emitter by the two-stage weighted least squares of Chan & Ho.

    Stage 1 solves for position and range to station 0 as if they were independent; stage 2
    imposes their relation. With just d + 1 stations a quadratic gives up to two roots, with
    stations in a straight line (or plane) a mirror image: both are reported. Where stage 1 alone
    leaves position and range nearly undetermined (stations almost in a line or plane, some
    emitter places with just d + 2 stations) the error exceeds the covariance: `gauss_newton`
    has no such places.

    Parameters
    ----------
    stations : Stations
        The receivers, fixed; position errors they declare are part of the noise.
    tdoa : (..., m)
        Arrival-time differences, s. Leading axes are separate fixes. All must be present.
    toa_sigma, tdoa_sigma : float or (S,) / (m,)
        Exactly one: standard deviation per arrival, or per independent difference, s.
    pairs : "reference", "adjacent" or (m, 2)
        Which differences `tdoa` holds; they must connect all stations. They are taken to
        differences against station 0 first, by least squares where there are more than S - 1.
    speed : float
        Signal speed, m/s.
    reweight : int
        Times the weights are recomputed from the ranges of the current estimate.

    Returns
    -------
    Fix
        `mirror` holds the second root or mirror image; the first is the one that fits the
        measurements better; where both fit equally the nearer one, or that with the greater
        last coordinate. Where noise leaves a quadratic no real root, the real part is given,
        whose chi2 is above 0.

    Raises
    ------
    ValueError
        Arguments that do not fit; moving stations; stations too few, or in a straight line in
        three dimensions; pairs that do not connect them.

    Notes
    -----
    Stage 2 works in axes turned so that the emitter makes the same angle with each: its squares
    lose the sign and the accuracy of a component near zero (§3.3).

    References
    ----------
    Y. T. Chan and K. C. Ho, "A simple and efficient estimator for hyperbolic location", IEEE
    Trans. Signal Processing 42(8), 1905-1915, 1994; equations (14), (22), (24).
    """
    if stations.moving:
        raise ValueError("stations: chan_ho takes fixed stations; use gauss_newton for moving ones")
    if isinstance(reweight, bool) or not isinstance(reweight, int) or reweight < 0:
        raise ValueError(f"reweight: expected a whole number of at least 0, got {reweight!r}")
    measurement: MeasurementModel = registry.load("tdoa")(
        stations, toa_sigma=toa_sigma, tdoa_sigma=tdoa_sigma, pairs=pairs, speed=speed
    )
    values = _validate.array("tdoa", tdoa, (None, measurement.size))
    s = stations.positions
    d = stations.dims
    rank = _spanned(s)
    to_reference = _to_reference(measurement, pairs, stations)
    r = (values * measurement.scale).reshape(-1, measurement.size) @ to_reference.T

    def whitener(p: Array) -> Array:
        R = measurement.noise_covariance(p, np.zeros_like(p), 0.0)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(to_reference @ R @ to_reference.T)))

    if rank < d:
        candidates, passes = _flat_array(s, r, whitener, reweight), 1 + reweight
    elif len(s) == d + 1:
        candidates, passes = _two_roots(s, r), 1
    else:
        candidates, passes = _two_stages(s, r, whitener, reweight), 1 + reweight
    return _best(s, r, whitener, candidates, passes, values.shape[:-1])


def _spanned(s: Array) -> int:
    """Number of dimensions the stations span; refuse those that fix no position."""
    S, d = s.shape
    if d + 1 > S:
        raise ValueError(
            f"stations: {S} stations cannot fix a position in {d} dimensions; expected at least "
            f"{d + 1}"
        )
    extent = np.linalg.svd(s - s.mean(axis=0), compute_uv=False)
    rank = int(np.count_nonzero(extent > 1e-9 * extent[0]))
    if rank < d - 1:
        raise ValueError(
            "stations: they stand in a straight line, which fixes no position in three "
            "dimensions; expected stations that span at least a plane"
        )
    return rank


def _to_reference(measurement: MeasurementModel, pairs: Any, stations: Stations) -> Array:
    """Matrix (S - 1, m) that takes differences between `pairs` to those against station 0."""
    index = pair_index(pairs, stations)
    S, m = len(stations), len(index)
    kept = np.flatnonzero(measurement.independent(np.ones(m, dtype=bool)))
    D = incidence(index[kept], S)[:, 1:]
    if np.linalg.matrix_rank(D) < S - 1:
        raise ValueError(f"pairs: they do not connect all {S} stations")
    centre = stations.positions.mean(axis=0)
    R = measurement.noise_covariance(centre, np.zeros_like(centre), 0.0)[kept[:, None], kept]
    weighted = np.linalg.solve(R, D)
    result = np.zeros((S - 1, m))
    result[:, kept] = np.linalg.solve(D.T @ weighted, weighted.T)
    return result


def _linear_system(s: Array, r: Array) -> tuple[Array, Array]:
    """Equation (5): h = G [p - s_0; r_0] for range differences r (N, S - 1)."""
    a = s[1:] - s[0]
    h = 0.5 * (r**2 - np.sum(a**2, axis=-1))
    G = -np.concatenate([np.broadcast_to(a, (*r.shape, a.shape[-1])), r[..., None]], axis=-1)
    return G, h


def _weighted(G: Array, h: Array, W: Array) -> tuple[Array, Array]:
    """Least squares of W h = W G theta by QR: theta (N, n) and its covariance (G' W'W G)^-1."""
    q, R = np.linalg.qr(W @ G)
    theta = np.linalg.solve(R, np.swapaxes(q, -1, -2) @ (W @ h[..., None]))[..., 0]
    Ri = np.linalg.inv(R)
    return theta, Ri @ np.swapaxes(Ri, -1, -2)


def _by_ranges(W: Array, r: Array) -> Array:
    """Whitening of the equations' errors B n, B = diag(r): W B^-1."""
    floor = 1e-9 * np.max(r, axis=-1, keepdims=True)
    result: Array = W / np.maximum(r, floor)[..., None, :]
    return result


def _two_stages(s: Array, r: Array, whitener: Whitener, reweight: int) -> Array:
    """S >= d + 2 stations spanning the space: equations (14b), (14a), (22a), (24)."""
    G, h = _linear_system(s, r)
    W = whitener(s.mean(axis=0))
    W = W / np.sqrt(np.mean(W**2))  # far field: all ranges alike
    theta, cov = _weighted(G, h, W)
    for _ in range(reweight):
        p = theta[..., :-1] + s[0]
        theta, cov = _weighted(G, h, _by_ranges(whitener(p), ranges(p, s[1:])[0]))
    result: Array = (_second_stage(theta, cov) + s[0])[..., None, :]
    return result


def _second_stage(theta: Array, cov: Array) -> Array:
    """Impose r_0² = |p - s_0|² on stage 1's theta (N, d + 1); equations (22a), (24)."""
    d = theta.shape[-1] - 1
    turn = _turn(theta[..., :-1])
    T = np.zeros((*theta.shape, d + 1))
    T[..., :d, :d], T[..., d, d] = turn, 1.0
    theta = np.einsum("...ij,...j->...i", T, theta)
    cov = T @ cov @ np.swapaxes(T, -1, -2)
    size = np.linalg.norm(theta, axis=-1, keepdims=True)
    B = np.where(np.abs(theta) > 1e-9 * size, theta, 1e-9 * size + 1e-300)
    L = np.linalg.cholesky(cov)
    W = np.linalg.inv(L) / (2.0 * B)[..., None, :]
    G = np.broadcast_to(np.concatenate([np.eye(d), np.ones((1, d))]), (*theta.shape, d))
    squared, _ = _weighted(G, theta**2, W)
    u = np.where(theta[..., :d] < 0.0, -1.0, 1.0) * np.sqrt(np.abs(squared))
    result: Array = np.einsum("...ji,...j->...i", turn, u)
    return result


def _turn(u: Array) -> Array:
    """Reflection (N, d, d) that takes each u (N, d) to a vector of equal components."""
    d = u.shape[-1]
    size = np.linalg.norm(u, axis=-1, keepdims=True)
    v = u / np.where(size > 0.0, size, 1.0) - 1.0 / np.sqrt(d)
    square = np.sum(v**2, axis=-1)[..., None, None]
    turn = np.eye(d) - 2.0 * v[..., :, None] * v[..., None, :] / np.where(square > 0.0, square, 1.0)
    return np.where((square > 1e-12) & (size[..., None] > 0.0), turn, np.eye(d))


def _two_roots(s: Array, r: Array) -> Array:
    """S = d + 1: p = alpha + beta r_0 in r_0² = |p|², up to two roots with r_0 > 0."""
    G, h = _linear_system(s, r)
    both = np.linalg.solve(-G[..., :-1], np.stack([-h, -r], axis=-1))
    alpha, beta = both[..., 0], both[..., 1]
    a = np.sum(beta**2, axis=-1) - 1.0
    b = 2.0 * np.sum(alpha * beta, axis=-1)
    c = np.sum(alpha**2, axis=-1)
    root = np.sqrt(np.maximum(b**2 - 4.0 * a * c, 0.0))
    q = -0.5 * (b + np.where(b < 0.0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        r0 = np.stack([q / a, c / q], axis=-1)
    valid: Mask = np.isfinite(r0) & (r0 >= 0.0)
    valid &= np.all(r0[..., None] + r[..., None, :] >= 0.0, axis=-1)
    r0 = np.where(valid, r0, np.nan)
    result: Array = alpha[..., None, :] + beta[..., None, :] * r0[..., None] + s[0]
    return result


def _flat_array(s: Array, r: Array, whitener: Whitener, reweight: int) -> Array:
    """Stations in a line (2-D) or plane (3-D): solve within it; the height is ± (§3.2)."""
    d = s.shape[1]
    axes = np.linalg.svd(s - s.mean(axis=0))[2]
    flat = (s - s[0]) @ axes[: d - 1].T
    G, h = _linear_system(flat, r)

    def places(theta: Array) -> tuple[Array, Array]:
        height2 = theta[..., -1] ** 2 - np.sum(theta[..., :-1] ** 2, axis=-1)
        height = np.sqrt(np.maximum(height2, 0.0))[..., None] * axes[d - 1]
        along = s[0] + theta[..., :-1] @ axes[: d - 1]
        return along + height, along - height

    W = whitener(s.mean(axis=0))
    theta, _ = _weighted(G, h, W / np.sqrt(np.mean(W**2)))
    for _ in range(reweight):
        p, _ = places(theta)
        theta, _ = _weighted(G, h, _by_ranges(whitener(p), ranges(p, s[1:])[0]))
    return np.stack(places(theta), axis=-2)


def _best(
    s: Array, r: Array, whitener: Whitener, points: Array, passes: int, batch: tuple[int, ...]
) -> Fix:
    """Rank the candidates (N, K, d) by how they explain the measurements; make a Fix."""
    (N, _, d), S = points.shape, len(s)
    r_all, u = ranges(points, s)
    W = whitener(points)
    e = r[:, None] - (r_all[..., 1:] - r_all[..., :1])
    white = np.einsum("...ij,...j->...i", W, e)
    chi2 = np.einsum("...i,...i->...", white, white)
    J = W @ (u[..., 1:, :] - u[..., :1, :])
    known: Mask = np.asarray(np.isfinite(points).all(axis=-1))
    information = np.swapaxes(J, -1, -2) @ J
    information = np.where(known[..., None, None], information, 0.0)
    covariance, regular = inverse(information)
    cost = np.where(known, chi2, np.inf)
    centre = np.broadcast_to(s.mean(axis=0), (N, d))
    best, mirror = choose(points, cost, known & regular, information, centre)
    one = np.arange(N)
    return Fix(
        position=points[one, best].reshape(*batch, d),
        velocity=None,
        covariance=covariance[one, best].reshape(*batch, d, d),
        converged=(known & regular)[one, best].reshape(batch),
        iterations=np.full(batch, passes, dtype=np.int64),
        chi2=chi2[one, best].reshape(batch),
        dof=np.full(batch, S - 1 - d, dtype=np.int64),
        mirror=None if np.all(np.isnan(mirror)) else mirror.reshape(*batch, d),
    )
