"""How well the modes foresaw a scan, and what they say together, compiled."""

from __future__ import annotations

import math

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel import updating
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.elementary import exp, finite, log
from imm_tdoa.kernel.memory import Where
from imm_tdoa.kernel.vectors import Lanes, anywhere, choose, fill, get, put


@compiled
def judge(lanes: Lanes, M: Array, at: Where, q: int) -> bool:
    """Normalised innovation squared against the moments of the whole bank; whether it has one."""
    moments(lanes, M, at, q)
    good = updating.factor(lanes, M, q, at.m, at.Sm, at.C, at.pivot)
    updating.whiten(lanes, M, q, at.m, at.C, at.pivot, at.mean, at.white)
    square = fill(lanes, 0.0)
    for i in range(q):
        square = square + get(lanes, M, at.white + i) * get(lanes, M, at.white + i)
    put(lanes, M, at.bank, square)
    return bool(good)


@compiled
def moments(lanes: Lanes, M: Array, at: Where, q: int) -> None:
    """Mean and covariance of the innovation under all modes together."""
    r, m = at.r, at.m
    for j in range(r):  # in the place of the mixing weights, which have done their work
        put(lanes, M, at.w + j, exp(get(lanes, M, at.log_c + j)))
    for i in range(q):
        middle = fill(lanes, 0.0)
        for j in range(r):
            share = get(lanes, M, at.w + j)
            middle = middle + share * get(lanes, M, at.nu + j * m + i)
        put(lanes, M, at.mean + i, middle)
        for k in range(i + 1):
            total = fill(lanes, 0.0)
            for j in range(r):
                share = get(lanes, M, at.w + j)
                di = get(lanes, M, at.nu + j * m + i) - middle
                dk = get(lanes, M, at.nu + j * m + k) - get(lanes, M, at.mean + k)
                own = get(lanes, M, at.S_ + j * m * m + i * m + k)
                total = total + share * (own + di * dk)
            put(lanes, M, at.Sm + i * m + k, total)


@compiled
def weigh(lanes: Lanes, M: Array, at: Where) -> int:
    """New mode probabilities and log-likelihood; the first lane that no mode explains, or -1."""
    top = fill(lanes, -np.inf)
    for j in range(at.r):
        log_p = get(lanes, M, at.log_c + j) + get(lanes, M, at.log_l + j)
        put(lanes, M, at.log_p + j, log_p)
        top = choose(log_p - top, log_p, top)
    total = fill(lanes, 0.0)
    for j in range(at.r):
        total = total + exp(get(lanes, M, at.log_p + j) - top)
    total = log(total) + top
    for j in range(at.r):
        put(lanes, M, at.log_p + j, get(lanes, M, at.log_p + j) - total)
    said = choose(get(lanes, M, at.heard), total, 0.0)  # what is not heard says nothing at all
    total = get(lanes, M, at.total) + said
    put(lanes, M, at.total, total)
    if anywhere(choose(finite(total), 0.0, 1.0)):
        for lane in range(len(lanes)):
            if not math.isfinite(M[at.total, lane]):
                return lane
    return -1


@compiled
def combine(log_p: int, n: Index, N: int, record: Array, estimate: Array) -> None:
    """Moments of all modes together, (N + N²,); a component that a mode lacks is zero in it."""
    estimate[:] = 0.0
    x = 0
    for j in range(len(n)):
        share = math.exp(record[log_p + j])
        for a in range(n[j]):
            estimate[a] += share * record[x + a]
        x += n[j]
    P = x
    x = 0
    for j in range(len(n)):
        share = math.exp(record[log_p + j])
        for a in range(N):
            da = (record[x + a] if a < n[j] else 0.0) - estimate[a]
            for b in range(N):
                db = (record[x + b] if b < n[j] else 0.0) - estimate[b]
                own = record[P + a * n[j] + b] if a < n[j] and b < n[j] else 0.0
                estimate[N + a * N + b] += share * (own + da * db)
        x += n[j]
        P += n[j] * n[j]
