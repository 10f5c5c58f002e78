"""Damped Gauss-Newton over emitter and receivers together (ALGORITHMS §3.5).

The receivers' displacements are L w with L L' their declared covariance and w of unit prior
variance, so that receivers known exactly need no special case. w is eliminated from every step:
the normal equations are those of the emitter alone with the noise Q + A A' / (1 + lambda), and
the matrix inverted has the size of the measurement, whatever the number of receivers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.locate.epochs import Epochs
from imm_tdoa.locate.normal import spectrum
from imm_tdoa.locate.receiver_errors import Linear, linearised, source_count, whitener

PROMISE = 1e-8  # a step that would lower the cost by less has arrived
DAMPING = 1e-4  # at first; it is multiplied by 10 when a step fails, divided by 10 when it holds
LOOSE = 1e-2  # damping above which a small step is no sign of having arrived
RIDGE = 1e-14  # keeps a singular normal matrix from dividing by zero


class Joint(NamedTuple):
    """Emitters x (N, n), receivers' unit sources w (N, j), cost (N,), arrived (N,), steps (N,)."""

    x: Array
    w: Array
    cost: Array
    arrived: Mask
    iterations: Index


def descend(epochs: Epochs, start: Array, iterations: int) -> Joint:
    """Minimise (z - g(x, w))' Q^-1 (z - g(x, w)) + w'w from x = `start` (N, n), w = 0.

    Levenberg-Marquardt with damping lambda diag(A) on the emitter and lambda I on w. A step is
    taken only where it lowers the cost; each one tried counts. NaN starts stay as they are.
    """
    N = len(start)
    x, w = np.array(start), np.zeros((N, source_count(epochs)))
    known = np.isfinite(x).all(axis=-1)
    W = whitener(epochs.root, epochs.present)
    cost, damping = np.full(N, np.inf), np.full(N, DAMPING)
    cost[known] = _cost(epochs.part(known), W[known], x[known], w[known])
    arrived, used = np.zeros(N, dtype=bool), np.zeros(N, dtype=np.int64)
    live = np.flatnonzero(known & np.isfinite(cost))
    for _ in range(iterations):
        if live.size == 0:
            break
        part, Wl = epochs.part(live), W[live]
        at = linearised(part, x[live], w[live])
        dx, w_new = step(part, at, w[live], damping[live])
        promised = cost[live] - _linear_cost(at, Wl, dx, w[live], w_new)
        x_new = x[live] + dx
        now = _cost(part, Wl, x_new, w_new)
        used[live] += 1
        small = (promised <= PROMISE) & (damping[live] <= LOOSE)
        better = now < cost[live]
        done = small & (now <= cost[live] + PROMISE)
        take = better | done
        x[live[take]], w[live[take]], cost[live[take]] = x_new[take], w_new[take], now[take]
        damping[live] *= np.where(take, 0.1, 10.0)
        arrived[live[done]] = True
        live = live[~done & (damping[live] < 1e12)]
    return Joint(x, w, cost, arrived, used)


def step(epochs: Epochs, at: Linear, w: Array, damping: Array) -> tuple[Array, Array]:
    """Return the damped step dx (N, n) of the emitter, and the receivers' new w (N, j).

    w has the prior N(0, I) and is held to where it is with precision lambda: together
    N(m, I / (1 + lambda)) with m = lambda w / (1 + lambda).
    """
    lam = damping[:, None]
    m = w * lam / (1.0 + lam)
    A = at.A / np.sqrt(1.0 + lam)[..., None]
    W = whitener(np.concatenate([epochs.root, A], axis=-1), epochs.present)
    e = at.e + np.einsum("nkj,nj->nk", at.A, w - m)
    J, r = W @ at.J, np.einsum("nij,nj->ni", W, e)
    values, V, units = spectrum(np.swapaxes(J, -1, -2) @ J)
    g = np.einsum("nji,nj->ni", V, np.einsum("nki,nk->ni", J, r) / units)
    dx = np.einsum("nij,nj->ni", V, g / (values + lam + RIDGE)) / units
    left = r - np.einsum("nki,ni->nk", J, dx)
    pull = np.einsum("nkj,nk->nj", W @ A, left) / np.sqrt(1.0 + lam)
    return dx, m + pull


def station_covariance(epochs: Epochs, x: Array, w: Array) -> Array:
    """Return the covariance (N, K, d, d) of each receiver's position after the joint fit.

    L (I - A' (S^-1 - S^-1 J C J' S^-1) A) L', S = Q + A A', C = (J' S^-1 J)^-1, its diagonal
    blocks. Zero where the position is known exactly.
    """
    N, K, d = epochs.s.shape
    if epochs.position_root is None:
        return np.zeros((N, K, d, d))
    at = linearised(epochs, x, w)
    W = whitener(np.concatenate([epochs.root, at.A], axis=-1), epochs.present)
    J, A = W @ at.J, W @ at.A[..., : K * d]
    Q, _ = np.linalg.qr(J)
    A = A - Q @ (np.swapaxes(Q, -1, -2) @ A)
    A = A.reshape(N, -1, K, d)
    known = np.eye(d) - np.einsum("nmka,nmkb->nkab", A, A)
    L = epochs.position_root
    result: Array = L @ known @ np.swapaxes(L, -1, -2)
    return result


def _cost(epochs: Epochs, W: Array, x: Array, w: Array) -> Array:
    e = np.einsum("nij,nj->ni", W, linearised(epochs, x, w).e)
    return np.asarray(np.einsum("ni,ni->n", e, e) + np.einsum("nj,nj->n", w, w))


def _linear_cost(at: Linear, W: Array, dx: Array, w: Array, w_new: Array) -> Array:
    """The cost that the linearisation promises after a step."""
    e = at.e - np.einsum("nki,ni->nk", at.J, dx) - np.einsum("nkj,nj->nk", at.A, w_new - w)
    e = np.einsum("nij,nj->ni", W, e)
    return np.asarray(np.einsum("ni,ni->n", e, e) + np.einsum("nj,nj->n", w_new, w_new))
