"""Mixing and prediction of the modes (ALGORITHMS §9.1 steps 1 to 3, §9.3), compiled.

The modes' states nest: mode i's components are the first ``n[i]`` of the largest mode's.
Arguments in capitals and x are where in the memory M a matrix or vector begins.
"""

from __future__ import annotations

import math

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.elementary import exp, log
from imm_tdoa.kernel.vectors import Lanes, choose, fill, get, put

BIRTH, UNBIASED, ZERO = 0, 1, 2


@compiled
def weights(
    lanes: Lanes, M: Array, r: int, log_p: int, Pi: int, positive: bool, w: int, log_c: int
) -> None:
    """Mixing weights w[i, j] of mode i in mode j, and predicted log-probabilities log_c[j].

    `positive`: no entry of the chain Pi[i, j] is zero; then the likeliest mode is in every
    mixture and one exponential per mode does.
    """
    if not positive:
        _weights_with_zeros(M, r, log_p, Pi, w, log_c)
        return
    top = get(lanes, M, log_p)
    for i in range(1, r):
        other = get(lanes, M, log_p + i)
        top = choose(other - top, other, top)
    for i in range(r):
        put(lanes, M, w + i * r, exp(get(lanes, M, log_p + i) - top))
    for j in range(r - 1, -1, -1):  # until its turn comes the first column holds the modes' share
        c = fill(lanes, 0.0)
        for i in range(r):
            c = c + get(lanes, M, w + i * r) * get(lanes, M, Pi + i * r + j)
        one = 1.0 / c
        for i in range(r):
            share = get(lanes, M, w + i * r) * get(lanes, M, Pi + i * r + j) * one
            put(lanes, M, w + i * r + j, share)
        put(lanes, M, log_c + j, log(c) + top)


@compiled
def _weights_with_zeros(M: Array, r: int, log_p: int, Pi: int, w: int, log_c: int) -> None:
    """The same for any chain; a mode that cannot be reached keeps its own state."""
    for lane in range(M.shape[1]):
        for j in range(r):
            top = -np.inf
            for i in range(r):
                if M[Pi + i * r + j, lane] > 0.0:
                    top = max(top, M[log_p + i, lane] + math.log(M[Pi + i * r + j, lane]))
            c = 0.0
            for i in range(r):
                chance, weight = M[Pi + i * r + j, lane], 0.0
                if chance > 0.0 and top > -np.inf:
                    weight = math.exp(M[log_p + i, lane] + math.log(chance) - top)
                M[w + i * r + j, lane] = weight
                c += weight
            M[log_c + j, lane] = math.log(c) + top if c > 0.0 else -np.inf
            for i in range(r):
                if c > 0.0:
                    M[w + i * r + j, lane] /= c
                else:
                    M[w + i * r + j, lane] = 1.0 if i == j else 0.0


@compiled
def mix(
    lanes: Lanes,
    M: Array,
    n: Index,
    j: int,
    rule: int,
    birth: Array,
    w: int,
    x: int,
    P: int,
    xm: int,
    Pm: int,
    d: int,
    wd: int,
) -> None:
    """Mixed mean xm[a] and covariance Pm[a, b] with which mode j begins the step.

    x, P: the first mode's, the others follow. `birth` (n,): variance of each component under the
    birth law. d, wd: scratch, (n, r).
    """
    r, size = len(n), n[j]
    xj, Pj = x, P
    for i in range(j):
        xj, Pj = xj + n[i], Pj + n[i] * n[i]
    for a in range(size):
        mean = fill(lanes, 0.0)
        xi = x
        for i in range(r):
            if a < n[i]:
                mean = mean + get(lanes, M, w + i * r + j) * get(lanes, M, xi + a)
            elif rule == UNBIASED:
                mean = mean + get(lanes, M, w + i * r + j) * get(lanes, M, xj + a)
            xi += n[i]
        put(lanes, M, xm + a, mean)
        xi = x
        for i in range(r):
            away = -mean
            if a < n[i]:
                away = get(lanes, M, xi + a) - mean
            elif rule == UNBIASED:
                away = get(lanes, M, xj + a) - mean
            put(lanes, M, d + a * r + i, away)
            put(lanes, M, wd + a * r + i, get(lanes, M, w + i * r + j) * away)
            xi += n[i]
        for b in range(a + 1):
            total = fill(lanes, 0.0)
            Pi = P
            for i in range(r):
                total = total + get(lanes, M, wd + a * r + i) * get(lanes, M, d + b * r + i)
                if a < n[i]:
                    share = get(lanes, M, w + i * r + j)
                    total = total + share * get(lanes, M, Pi + a * n[i] + b)
                elif b >= n[i] and rule == UNBIASED:
                    share = get(lanes, M, w + i * r + j)
                    total = total + share * get(lanes, M, Pj + a * size + b)
                elif a == b and rule == BIRTH:
                    total = total + get(lanes, M, w + i * r + j) * birth[a]
                Pi += n[i] * n[i]
            put(lanes, M, Pm + a * size + b, total)
            put(lanes, M, Pm + b * size + a, total)


@compiled
def predict(
    lanes: Lanes,
    M: Array,
    dims: int,
    order: int,
    f: int,
    pattern: Array,
    j: int,
    Q: int,
    xm: int,
    Pm: int,
    FP: int,
    x: int,
    P: int,
) -> None:
    """x = F xm, P = F Pm F' + Q, with F = f kron I.

    f: (order, order), per axis; `pattern`: (r, order, order), where that of mode j is not zero.
    FP: scratch.
    """
    n = order * dims
    for p in range(order):
        for i in range(dims):
            a = p * dims + i
            mean = fill(lanes, 0.0)
            for q in range(order):
                if pattern[j, p, q] != 0.0:
                    mean = mean + get(lanes, M, f + p * order + q) * get(
                        lanes, M, xm + q * dims + i
                    )
            put(lanes, M, x + a, mean)
            for b in range(n):
                total = fill(lanes, 0.0)
                for q in range(order):
                    if pattern[j, p, q] != 0.0:
                        here = Pm + (q * dims + i) * n + b
                        total = total + get(lanes, M, f + p * order + q) * get(lanes, M, here)
                put(lanes, M, FP + a * n + b, total)
    for p in range(order):
        for i in range(dims):
            b = p * dims + i
            for a in range(b, n):
                total = get(lanes, M, Q + a * n + b)
                for q in range(order):
                    if pattern[j, p, q] != 0.0:
                        here = FP + a * n + q * dims + i
                        total = total + get(lanes, M, here) * get(lanes, M, f + p * order + q)
                put(lanes, M, P + a * n + b, total)
                put(lanes, M, P + b * n + a, total)
