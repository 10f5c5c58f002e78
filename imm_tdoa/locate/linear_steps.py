"""The linear steps of two-step estimators: Ho & Xu's first, and three second ones (§3.3, §3.4).

Unknowns are relative to the declared reference receiver: u = q - p_0, r_0, and with range rates
w = q' - p_0', r_0'; only the choice of coordinates, it changes no estimate. Error maps have a
column per independent unit source (see `receiver_errors`), those of the measurement first.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.locate.epochs import Epochs
from imm_tdoa.locate.receiver_errors import source_count, spread, whitener

Weights = Literal["both", "first", "none"]
SINGULAR = 1e-7  # least pivot of a factor whose columns have unit length
NEAR = 1e-9  # floor of a divisor, over the size of what it is part of


class Step(NamedTuple):
    """An estimate (N, n), its error map (N, n, e), and where the equations were regular (N,)."""

    theta: Array
    errors: Array
    regular: Mask


def solved(W: Array, G: Array, h: Array) -> tuple[Array, Array, Mask]:
    """Least squares of W h = W G theta: theta (N, n), the matrix P with theta = P h, and where.

    Columns are brought to unit length first: no result depends on units.
    """
    A = W @ G
    size = np.sqrt(np.einsum("nki,nki->ni", A, A))
    size = np.where(size > 0.0, size, 1.0)
    if A.shape[-2] < A.shape[-1]:  # fewer equations than unknowns anywhere in the batch
        P = np.zeros((len(A), A.shape[-1], A.shape[-2]))
        return np.zeros(P.shape[:2]), P, np.zeros(len(A), dtype=bool)
    Q, R = np.linalg.qr(A / size[:, None, :])
    regular: Mask = np.abs(np.einsum("nii->ni", R)).min(axis=-1) > SINGULAR
    R = np.where(regular[:, None, None], R, np.eye(A.shape[-1]))
    P = np.linalg.inv(R) @ np.swapaxes(Q, -1, -2) / size[..., None] @ W
    return np.einsum("nik,nk->ni", P, h), P, regular


def first_step(epochs: Epochs, weights: Weights, at: Array | None = None) -> Step:
    """Solve for [u; r_0] (and [w; r_0']) as if they were independent (§3.3).

    The weights are the inverse covariance of the differences, or that of the equations' errors
    where the emitter is `at` (N, n), as `first_step` or `with_ranges` gives it.
    """
    m = epochs.s.shape[1] - 1
    a, rho, there = epochs.s[:, 1:] - epochs.s[:, :1], epochs.z[:, :m], epochs.present[:, :m]
    h = 0.5 * (rho**2 - np.sum(a**2, axis=-1))
    G = -np.concatenate([a, rho[..., None]], axis=-1)
    if epochs.moving:
        da, rate = epochs.vs[:, 1:] - epochs.vs[:, :1], epochs.z[:, m:]
        hf = rho * rate - np.sum(a * da, axis=-1)
        Gf = -np.concatenate([da, rate[..., None], a, rho[..., None]], axis=-1)
        G = np.concatenate([np.concatenate([G, np.zeros_like(G)], axis=-1), Gf], axis=-2)
        h = np.concatenate([h, hf], axis=-1)
        there = np.concatenate([there, there & epochs.present[:, m:]], axis=-1)
    h, G = np.where(there, h, 0.0), np.where(there[..., None], G, 0.0)
    if at is None:
        M = epochs.root
    else:
        usable = np.isfinite(at).all(axis=-1, keepdims=True)
        M = _equation_errors(epochs, np.where(usable, at, 0.0))
        M = M if weights != "none" else M[..., : epochs.z.shape[-1]]
    theta, P, regular = solved(whitener(M, there), G, h)
    errors = np.where(there[..., None], _equation_errors(epochs, theta), 0.0)
    enough = np.count_nonzero(there, axis=-1) >= G.shape[-1]
    return Step(theta, P @ errors, regular & enough)


def with_ranges(epochs: Epochs, step: Step) -> Array:
    """Return the estimate [u; w] of a second step with its range and range rate, [u; r; w; r']."""
    d = epochs.dims
    u = step.theta[:, :d]
    r = np.sqrt(np.sum(u**2, axis=-1, keepdims=True))
    if not epochs.moving:
        return np.concatenate([u, r], axis=-1)
    w = step.theta[:, d:]
    rate = np.sum(u * w, axis=-1, keepdims=True) / np.where(r > 0.0, r, 1.0)
    return np.concatenate([u, r, w, rate], axis=-1)


def _equation_errors(epochs: Epochs, theta: Array) -> Array:
    """Error map (N, k, e) of the equations, half of xi_1 in §3.3: B_1 n + D_1 dp + E_1 dp'."""
    d, m = epochs.dims, epochs.s.shape[1] - 1
    u = theta[:, None, :d]
    away = u - (epochs.s[:, 1:] - epochs.s[:, :1])
    r = np.sqrt(np.sum(away**2, axis=-1))
    r = np.maximum(r, NEAR * np.max(r, axis=-1, keepdims=True) + 1e-300)
    first = np.broadcast_to(-u, away.shape)
    at_position = spread(away, first, epochs.position_root)
    root = epochs.root
    if not epochs.moving:
        return np.concatenate([r[..., None] * root, at_position], axis=-1)
    w = theta[:, None, d + 1 : 2 * d + 1]
    slip = w - (epochs.vs[:, 1:] - epochs.vs[:, :1])
    rate = np.sum(away * slip, axis=-1) / r
    at_velocity = spread(away, first, epochs.velocity_root)
    times = [r[..., None] * root[:, :m], at_position, np.zeros_like(at_velocity)]
    rates = [
        rate[..., None] * root[:, :m] + r[..., None] * root[:, m:],
        spread(slip, np.broadcast_to(-w, away.shape), epochs.position_root),
        at_velocity,
    ]
    return np.concatenate([np.concatenate(times, axis=-1), np.concatenate(rates, axis=-1)], axis=-2)


def _reference_errors(epochs: Epochs) -> tuple[Array, Array]:
    """Error maps (N, d, e) of the reference receiver's position and velocity."""
    N, d, k = len(epochs.z), epochs.dims, epochs.z.shape[-1]
    position, velocity = np.zeros((2, N, d, k + source_count(epochs)))
    start, width = k, epochs.s.shape[1] * d
    if epochs.position_root is not None:
        position[..., start : start + d] = epochs.position_root[:, 0]
        start += width
    if epochs.velocity_root is not None:
        velocity[..., start : start + d] = epochs.velocity_root[:, 0]
    return position, velocity


def no_step(epochs: Epochs, first: Step) -> Step:
    """Leave out what the first step knew of the range: [u; w]."""
    d = epochs.dims
    rows = np.r_[:d, d + 1 : 2 * d + 1] if epochs.moving else np.r_[:d]
    return Step(first.theta[:, rows], first.errors[:, rows], first.regular)


def error_correction(epochs: Epochs, first: Step, weights: Weights) -> Step:
    """Estimate the first step's errors from r_0 = |u| and r_0' = u'w / |u|, linearised (§3.4).

    theta_2 is the first estimate minus the truth and is taken off it (trap T16).

    References
    ----------
    C. Liu, L. Yang, F. Guo and W. Jiang, Acta Aeronautica et Astronautica Sinica 36(5),
    1617-1626, 2015; the first estimate of Source D.
    """
    d, k = epochs.dims, epochs.z.shape[-1]
    theta, N, n = first.theta, len(first.theta), first.theta.shape[-1]
    u = theta[:, :d]
    size = np.sqrt(np.sum(u**2, axis=-1))
    size = np.where(size > 0.0, size, 1.0)
    a = u / size[:, None]
    at_position, at_velocity = _reference_errors(epochs)
    G, h = np.zeros((N, n, n - (2 if epochs.moving else 1))), np.zeros((N, n))
    sign = np.full(n, -1.0)
    D = np.zeros((N, n, k + source_count(epochs)))
    G[:, :d, :d], G[:, d, :d] = np.eye(d), -a
    h[:, d], sign[d] = theta[:, d] - size, 1.0
    D[:, d] = np.einsum("ni,nie->ne", a, at_position)
    if epochs.moving:
        w = theta[:, d + 1 : 2 * d + 1]
        rate = np.sum(a * w, axis=-1)
        b = (w - rate[:, None] * a) / size[:, None]
        G[:, d + 1 : 2 * d + 1, d:] = np.eye(d)
        G[:, -1, :d], G[:, -1, d:] = -b, -a
        h[:, -1], sign[-1] = theta[:, -1] - rate, 1.0
        D[:, -1] = np.einsum("ni,nie->ne", b, at_position)
        D[:, -1] += np.einsum("ni,nie->ne", a, at_velocity)
    M = sign[:, None] * first.errors
    W = whitener(_weighed(M, D, weights, k), _rows(first.regular, n))
    correction, P, regular = solved(W, G, h)
    estimate = no_step(epochs, first).theta - correction
    return Step(estimate, -P @ (M + D), first.regular & regular)


def squared(epochs: Epochs, first: Step, weights: Weights) -> Step:
    """Impose the relations on squares and products u u, r_0², u w, r_0 r_0' (§3.3).

    Singular where a component of u is near zero (trap T15); `error_correction` is not.

    References
    ----------
    K. C. Ho and W. Xu, "An accurate algebraic solution for moving source location using TDOA
    and FDOA measurements", IEEE Trans. Signal Processing 52(9), 2453-2463, 2004.
    """
    d, k = epochs.dims, epochs.z.shape[-1]
    theta, N = first.theta, len(first.theta)
    p, own = theta[:, : d + 1], _reference_errors(epochs)
    p = _away_from_zero(p)
    D = np.zeros_like(first.errors)
    D[:, :d] = -own[0]
    relate = np.concatenate([np.eye(d), np.ones((1, d))])
    G, B, h = relate, 2.0 * p[..., None] * np.eye(d + 1), p**2
    if epochs.moving:
        v = theta[:, d + 1 :]
        D[:, d + 1 : 2 * d + 1] = -own[1]
        none = np.zeros_like(relate)
        G = np.block([[relate, none], [none, relate]])
        P, V = p[..., None] * np.eye(d + 1), v[..., None] * np.eye(d + 1)
        B = np.concatenate(
            [np.concatenate([B, np.zeros_like(B)], -1), np.concatenate([V, P], -1)], -2
        )
        h = np.concatenate([h, p * v], axis=-1)
    M, D = B @ first.errors, B @ D
    W = whitener(_weighed(M, D, weights, k), _rows(first.regular, h.shape[-1]))
    z, P2, regular = solved(W, np.broadcast_to(G, (N, *G.shape)), h)
    dz = P2 @ (M + D)
    u = _away_from_zero(np.where(p[:, :d] < 0.0, -1.0, 1.0) * np.sqrt(np.abs(z[:, :d])))
    du = dz[:, :d] / (2.0 * u[..., None])
    estimate, errors = [u], [du + own[0]]
    if epochs.moving:
        w = z[:, d:] / u
        estimate.append(w)
        errors.append((dz[:, d:] - w[..., None] * du) / u[..., None] + own[1])
    return Step(np.concatenate(estimate, -1), np.concatenate(errors, -2), first.regular & regular)


def _weighed(M: Array, D: Array, weights: Weights, k: int) -> Array:
    """The error map that the second step is weighted by: D_1 and D_2, D_1 alone, or neither."""
    if weights == "both":
        return M + D
    return M if weights == "first" else M[..., :k]


def _rows(regular: Mask, n: int) -> Mask:
    """Count all n rows of a regular estimate, none of a singular one."""
    return np.broadcast_to(regular[:, None], (len(regular), n))


def _away_from_zero(x: Array) -> Array:
    """Return x (N, n) with components not too near zero to divide by."""
    floor = NEAR * np.max(np.abs(x), axis=-1, keepdims=True) + 1e-300
    return np.where(np.abs(x) > floor, x, np.where(x < 0.0, -floor, floor))
