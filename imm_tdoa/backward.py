"""One step back in time of one Gaussian: what later scans say of it (ALGORITHMS §9.5)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa import sigma_points
from imm_tdoa.contract import Array, Index, LinearMotion, MotionModel
from imm_tdoa.gaussian import predict_covariance, symmetric
from imm_tdoa.sigma_points import SINGULAR, Rule
from imm_tdoa.statespace import Lift

FARTHEST = 3.0  # standard deviations that a smoothed mean may lie from what it follows


class Line(NamedTuple):
    """A motion made straight: the state after x is y + F (x - x_0) + w, w ~ N(0, Q)."""

    y: Array
    F: Array
    Q: Array


class Future(NamedTuple):
    """What all later scans say of a mode's state x: exp(-v' diag(precision) v / 2 + y' v).

    v = T (x - x_0) are coordinates in which the mode's own prediction has mean 0 and covariance I.
    """

    x_0: Array
    T: Array
    precision: Array
    y: Array


def linearised(
    model: MotionModel, x: Array, P: Array, dt: Array, dims: int, rule: Rule | None
) -> Line:
    """Make a motion over `dt` (...) s straight, at x (..., n) or over N(x, P) by the rule's points.

    The same as in `imm_tdoa.prediction.predict`, with the line itself.

    Parameters
    ----------
    model : MotionModel
        Of the mode.
    x, P : (..., n), (..., n, n)
        Where it is linearised.
    dt : (...)
        Time step, s.
    dims : int
        Space dimensions.
    rule : "ukf", "ckf" or None
        Sigma points; None: at the mean.
    """
    Q = model.process_noise(dt, dims)
    if rule is None or isinstance(model, LinearMotion):
        return Line(model.propagate(x, dt), model.jacobian(x, dt), Q)
    line = sigma_points.fit(lambda s: model.propagate(s, dt[..., None]), x, P, rule)
    return Line(line.y, line.H, Q + line.rest)


def future_of(x_p: Array, P_p: Array, x_s: Array, P_s: Array) -> Future:
    """Return the likelihood that turned the prediction N(x_p, P_p) into N(x_s, P_s).

    Means are (..., n), covariances (..., n, n); P_p may be singular: a direction without variance
    has nothing to learn. Where merging left a direction less certain than it was predicted, no
    likelihood can have done it; there, one is taken that moves the mean as far and that 3 standard
    deviations bound.

    Parameters
    ----------
    x_p, P_p : (..., n), (..., n, n)
        What the past says.
    x_s, P_s : (..., n), (..., n, n)
        What past and future say together.
    """
    W = _root(P_p)
    s, V = np.linalg.eigh(symmetric(W @ P_s @ np.swapaxes(W, -1, -2)))
    T = np.swapaxes(V, -1, -2) @ W
    moved = np.einsum("...ij,...j->...i", T, x_s - x_p)
    bound = np.clip(1.0 - (moved / FARTHEST) ** 2, 0.1, 1.0)
    s = np.where(s < 1.0, np.maximum(s, SINGULAR), bound)
    regular = np.where(np.any(W != 0.0, axis=-1), 1.0, 0.0)
    known = np.einsum("...ij,...i->...j", V**2, regular) > 0.5
    return Future(x_p, T, np.where(known, 1.0 / s - 1.0, 0.0), moved / s)


def updated(x: Array, P: Array, line: Line, future: Future) -> tuple[Array, Array, Array]:
    """Update Gaussians by what the future says of them; Joseph form.

    Parameters
    ----------
    x, P : (..., r, n), (..., r, n, n)
        States now, r hypotheses of the same mode's.
    line : Line
        Their motion until then, linearised at x.
    future : Future
        What is said of the state then, (..., n).

    Returns
    -------
    x, P, log_evidence : (..., r, n), (..., r, n, n), (..., r)
        The states given the future, and E[L] of each, up to what all r have in common. With
        v ~ N(m, p) the prediction, a = root m and B = I + root p root, root² the precision,

            log E[L] = -(log det B + a' B^-1 a)/2 + y' (m - p root B^-1 a)
                       + y' (p - p root B^-1 root p) y / 2.
    """
    T, y = future.T[..., None, :, :], future.y[..., None, :]
    root = np.sqrt(future.precision)[..., None, :]
    A = T @ line.F
    U = P @ np.swapaxes(A, -1, -2)
    rest = T @ line.Q @ np.swapaxes(T, -1, -2)
    p = symmetric(A @ U + rest)
    m = np.einsum("...ij,...j->...i", T, line.y - future.x_0[..., None, :])
    a = root * m
    eye = np.eye(x.shape[-1])
    B = eye + root[..., :, None] * p * root[..., None, :]
    K = np.swapaxes(np.linalg.solve(B, root[..., :, None] * np.swapaxes(U, -1, -2)), -1, -2)
    py = np.einsum("...ij,...j->...i", p, np.broadcast_to(y, m.shape))
    ab = np.linalg.solve(B, np.stack([a, root * py], axis=-1))
    x_s = x + np.einsum("...ij,...j->...i", U, np.broadcast_to(y, m.shape))
    x_s = x_s - np.einsum("...ij,...j->...i", K, a + root * py)
    I_KA = eye - K @ (root[..., :, None] * A)
    noise = eye + root[..., :, None] * rest * root[..., None, :]
    P_s = symmetric(I_KA @ P @ np.swapaxes(I_KA, -1, -2) + K @ noise @ np.swapaxes(K, -1, -2))
    log_density = (
        -0.5 * np.linalg.slogdet(B)[1]
        - 0.5 * np.sum(a * ab[..., 0], axis=-1)
        + np.sum(y * m - py * root * ab[..., 0], axis=-1)
        + 0.5 * np.sum(py * (y - root * ab[..., 1]), axis=-1)
    )
    return x_s, P_s, log_density


def regressed(x: Array, P: Array, line: Line, x_s: Array, P_s: Array) -> tuple[Array, Array]:
    """Rauch-Tung-Striebel step: N(x, P) (..., r, n) when `line` is to end in N(x_s, P_s) (..., n).

    For Kim's approximation. The prediction may be singular (pseudo-inverse).

    Parameters
    ----------
    x, P : (..., r, n), (..., r, n, n)
        States now.
    line : Line
        Their motion until then.
    x_s, P_s : (..., n), (..., n, n)
        The smoothed state then.
    """
    cross = P @ np.swapaxes(line.F, -1, -2)
    gain, rest = _conditional(P, cross, _root(predict_covariance(P, line.F, line.Q)))
    x = x + np.einsum("...ij,...j->...i", gain, x_s[..., None, :] - line.y)
    return x, symmetric(rest + gain @ P_s[..., None, :, :] @ np.swapaxes(gain, -1, -2))


def returned(lift: Lift, x: Array, P: Array, x_s: Array, P_s: Array) -> tuple[Array, Array]:
    """Bring a smoothed state back into the components of the mode N(x, P) that it came from.

    What the later mode does not have is regressed on what both have.

    Parameters
    ----------
    lift : Lift
        From the earlier mode to the later one.
    x, P : (..., n), (..., n, n)
        The earlier mode's own state.
    x_s, P_s : (..., k), (..., k, k)
        The smoothed state in the later mode's components.
    """
    if lift.identity:
        return x_s, P_s
    c, t = lift.source, lift.target
    d: Index = np.setdiff1d(np.arange(x.shape[-1]), c)
    x_c, P_c = x_s[..., t], P_s[..., t[:, None], t]
    root = _root(P[..., c[:, None], c])
    G, rest = _conditional(P[..., d[:, None], d], P[..., d[:, None], c], root)
    X, C, GP = np.empty_like(x), np.empty_like(P), G @ P_c
    X[..., c] = x_c
    X[..., d] = x[..., d] + np.einsum("...ij,...j->...i", G, x_c - x[..., c])
    C[..., c[:, None], c] = P_c
    C[..., d[:, None], c] = GP
    C[..., c[:, None], d] = np.swapaxes(GP, -1, -2)
    C[..., d[:, None], d] = symmetric(rest + GP @ np.swapaxes(G, -1, -2))
    return X, C


def _root(P: Array) -> Array:
    """W with W P W' = I where P (..., n, n) is regular, judged by its correlations; else zero."""
    return sigma_points.roots(P)[1]


def _conditional(P: Array, cross: Array, W: Array) -> tuple[Array, Array]:
    """Regress a Gaussian of covariance P on another, of whitener W and covariance `cross` with it.

    Returns the gain and what remains of P once the other is known, positive semi-definite.
    """
    U = cross @ np.swapaxes(W, -1, -2)
    variance = np.einsum("...ii->...i", P)
    sd = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    scale = sd[..., :, None] * sd[..., None, :]
    w, V = np.linalg.eigh(symmetric(P - U @ np.swapaxes(U, -1, -2)) / scale)
    rest = (V * np.maximum(w, 0.0)[..., None, :]) @ np.swapaxes(V, -1, -2) * scale
    return U @ W, symmetric(rest)
