"""Gaussian knowledge of which some directions may be unknown altogether.

A state is known up to x ~ N(., P) + D c, where nothing is known about the coefficients c: the
columns of D span what no information has reached yet, the limit of an infinite variance taken
exactly (de Jong 1991, "The diffuse Kalman filter"). With no columns it is a Gaussian. All is in
covariance form: no process noise, no transition and no information matrix is ever inverted, so
that all of them may be singular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array
from imm_tdoa.statespace import Lift, apply_lift

DETERMINED = 1e-6  # least singular value, of columns of unit length, that counts as information
ROUNDING = 1e-11  # what is left of a component, relative to its size before, when it is zero


class Knowledge(NamedTuple):
    """What is known of a state.

    Attributes
    ----------
    P : (..., n, n)
        Covariance of the known part.
    D : (..., n, k)
        Directions of which nothing is known; columns may be zero.
    """

    P: Array
    D: Array


def predict(known: Knowledge, F: Array, Q: Array) -> Knowledge:
    """Return what is known after x' = F x + w, w ~ N(0, Q)."""
    return Knowledge(gaussian.predict_covariance(known.P, F, Q), F @ known.D)


def lifted(known: Knowledge, lift: Lift) -> Knowledge:
    """Return what is known in another model's components (ALGORITHMS §9.3), by the birth law."""
    if lift.identity:
        return known
    n = len(lift.target) + len(lift.missing)
    _, P = apply_lift(lift, np.zeros(known.P.shape[:-1]), known.P, None)
    D = np.zeros((*known.D.shape[:-2], n, known.D.shape[-1]))
    D[..., lift.target, :] = known.D[..., lift.source, :]
    return Knowledge(P, D)


def inform(known: Knowledge, H: Array) -> Knowledge:
    """Return what is known after rows z = H x + v (..., m, n), v ~ N(0, I), were measured.

    A flat direction that the rows determine becomes part of the Gaussian: generalised least
    squares for its coefficient, whose error is independent of the update's own.
    """
    P, D = known
    n = P.shape[-1]
    Ht = np.swapaxes(H, -1, -2)
    L = gaussian.factor(gaussian.symmetric(H @ P @ Ht + np.eye(H.shape[-2])))
    W = np.linalg.solve(L, H)
    K = P @ np.swapaxes(np.linalg.solve(np.swapaxes(L, -1, -2), W), -1, -2)
    I_KH = np.eye(n) - K @ H
    P = I_KH @ P @ np.swapaxes(I_KH, -1, -2) + K @ np.swapaxes(K, -1, -2)
    if not np.any(D):
        return Knowledge(gaussian.symmetric(P), D[..., :0])
    length = np.linalg.norm(np.abs(W) @ np.abs(D), axis=-2, keepdims=True)
    D = D / np.where(length > 0.0, length, 1.0)
    _, s, Vt = np.linalg.svd(W @ D)
    k = D.shape[-1]
    s = np.concatenate([s, np.zeros((*s.shape[:-1], k))], axis=-1)[..., :k]
    determined = s > DETERMINED
    DV = D @ np.swapaxes(Vt, -1, -2)
    B = I_KH @ (DV * np.where(determined, 1.0 / np.where(determined, s, 1.0), 0.0)[..., None, :])
    P = P + B @ np.swapaxes(B, -1, -2)
    rounding = np.abs(DV) < ROUNDING * np.max(np.abs(D), axis=-1, keepdims=True)
    D = np.where(determined[..., None, :] | rounding, 0.0, DV)
    return Knowledge(gaussian.symmetric(P), D)


def rows(information: Array) -> Array:
    """Return H (..., n, n) with H' H = `information`, which may be singular and of mixed units."""
    units = np.sqrt(np.maximum(np.einsum("...ii->...i", information), 0.0))
    scale = np.where(units > 0.0, units, 1.0)
    w, V = np.linalg.eigh(information / (scale[..., :, None] * scale[..., None, :]))
    root = np.sqrt(np.maximum(w, 0.0))
    result: Array = root[..., :, None] * np.swapaxes(V, -1, -2) * units[..., None, :]
    return result


def covariance(known: Knowledge) -> Array:
    """Return the covariance (..., n, n): where nothing is known inf, its covariances NaN."""
    P, D = known
    size = np.abs(D)
    largest = np.max(size, axis=-2, keepdims=True, initial=0.0)
    flat = np.any(size > 1e-12 * largest, axis=-1)
    either = flat[..., :, None] | flat[..., None, :]
    apart = np.where(np.eye(P.shape[-1], dtype=bool), np.inf, np.nan)
    result: Array = np.where(either, apart, P)
    return result
