"""Slow, plain restatements of the filters, to judge the library by.

Written from the textbook equations alone, one target at a time, with loops, explicit inverses and
linear-domain weights, and without a line of the library.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
C = 299_792_458.0


def log_normal(nu: Array, S: Array) -> float:
    """Log-density of N(0, S) at nu, by determinant and inverse."""
    _, log_det = np.linalg.slogdet(2.0 * np.pi * S)
    return float(-0.5 * (nu @ np.linalg.inv(S) @ nu + log_det))


def kalman(
    x: Array, P: Array, F: Array, Q: Array, z: Array, H: Array, R: Array
) -> tuple[Array, Array, float]:
    """One cycle of the Kalman filter; rows of z that are NaN are cut out."""
    x, P = F @ x, F @ P @ F.T + Q
    keep = np.isfinite(z)
    return correct(x, P, (z - H @ x)[keep], H[keep], R[np.ix_(keep, keep)])


def correct(x: Array, P: Array, nu: Array, H: Array, R: Array) -> tuple[Array, Array, float]:
    """Kalman update with innovation nu; log-likelihood 0 where there is no row."""
    if len(nu) == 0:
        return x, P, 0.0
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return x + K @ nu, P - K @ S @ K.T, log_normal(nu, S)


def range_differences(p: Array, stations: Array, pairs: Array) -> tuple[Array, Array]:
    """Range differences (m,) and their Jacobian (m, d), pair by pair."""
    h, H = np.zeros(len(pairs)), np.zeros((len(pairs), len(p)))
    for row, (i, j) in enumerate(pairs):
        a, b = p - stations[i], p - stations[j]
        h[row] = np.linalg.norm(a) - np.linalg.norm(b)
        H[row] = a / np.linalg.norm(a) - b / np.linalg.norm(b)
    return h, H


def pair_covariance(variance: Sequence[float], pairs: Array) -> Array:
    """Covariance of differences of independent arrivals, entry by entry (ALGORITHMS §1.1)."""
    R = np.zeros((len(pairs), len(pairs)))
    for a, (i, j) in enumerate(pairs):
        for b, (k, m) in enumerate(pairs):
            R[a, b] = variance[i] * (int(i == k) - int(i == m))
            R[a, b] -= variance[j] * (int(j == k) - int(j == m))
    return R


def polynomial(order: int, dt: float, psd: float, d: int) -> tuple[Array, Array]:
    """F and Q of a chain of integrators driven by continuous white noise (ALGORITHMS §2)."""
    f = {
        0: [[1.0]],
        1: [[1.0, dt], [0.0, 1.0]],
        2: [[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]],
    }[order]
    q = {
        0: [[dt]],
        1: [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]],
        2: [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ],
    }[order]
    return np.kron(f, np.eye(d)), psd * np.kron(q, np.eye(d))


class Mode(NamedTuple):
    """A linear mode: component names, and F and Q as functions of the time step."""

    names: tuple[str, ...]
    F: Callable[[float], Array]
    Q: Callable[[float], Array]


class Posterior(NamedTuple):
    """Modes' means, covariances and probabilities, and the cumulative log-likelihood."""

    x: list[Array]
    P: list[Array]
    mu: Array
    log_likelihood: float


def lifted(
    x: Array, P: Array, source: Sequence[str], target: Sequence[str], e: Array, E: Array
) -> tuple[Array, Array]:
    """Mean and covariance of the `target` components; those `source` lacks are N(e, E)."""
    n = len(target)
    y, Y = np.zeros(n), np.zeros((n, n))
    for a, name in enumerate(target):
        y[a] = x[source.index(name)] if name in source else e[a]
        for b, other in enumerate(target):
            if name in source and other in source:
                Y[a, b] = P[source.index(name), source.index(other)]
            elif name not in source and other not in source:
                Y[a, b] = E[a, b]
    return y, Y


def mixture_moments(
    weights: Sequence[float], xs: Sequence[Array], Ps: Sequence[Array]
) -> tuple[Array, Array]:
    """Mean and covariance by raw second moments, E[xx'] - mm'."""
    m = sum(w * x for w, x in zip(weights, xs, strict=True))
    M = sum(w * (P + np.outer(x, x)) for w, x, P in zip(weights, xs, Ps, strict=True))
    return np.asarray(m), np.asarray(M - np.outer(m, m))


def imm_step(
    modes: Sequence[Mode],
    prior: Posterior,
    Pi: Array,
    dt: float,
    innovation: Callable[[int, Array], tuple[Array, Array, Array]],
    mixing: str = "birth",
    birth: Callable[[str], float] = lambda name: 0.0,
) -> Posterior:
    """One cycle of the IMM (ALGORITHMS §9.1) in the linear domain.

    `innovation(j, x)` gives nu, H and R of mode j at its prediction x, missing rows cut out;
    `birth(name)` the variance of a component that a mode lacks.
    """
    r = len(modes)
    c = [sum(prior.mu[i] * Pi[i, j] for i in range(r)) for j in range(r)]
    xs, Ps, weights = [], [], []
    for j, mode in enumerate(modes):
        if mixing == "birth":
            e, E = np.zeros(len(mode.names)), np.diag([birth(n) for n in mode.names])
        elif mixing == "unbiased":
            e, E = prior.x[j], prior.P[j]
        else:
            e, E = np.zeros(len(mode.names)), np.zeros((len(mode.names),) * 2)
        parts = [lifted(prior.x[i], prior.P[i], modes[i].names, mode.names, e, E) for i in range(r)]
        share = [prior.mu[i] * Pi[i, j] / c[j] if c[j] > 0 else float(i == j) for i in range(r)]
        x, P = mixture_moments(share, [p[0] for p in parts], [p[1] for p in parts])
        x, P = mode.F(dt) @ x, mode.F(dt) @ P @ mode.F(dt).T + mode.Q(dt)
        x, P, log_l = correct(x, P, *innovation(j, x))
        xs.append(x)
        Ps.append(P)
        weights.append(log_l)
    top = max(w for w, cj in zip(weights, c, strict=True) if cj > 0)
    joint = np.array([cj * np.exp(w - top) for w, cj in zip(weights, c, strict=True)])
    total = joint.sum()
    return Posterior(xs, Ps, joint / total, prior.log_likelihood + float(np.log(total)) + top)


def exact(
    modes: Sequence[Mode],
    prior: Sequence[float],
    Pi: Array,
    x: Array,
    P: Array,
    z: Sequence[float],
    H: Array,
    R: Array,
) -> tuple[list[Array], list[float]]:
    """Pr(mode now | z) and log p(z) at each unit step, by enumeration of all mode histories."""
    r, probability, evidence = len(modes), [], []
    for k in range(1, len(z) + 1):
        now = np.zeros(r)
        for history in product(range(r), repeat=k + 1):
            weight, m, C_ = float(prior[history[0]]), x, P
            for before, after, value in zip(history[:-1], history[1:], z[:k], strict=True):
                mode = modes[after]
                m, C_, log_l = kalman(m, C_, mode.F(1.0), mode.Q(1.0), np.array([value]), H, R)
                weight *= Pi[before, after] * np.exp(log_l)
            now[history[-1]] += weight
        probability.append(now / now.sum())
        evidence.append(float(np.log(now.sum())))
    return probability, evidence
