"""Differences as functions of the emitter and of receivers that are not exactly where they say.

First-order theory throughout: errors are linear in independent unit sources, first those of the
measurement, then those of the receivers' positions, then of their velocities. A matrix with a
column per source (an error map) gives the covariance M M' of anything, and all correlations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import range_rates, ranges
from imm_tdoa.locate.epochs import Epochs
from imm_tdoa.locate.normal import inverse

SINGULAR = 1e-12  # least pivot of a factor whose rows have unit length


class Linear(NamedTuple):
    """Differences predicted at some place, and their derivatives; missing rows are zero.

    e : (N, k) measured minus predicted; J : (N, k, n) by position (and velocity) of the emitter;
    A : (N, k, w) by the receivers' unit error sources.
    """

    e: Array
    J: Array
    A: Array


def spread(own: Array, reference: Array, root: Array | None) -> Array:
    """Map (N, K - 1, K * d) of the receivers' unit sources to rows.

    Row i feels the error of its own station i + 1 through `own` (N, K - 1, d) and that of the
    reference through `reference` (N, K - 1, d). Without `root` (N, K, d, d) there is no source.
    """
    N, m, d = own.shape
    if root is None:
        return np.zeros((N, m, 0))
    result = np.zeros((N, m, m + 1, d))
    row = np.arange(m)
    result[:, row, row + 1] = np.einsum("nia,niab->nib", own, root[:, 1:])
    result[:, :, 0] = np.einsum("nia,nab->nib", reference, root[:, 0])
    return result.reshape(N, m, (m + 1) * d)


def receivers(epochs: Epochs, sources: Array) -> tuple[Array, Array]:
    """Return receiver positions and velocities (N, K, d) for unit sources (N, w)."""
    s, vs, start = epochs.s, epochs.vs, 0
    if epochs.position_root is not None:
        start = s.shape[1] * s.shape[2]
        s = s + np.einsum(
            "nkab,nkb->nka", epochs.position_root, sources[:, :start].reshape(s.shape)
        )
    if epochs.velocity_root is not None:
        rest = sources[:, start:].reshape(s.shape)
        vs = vs + np.einsum("nkab,nkb->nka", epochs.velocity_root, rest)
    return s, vs


def source_count(epochs: Epochs) -> int:
    """Number w of the receivers' unit sources."""
    each = (epochs.position_root, epochs.velocity_root)
    return sum(int(np.prod(root.shape[1:3])) for root in each if root is not None)


def linearised(epochs: Epochs, x: Array, sources: Array) -> Linear:
    """Compare the differences with those of an emitter at x (N, n) and receivers so displaced.

    The Jacobian of §3.5: with u_i the direction from station i, b_i the gradient of its range
    rate, rows [u_i' - u_0', 0] and [b_i' - b_0', u_i' - u_0'] by the emitter.
    """
    d = epochs.dims
    s, vs = receivers(epochs, sources)
    q = x[:, :d]
    r, u = ranges(q, s)
    J = u[:, 1:] - u[:, :1]
    first = np.broadcast_to(u[:, :1], J.shape)
    h = r[:, 1:] - r[:, :1]
    A = spread(-u[:, 1:], first, epochs.position_root)
    if epochs.moving:
        rate, b, u = range_rates(q, x[:, d:], s, vs)
        h = np.concatenate([h, rate[:, 1:] - rate[:, :1]], axis=-1)
        Jf = np.concatenate([b[:, 1:] - b[:, :1], J], axis=-1)
        J = np.concatenate([np.concatenate([J, np.zeros_like(J)], axis=-1), Jf], axis=-2)
        b0 = np.broadcast_to(b[:, :1], first.shape)
        Af = spread(-b[:, 1:], b0, epochs.position_root)
        velocity = spread(-u[:, 1:], first, epochs.velocity_root)
        A = np.concatenate(
            [
                np.concatenate([A, np.zeros_like(velocity)], axis=-1),
                np.concatenate([Af, velocity], axis=-1),
            ],
            axis=-2,
        )
    there = epochs.present
    return Linear(
        np.where(there, epochs.z - h, 0.0),
        np.where(there[..., None], J, 0.0),
        np.where(there[..., None], A, 0.0),
    )


def whitener(M: Array, there: Mask) -> Array:
    """Return W (N, k, k) with W M M' W' = I on the rows that are `there` (N, k), else zero.

    From a triangular factor of M itself, its rows brought to unit length: M M' would square its
    condition. Zero throughout where M is singular to working accuracy.
    """
    size = np.sqrt(np.einsum("nke,nke->nk", M, M))
    usable = there & (size > 0.0) & np.isfinite(size)
    size = np.where(usable, size, 1.0)
    unit = np.where(usable[..., None], M / size[..., None], 0.0)
    lone = np.where(usable, 0.0, 1.0)[..., None] * np.eye(there.shape[-1])
    both = np.concatenate([unit, lone], axis=-1)
    R = np.asarray(np.linalg.qr(np.swapaxes(both, -1, -2), mode="r"), dtype=float)
    regular = np.abs(np.einsum("nii->ni", R)).min(axis=-1) > SINGULAR
    regular &= ~np.any(there & ~usable, axis=-1)
    R = np.where(regular[:, None, None], R, np.eye(there.shape[-1]))
    W = np.linalg.inv(np.swapaxes(R, -1, -2)) / size[:, None, :]
    counted = there[..., None] & there[:, None, :] & regular[:, None, None]
    return np.where(counted, W, 0.0)


def judged(epochs: Epochs, x: Array) -> tuple[Array, Array, Mask]:
    """Return the bound (N, n, n) of §3.6 at x (N, n), chi2 (N,) there, and where it is regular.

    The receivers' errors are part of the noise: Q + J_s Q_s J_s'. NaN where the geometry
    determines no x.
    """
    known: Mask = np.asarray(np.isfinite(x).all(axis=-1))
    at = np.where(known[:, None], x, 0.0)
    e, J, A = linearised(epochs, at, np.zeros((len(x), source_count(epochs))))
    W = whitener(np.concatenate([epochs.root, A], axis=-1), epochs.present)
    J, e = W @ J, np.einsum("nij,nj->ni", W, e)
    covariance, regular = inverse(np.swapaxes(J, -1, -2) @ J)
    good: Mask = np.asarray(known & regular)
    chi2 = np.einsum("ni,ni->n", e, e) + epochs.excess
    return np.where(good[:, None, None], covariance, np.nan), np.where(good, chi2, np.nan), good
