"""Damped Gauss-Newton on whitened residuals, for many trial points at once (ALGORITHMS §3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.locate.normal import inverse, spectrum
from imm_tdoa.locate.problem import (
    Problem,
    Whitening,
    misfits,
    noise,
    residuals,
    standardised,
    whitening,
)

ITERATIONS = 60  # most iterations of one descent
ROUNDS = 200  # most descents, the noise being taken anew in between
STUDENT_DOF = 3.0  # tails of real arrival times
DECREMENT = 1e-10  # a full step that would lower chi2 by less has arrived
ROUNDING = 1e-4  # so has one this small that fails to lower chi2 at all
LEAP = 0.5  # longest step over the distance from the stations
RIDGE = 1e-14  # keeps a singular normal matrix from dividing by zero


class Solution(NamedTuple):
    """Where the iteration ended, for each of N trial points.

    `covariance` is NaN where the geometry determines no theta; `weight` is None unless robust.
    """

    theta: Array
    covariance: Array
    converged: Mask
    iterations: Index
    chi2: Array
    standardised: Array
    weight: Array | None

    @classmethod
    def joined(cls, parts: Sequence[Solution]) -> Solution:
        """Return the solutions of several sets of trial points as one."""
        if len(parts) == 1:
            return parts[0]
        columns: list[Any] = [
            None if column[0] is None else np.concatenate(column)
            for column in zip(*parts, strict=True)
        ]
        return cls(*columns)


class Descent(NamedTuple):
    """Where a descent under a fixed noise ended: whitened residuals r (N, K), Jacobian J."""

    theta: Array
    r: Array
    J: Array
    arrived: Mask
    iterations: Index


def solve(problem: Problem, theta: Array, fit: Index, *, robust: bool = False) -> Solution:
    """Fit each trial point theta (N, n) to the scans of its `fit` (N,).

    Gauss-Newton descends under a fixed noise. Where the noise depends on theta (receivers with
    position errors, §1.4) or, with `robust`, on the residuals (Student-t weights), it is taken
    anew where the descent ended and the descent repeated, until neither changes. The weights
    begin on the scale of the first residuals, so that a bad start does not condemn good rows.
    """
    N, n = theta.shape
    theta, weight = np.array(theta), None
    temper = np.ones(N)
    if robust:
        nu = misfits(problem, theta, fit)
        e = standardised(problem, nu, noise(problem, theta, fit), fit, None)
        temper = _typical(e, problem.present[fit])
        weight = student_weight(e / temper[:, None, None])
    arrived, settled = np.zeros(N, dtype=bool), np.zeros(N, dtype=bool)
    used = np.zeros(N, dtype=np.int64)
    e, chi2, A = np.zeros((N, *problem.z.shape[1:])), np.zeros(N), np.zeros((N, n, n))
    live = np.arange(N)
    for _ in range(ROUNDS):
        where, own = fit[live], None if weight is None else weight[live]
        R = noise(problem, theta[live], where)
        at = descend(problem, theta[live], where, whitening(problem, R, where, own))
        theta[live], arrived[live] = at.theta, at.arrived
        used[live] += at.iterations
        A[live] = np.einsum("nki,nkj->nij", at.J, at.J)
        chi2[live] = np.einsum("nk,nk->n", at.r, at.r)
        R_there = noise(problem, at.theta, where)
        settled[live] = _equal(R, R_there)
        nu = misfits(problem, at.theta, where)
        e[live] = standardised(problem, nu, R_there, where, own)
        if weight is not None and own is not None:
            typical = _typical(e[live], problem.present[where])
            temper[live] = np.maximum(np.minimum(typical, 0.3 * temper[live]), 1.0)
            weight[live] = student_weight(e[live] / temper[live, None, None])
            change = np.max(np.abs(weight[live] - own), axis=(-2, -1), initial=0.0)
            settled[live] &= (change <= 1e-4) & (temper[live] == 1.0)
        live = live[arrived[live] & ~settled[live]]
        if live.size == 0:
            break
    covariance, regular = inverse(A)
    return Solution(theta, covariance, arrived & settled & regular, used, chi2, e, weight)


def descend(problem: Problem, theta: Array, fit: Index, W: Whitening) -> Descent:
    """Levenberg-Marquardt under the noise that `W` whitens, at most ITERATIONS steps.

    Damping lambda diag(A) makes the step independent of units; lambda follows how much of the
    promised gain a step kept. Along no eigenvector does the position leap further than a part of
    its distance from the stations, or distant sources are overshot (trap T18). A point has
    arrived when the full Gauss-Newton step would lower chi2 by nothing that matters.
    """
    theta = np.array(theta)
    r, J = _whitened(problem, theta, fit, W)
    cost = np.einsum("nk,nk->n", r, r)
    damping, growth = np.full(len(theta), 1e-3), np.full(len(theta), 2.0)
    centre, spread = (part[fit] for part in problem.stations_heard())
    d = problem.dims
    arrived = np.zeros(len(theta), dtype=bool)
    used = np.zeros(len(theta), dtype=np.int64)
    live = np.flatnonzero(np.isfinite(cost))
    while True:
        w, V, units, g = _normal(r[live], J[live])
        decrement = np.sum(g**2 / (w + RIDGE), axis=-1)
        small = decrement <= DECREMENT * (1.0 + 1e-3 * cost[live])
        last = np.einsum("nij,nj->ni", V[small], g[small] / (w[small] + RIDGE)) / units[small]
        theta[live[small]] += last  # too small to need a look at what it leads to
        arrived[live] = small | ((decrement <= ROUNDING) & (damping[live] > 1e6))
        go = ~arrived[live] & (used[live] < ITERATIONS)
        live = live[go]
        if live.size == 0:
            return Descent(theta, r, J, arrived, used)
        before = cost[live]
        reach = LEAP * (_length(theta[live, :d] - centre[live]) + spread[live])
        step, promised = _step(w[go], V[go], units[go], g[go], damping[live], reach, d)
        trial = theta[live] + step
        r_trial, J_trial = _whitened(problem, trial, fit[live], W.part(live))
        after = np.einsum("nk,nk->n", r_trial, r_trial)
        used[live] += 1
        better = after <= before
        won, lost = live[better], live[~better]
        theta[won], r[won], J[won] = trial[better], r_trial[better], J_trial[better]
        cost[won] = after[better]
        kept = (before[better] - after[better]) > 0.75 * promised[better]
        damping[won] = np.maximum(np.where(kept, 0.01, 0.3) * damping[won], 1e-12)
        growth[won] = 2.0
        damping[lost] = np.minimum(growth[lost] * damping[lost], 1e12)
        growth[lost] *= 2.0


def _normal(r: Array, J: Array) -> tuple[Array, Array, Array, Array]:
    """Spectrum w, V, units of J'J (see `spectrum`) and J'r in its eigenvectors and units."""
    w, V, units = spectrum(np.einsum("nki,nkj->nij", J, J))
    g = np.einsum("nki,nk->ni", J, r) / units
    return w, V, units, np.einsum("nij,ni->nj", V, g)


def _step(
    w: Array, V: Array, units: Array, g: Array, damping: Array, reach: Array, d: int
) -> tuple[Array, Array]:
    """Damped step (N, n), of which no eigenvector moves the first d beyond `reach` (N,) m.

    Second, by how much chi2 should fall (N,), if nothing holds the step back.
    """
    lam = damping[:, None]
    share = g / (w + lam + RIDGE)
    part = V * share[:, None, :] / units[..., None]
    length = _length(np.swapaxes(part[:, :d], -1, -2))
    held = reach[:, None] / np.maximum(length, reach[:, None])
    return np.einsum("nij,nj->ni", part, held), np.sum(share**2 * (w + 2.0 * lam), axis=-1)


def _length(x: Array) -> Array:
    """Length of vectors x (..., d)."""
    result: Array = np.sqrt(np.einsum("...i,...i->...", x, x))
    return result


def student_weight(e: Array) -> Array:
    """Weight (dof + 1)/(dof + e²), at most 1, of standardised residuals e under Student-t noise."""
    result: Array = np.minimum((STUDENT_DOF + 1.0) / (STUDENT_DOF + e**2), 1.0)
    return result


def student_cost(e: Array) -> Array:
    """Return minus twice the Student-t log-likelihood of standardised residuals (..., T, k)."""
    result: Array = (STUDENT_DOF + 1.0) * np.sum(np.log1p(e**2 / STUDENT_DOF), axis=(-2, -1))
    return result


def _typical(e: Array, present: Mask) -> Array:
    """Median size (N,) of the present residuals e (N, T, k), at least 1."""
    size = np.sort(np.where(present, np.abs(e), np.inf).reshape(len(e), -1), axis=-1)
    count = np.count_nonzero(present, axis=(-2, -1))
    middle = np.maximum(count - 1, 0) // 2
    if size.shape[-1] == 0:
        return np.ones(len(e))
    median = np.take_along_axis(size, middle[:, None], axis=-1)[:, 0]
    return np.where(count > 0, np.maximum(median, 1.0), 1.0)


def _whitened(problem: Problem, theta: Array, fit: Index, W: Whitening) -> tuple[Array, Array]:
    """Whitened residuals r (N, K) and their Jacobian J (N, K, n), the prior's rows behind."""
    nu, H = residuals(problem, theta, fit)
    N, n = theta.shape
    white = (W @ np.concatenate([H, nu[..., None]], axis=-1)).reshape(N, -1, n + 1)
    r, J = white[..., -1], white[..., :-1]
    if problem.velocity_std is None:
        return r, J
    d, std = problem.dims, problem.velocity_std
    prior = np.broadcast_to(np.eye(n)[d:] / std[:, None], (N, d, n))
    J = np.concatenate([J, prior], axis=-2)
    return np.concatenate([r, -theta[:, d:] / std], axis=-1), J


def _equal(R: Array, S: Array) -> Mask:
    """Whether noise R and S (..., k, k) are the same, for each trial point or for all."""
    scale = np.einsum("...ii->...i", np.abs(S))
    bound = 1e-9 * np.sqrt(scale[..., :, None] * scale[..., None, :])
    differ: Mask = np.abs(R - S) > bound  # NaN, where nothing is measured, is no difference
    return np.asarray(~np.any(differ, axis=(-3, -2, -1) if R.ndim == 4 else None))
