"""Where to begin: starting points in closed form and around the stations."""

from __future__ import annotations

from itertools import product

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.locate.closed_form import closed_form_points
from imm_tdoa.locate.problem import Problem, misfits, noise, residuals, whitening

ARMS = 24  # directions in two dimensions; 26 in three, 2 in one
RADII = (0.15, 0.5, 1.0, 2.0, 5.0, 20.0)  # times the spread of the stations that heard
KEPT = 8  # starting points of each fit
KEPT_ROBUST = 24  # gross errors make the misfit a worse guide


def starting_points(problem: Problem, *, robust: bool = False) -> tuple[Array, Index]:
    """Return starting points theta (B * K, n), and the fit (B * K,) of each.

    First what `closed_form_points` finds in a scan of ranging rows; then the best of a star
    around the stations that heard the emission, which serves any measurement: its arms point all
    around, its radii follow the spread of those stations, and one arm counts once, so that
    another root of the equations (a mirror solution) has its chance. Points are ranked by
    their residuals.
    """
    centre, spread = problem.stations_heard()
    B, d = centre.shape
    arms = _arms(d)
    star = centre[:, None, None, :] + spread[:, None, None, None] * (
        np.array(RADII)[:, None] * arms[:, None, :]
    )
    theta, cost = ranked(problem, star.reshape(B, -1, d))
    best = np.argmin(cost.reshape(B, len(arms), len(RADII)), axis=-1)
    best = best + len(RADII) * np.arange(len(arms))
    star_theta = np.take_along_axis(theta, best[..., None], axis=1)
    star_cost = np.take_along_axis(cost, best, axis=1)
    closed = closed_form_points(problem, robust=robust)
    exists = np.asarray(np.isfinite(closed).all(axis=-1))
    closed_theta, closed_cost = ranked(
        problem, np.where(exists[..., None], closed, centre[:, None, :])
    )
    if not robust:  # without gross errors they are as good as exact: all are taken
        closed_cost = np.full_like(closed_cost, -1.0)
    closed_cost = np.where(exists, closed_cost, np.inf)
    theta = np.concatenate([closed_theta, star_theta], axis=1)
    cost = np.concatenate([closed_cost, star_cost], axis=1)
    kept = min(KEPT_ROBUST if robust else KEPT, len(arms))
    order = np.argsort(cost, axis=-1, kind="stable")[:, :kept]
    theta = np.take_along_axis(theta, order[..., None], axis=1)
    return theta.reshape(-1, theta.shape[-1]), np.repeat(np.arange(B), theta.shape[1])


def ranked(problem: Problem, points: Array) -> tuple[Array, Array]:
    """Return theta (B, P, n) at points (B, P, d), and its misfit (B, P), at worst infinite.

    The velocity is the one that fits the position best. The misfit is bounded for each row: one
    gross row must not hide the right place.
    """
    B, P, d = points.shape
    n = problem.unknowns
    fit = np.repeat(np.arange(B), P)
    theta = np.zeros((B * P, n))
    theta[:, :d] = points.reshape(-1, d)
    R = noise(problem, theta[::P], np.arange(B))
    W = whitening(problem, R, np.arange(B))
    W = W._replace(of=np.repeat(W.of, P))
    if problem.moving:
        nu, H = residuals(problem, theta, fit)
        white = (W @ np.concatenate([H, nu[..., None]], axis=-1)).reshape(B * P, -1, n + 1)
        r, J = white[..., -1], white[..., d:n]
        theta[:, d:] = _velocity(problem, r, J)
        r = r - np.einsum("nki,ni->nk", J, theta[:, d:])
    else:
        r = (W @ misfits(problem, theta, fit)[..., None]).reshape(B * P, -1)
    cost = np.sum(np.log1p(r**2), axis=-1)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    return theta.reshape(B, P, n), cost.reshape(B, P)


def _velocity(problem: Problem, r: Array, J: Array) -> Array:
    """Velocity (N, d) that best explains whitened residuals r (N, K); the least one of several."""
    A = np.einsum("nki,nkj->nij", J, J)
    if problem.velocity_std is not None:
        A = A + np.diag(problem.velocity_std**-2.0)
    size = np.einsum("nii->n", A)
    finite = np.isfinite(size) & (size > 0.0)
    A = np.where(finite[:, None, None], A, 0.0)
    A = A + np.where(finite, 1e-9 * size, 1.0)[:, None, None] * np.eye(A.shape[-1])
    g = np.where(finite[:, None], np.einsum("nki,nk->ni", J, r), 0.0)
    result: Array = np.linalg.solve(A, g[..., None])[..., 0]
    return result


def _arms(d: int) -> Array:
    """Directions (A, d) all around."""
    if d == 2:
        angle = np.arange(ARMS) * (2.0 * np.pi / ARMS)
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    corners = np.array([c for c in product((-1.0, 0.0, 1.0), repeat=d) if any(c)])
    result: Array = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    return result
