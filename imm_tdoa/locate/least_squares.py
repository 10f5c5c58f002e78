"""Damped Gauss-Newton on whitened residuals, for many fixes at once (ALGORITHMS §3.1).

The unknown theta is the position, or position and velocity at a reference time; scans at other
times see it carried along a straight line. Rows may come from any measurement model.
"""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa import gaussian, observation
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.scans import Scans

STUDENT_DOF = 3.0  # tails of real arrival times; weight (dof + 1)/(dof + e²) for a residual e


@attrs.frozen(eq=False)
class Problem:
    """Scans to be explained by one position or one straight motion.

    Attributes
    ----------
    scans : Scans
        Values (..., T, m).
    reference : () or (...)
        Time that theta refers to, s.
    moving : bool
        Whether theta has a velocity.
    velocity_std : (d,) or None
        Standard deviation of a zero-mean prior on the velocity, m/s.
    """

    scans: Scans
    reference: Array
    moving: bool
    velocity_std: Array | None = None

    @property
    def unknowns(self) -> int:
        """Length n of theta."""
        return self.scans.measurement.dims * (2 if self.moving else 1)


class System(NamedTuple):
    """Whitened residuals (..., N), their Jacobian (..., N, n), rows used, raw residuals."""

    r: Array
    J: Array
    rows: Index
    standardised: Array


def system(problem: Problem, theta: Array, weight: Array | None = None) -> System:
    """Linearise `problem` at `theta` (..., n); `weight` (..., T, m) scales precisions."""
    scans, d = problem.scans, problem.scans.measurement.dims
    lever = scans.times - np.asarray(problem.reference)[..., None]
    n = theta.shape[-1]
    Phi = np.broadcast_to(np.eye(n), (*lever.shape, n, n)).copy()
    if problem.moving:
        Phi[..., :d, d:] = lever[..., None, None] * np.eye(d)
    x = np.einsum("...tij,...j->...ti", Phi, theta)
    here = np.arange(d)
    seen = observation.observe(
        scans.together(),
        [x],
        [here],
        [here + d if problem.moving else here[:0]],
        scans.times,
        scans.values,
    )
    standardised = np.zeros((*theta.shape[:-1], *scans.values.shape[-2:]))
    rows = np.flatnonzero(np.isfinite(scans.values).reshape(-1, scans.values.shape[-1]).any(axis=0))
    if weight is not None:
        root = np.sqrt(weight[..., rows])
        R = seen.R[0] / (root[..., :, None] * root[..., None, :])
        seen = attrs.evolve(seen, R=(R,))
    standardised[..., rows] = _standardised(seen, weight if weight is None else weight[..., rows])
    seen = observation.without_offsets(seen)
    nu, H, R = gaussian.mask_rows(seen.nu[0], seen.H[0] @ Phi, seen.R[0], seen.present)
    white = np.linalg.solve(
        gaussian.factor(R, "noise covariance"), np.concatenate([H, nu[..., None]], axis=-1)
    )
    batch = white.shape[:-3]
    white = white.reshape(*batch, -1, n + 1)
    J, r = white[..., :-1], white[..., -1]
    if problem.velocity_std is not None:
        prior = np.broadcast_to(np.eye(n)[d:] / problem.velocity_std[:, None], (*batch, d, n))
        J = np.concatenate([J, prior], axis=-2)
        r = np.concatenate([r, -theta[..., d:] / problem.velocity_std], axis=-1)
    count = np.count_nonzero(seen.present, axis=(-2, -1))
    return System(r, J, count, standardised)


def _standardised(seen: observation.Observation, weight: Array | None) -> Array:
    """Residuals over their own standard deviations, shared offsets estimated and taken out."""
    nu = np.where(seen.present, seen.nu[0], 0.0)
    precision = np.where(seen.present, 1.0 / np.einsum("...ii->...i", seen.R[0]), 0.0)
    for g in np.unique(seen.group[seen.group >= 0]):
        w = np.where(seen.group == g, precision, 0.0)
        total = np.sum(w, axis=-1, keepdims=True)
        offset = np.sum(w * nu, axis=-1, keepdims=True) / np.where(total > 0.0, total, 1.0)
        nu = nu - np.where(seen.group == g, offset, 0.0)
    sigma = np.sqrt(np.einsum("...ii->...i", seen.R[0]) * (1.0 if weight is None else weight))
    return np.where(seen.present, nu / sigma, 0.0)


class Solution(NamedTuple):
    """Where the iteration ended; leading axes as the starting points."""

    theta: Array
    covariance: Array
    converged: Mask
    iterations: Index
    chi2: Array
    rows: Index
    standardised: Array


def solve(
    problem: Problem, theta: Array, weight: Array | None = None, iterations: int = 60
) -> Solution:
    """Levenberg-Marquardt from `theta` (..., n); every element of the batch is its own fit.

    Damping lambda diag(A) makes the step independent of units. An element has converged when
    the full step would change chi2 by less than 1e-10 and the normal matrix is regular.
    """
    at = system(problem, theta, weight)
    cost = np.einsum("...i,...i->...", at.r, at.r)
    damping = np.full(cost.shape, 1e-3)
    done = np.zeros(cost.shape, dtype=bool)
    used = np.zeros(cost.shape, dtype=np.int64)
    for _ in range(iterations):
        A, g = _normal(at)
        newton = _damped_step(A, g, np.zeros_like(damping))
        decrement = np.einsum("...i,...i->...", newton, g)
        done = done | (np.abs(decrement) <= 1e-10 * (1.0 + 1e-3 * cost))
        if np.all(done):
            break
        step = _damped_step(A, g, damping)
        trial = np.where(done[..., None], theta, theta + step)
        there = system(problem, trial, weight)
        trial_cost = np.einsum("...i,...i->...", there.r, there.r)
        better = ~done & np.isfinite(trial_cost) & (trial_cost <= cost)
        used = used + ~done
        theta = np.where(better[..., None], trial, theta)
        at = System(*(_where(better, new, old) for new, old in zip(there, at, strict=True)))
        cost = np.where(better, trial_cost, cost)
        damping = np.clip(np.where(better, damping * 0.2, damping * 6.0), 1e-12, 1e12)
    A, _ = _normal(at)
    covariance, regular = _inverse(A)
    return Solution(theta, covariance, done & regular, used, cost, at.rows, at.standardised)


def solve_robust(problem: Problem, theta: Array, rounds: int = 30) -> tuple[Solution, Array]:
    """Iteratively re-weighted fit under Student-t noise; returns the weights (..., T, m) too."""
    solution = solve(problem, theta)
    weight = _student_weight(solution.standardised)
    for _ in range(rounds):
        solution = solve(problem, solution.theta, weight, iterations=20)
        new = _student_weight(solution.standardised)
        settled = np.max(np.abs(new - weight), initial=0.0) < 1e-6
        weight = new
        if settled:
            break
    return solution, weight


def _student_weight(e: Array) -> Array:
    result: Array = (STUDENT_DOF + 1.0) / (STUDENT_DOF + e**2)
    return np.minimum(result, 1.0)


def student_cost(e: Array) -> Array:
    """Return minus twice the Student-t log-likelihood of standardised residuals (..., T, m)."""
    result: Array = (STUDENT_DOF + 1.0) * np.sum(np.log1p(e**2 / STUDENT_DOF), axis=(-2, -1))
    return result


def _where(mask: Mask, new: Array, old: Array) -> Array:
    result: Array = np.where(mask.reshape(mask.shape + (1,) * (new.ndim - mask.ndim)), new, old)
    return result


def _normal(at: System) -> tuple[Array, Array]:
    A = np.einsum("...ki,...kj->...ij", at.J, at.J)
    return A, np.einsum("...ki,...k->...i", at.J, at.r)


def _damped_step(A: Array, g: Array, damping: Array) -> Array:
    """Solve (A + damping diag A) step = g in units where diag A = 1, floored against zeros."""
    scale = np.sqrt(np.einsum("...ii->...i", A))
    top = np.max(scale, axis=-1, keepdims=True)
    scale = np.maximum(scale, np.where(top > 0.0, 1e-9 * top, 1.0))
    unit = A / (scale[..., :, None] * scale[..., None, :])
    ridge = (damping + 1e-14)[..., None, None] * np.eye(A.shape[-1])
    result: Array = np.linalg.solve(unit + ridge, (g / scale)[..., None])[..., 0] / scale
    return result


def _inverse(A: Array) -> tuple[Array, Mask]:
    """Inverse of A (..., n, n), NaN where it is singular to working accuracy; and where not."""
    scale = np.sqrt(np.einsum("...ii->...i", A))
    safe = np.where(scale > 0.0, scale, 1.0)
    unit = A / (safe[..., :, None] * safe[..., None, :])
    w, V = np.linalg.eigh(unit)
    regular = (w[..., 0] > 1e-11 * w[..., -1]) & np.all(scale > 0.0, axis=-1)
    w = np.where(regular[..., None], w, np.nan)
    inverse = np.einsum("...ik,...k,...jk->...ij", V, 1.0 / w, V)
    return gaussian.symmetric(inverse / (safe[..., :, None] * safe[..., None, :])), regular
