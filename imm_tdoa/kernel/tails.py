"""Errors with heavy tails: `imm_tdoa.robust.student_t`, compiled.

The weights of all lanes are found at once; those that are found stay as they are while others
are still sought.
"""

from __future__ import annotations

import math

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel import sources, updating
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.elementary import exp, finite, log
from imm_tdoa.kernel.gating import log_sum
from imm_tdoa.kernel.layout import Robust
from imm_tdoa.kernel.memory import Room, Where
from imm_tdoa.kernel.vectors import Lanes, Vector, anywhere, choose, fill, get, put
from imm_tdoa.robust import ROUNDS, SAME, SETTLED


@compiled
def student_t(
    lanes: Lanes,
    M: Array,
    at: Where,
    room: Room,
    how: Robust,
    block: int,
    targets: int,
    t: int,
    q: int,
    first: Index,
) -> bool:
    """Trust sources less, in place; whether the numbers held."""
    K, m, dof = how.directions.shape[3], at.m, how.degrees_of_freedom
    take_variances(lanes, M, at, room, how, block, targets, t, q)
    put(lanes, M, room.best, -np.inf)
    put(lanes, M, room.price, 0.0)
    for begin in range(2):
        for c in range(K):
            put(lanes, M, room.trial + c, 1.0)
        put(lanes, M, room.settled, 0.0)
        for turn in range(ROUNDS):
            square = room.foreseen
            if begin == 0 or turn > 0:  # both begin with the same weights
                square = room.square
                spread(lanes, M, at, room, q, K, room.trial)
                for j in range(at.r):
                    if not explain(lanes, M, at, room, q, j):
                        return False
                    errors(lanes, M, at, room, q, K, j, first)
                average(lanes, M, at, room, K, room.joint, square)
                if turn == 0:
                    average(lanes, M, at, room, K, at.log_c, room.foreseen)
            if settle(lanes, M, room, K, square, dof):
                break
        spread(lanes, M, at, room, q, K, room.trial)
        for j in range(at.r):
            if not explain(lanes, M, at, room, q, j):
                return False
        cost = fill(lanes, 0.0)
        for c in range(K):
            own = tail_price(get(lanes, M, room.trial + c), dof, how.constant, how.digamma)
            cost = cost + choose(get(lanes, M, room.heard + c), own, 0.0)
        best = get(lanes, M, room.best)
        bound = log_sum(lanes, M, room.joint, at.r) + cost
        better = bound - (best + SAME)
        put(lanes, M, room.best, choose(better, bound, best))
        put(lanes, M, room.price, choose(better, cost, get(lanes, M, room.price)))
        for c in range(K):
            lam = get(lanes, M, room.lam + c)
            put(lanes, M, room.lam + c, choose(better, get(lanes, M, room.trial + c), lam))
    weaken(lanes, M, at, room, q, K)
    spread(lanes, M, at, room, q, K, room.lam)
    for i in range(q):
        for k in range(i + 1):
            extra = get(lanes, M, room.extra + i * m + k)
            for j in range(at.r):
                S = at.S_ + j * m * m + i * m + k
                put(lanes, M, S, get(lanes, M, S) + extra)
            put(lanes, M, at.R + i * m + k, get(lanes, M, at.R + i * m + k) + extra)
            if k < i:
                put(lanes, M, at.R + k * m + i, get(lanes, M, at.R + i * m + k))
    return True


@compiled
def take_variances(
    lanes: Lanes,
    M: Array,
    at: Where,
    room: Room,
    how: Robust,
    block: int,
    targets: int,
    t: int,
    q: int,
) -> None:
    """Gather the sources' variances, and which sources show."""
    own, k = min(1, how.variance.shape[0] - 1), t if how.variance.shape[1] > 1 else 0
    for c in range(how.variance.shape[2]):
        for lane in range(len(lanes)):
            target = own * (block + min(lane, targets - 1))
            M[room.v + c, lane] = how.variance[target, k, c]
        v = get(lanes, M, room.v + c)
        shows = fill(lanes, 0.0)
        for i in range(q):
            d = get(lanes, M, room.D + c * at.m + i)
            shows = choose(d * d, 1.0, shows)
        heard = choose(finite(v), choose(v, shows, 0.0), 0.0)
        put(lanes, M, room.v + c, choose(finite(v), choose(v, v, 1.0), 1.0))
        put(lanes, M, room.heard + c, heard)
        put(lanes, M, room.lam + c, 1.0)
        for i in range(q):
            D = room.D + c * at.m + i
            put(lanes, M, D, choose(heard, get(lanes, M, D), 0.0))


@compiled
def spread(lanes: Lanes, M: Array, at: Where, room: Room, q: int, K: int, lam: int) -> None:
    """Variances by weights `lam`, and what that adds to the rows' covariance, lower triangle."""
    m = at.m
    for i in range(q):
        for k in range(i + 1):
            put(lanes, M, room.extra + i * m + k, 0.0)
    for c in range(K):
        v = get(lanes, M, room.v + c)
        noise = v / get(lanes, M, lam + c)
        put(lanes, M, room.noise + c, noise)
        more = noise - v
        for i in range(q):
            part = get(lanes, M, room.D + c * m + i) * more
            for k in range(i + 1):
                extra = room.extra + i * m + k
                total = get(lanes, M, extra) + part * get(lanes, M, room.D + c * m + k)
                put(lanes, M, extra, total)


@compiled
def explain(lanes: Lanes, M: Array, at: Where, room: Room, q: int, j: int) -> bool:
    """How well mode j explains the scan by the weights that are spread; whether it can."""
    m = at.m
    for i in range(q):
        for k in range(i + 1):
            own = get(lanes, M, at.S_ + j * m * m + i * m + k)
            put(lanes, M, at.Sm + i * m + k, own + get(lanes, M, room.extra + i * m + k))
    if not updating.factor(lanes, M, q, m, at.Sm, at.C, at.pivot):
        return False
    updating.whiten(lanes, M, q, m, at.C, at.pivot, at.nu + j * m, at.white)
    joint = room.joint + j
    updating.log_density(lanes, M, q, at.white, at.pivot, room.nothing, at.nis + j, joint)
    put(lanes, M, joint, get(lanes, M, joint) + get(lanes, M, at.log_c + j))
    return True


@compiled
def errors(
    lanes: Lanes, M: Array, at: Where, room: Room, q: int, K: int, j: int, first: Index
) -> None:
    """E[e²] of the sources' errors as mode j explains the scan."""
    m = at.m
    for c in range(K):
        D = room.D + c * m
        sources.test(
            lanes, M, q, m, at.C, at.pivot, at.white, D, first[c], at.E, room.score,
            room.information,
        )  # fmt: skip
        noise = get(lanes, M, room.noise + c)
        e = noise * get(lanes, M, room.score)
        left = noise - noise * noise * get(lanes, M, room.information)
        put(lanes, M, room.e2 + j * K + c, e * e + choose(left, left, 0.0))


@compiled
def average(
    lanes: Lanes, M: Array, at: Where, room: Room, K: int, log_share: int, square: int
) -> None:
    """E[e²] of the sources' errors under all modes together."""
    total = log_sum(lanes, M, log_share, at.r)
    for c in range(K):
        put(lanes, M, square + c, 0.0)
    for j in range(at.r):
        share = exp(get(lanes, M, log_share + j) - total)
        for c in range(K):
            own = share * get(lanes, M, room.e2 + j * K + c)
            put(lanes, M, square + c, get(lanes, M, square + c) + own)


@compiled
def settle(lanes: Lanes, M: Array, room: Room, K: int, square: int, dof: float) -> bool:
    """Take new weights where they are not yet found; whether they are now, in every lane."""
    settled, moving = get(lanes, M, room.settled), fill(lanes, 0.0)
    for c in range(K):
        v, lam = get(lanes, M, room.v + c), get(lanes, M, room.trial + c)
        new = (dof + 1.0) * v / (get(lanes, M, square + c) + dof * v)
        new = choose(get(lanes, M, room.heard + c), choose(new - 1.0, 1.0, new), 1.0)
        change = choose(new - lam, new - lam, lam - new)
        moving = choose(change - SETTLED * new, 1.0, moving)
        put(lanes, M, room.trial + c, choose(settled, lam, new))
    settled = choose(moving, settled, 1.0)
    put(lanes, M, room.settled, settled)
    return not anywhere(1.0 - settled)


@compiled
def tail_price(lam: Vector, dof: float, constant: float, digamma: float) -> Vector:
    """What the variational bound pays for trusting a source by `lam` instead of 1."""
    a, a0 = 0.5 * (dof + 1.0), 0.5 * dof
    log_b = math.log(a) - log(lam)
    divergence = constant + a0 * (log_b - math.log(a0)) + (a0 * lam - a)
    return 0.5 * (digamma - math.log(a)) - divergence


@compiled
def weaken(lanes: Lanes, M: Array, at: Where, room: Room, q: int, K: int) -> None:
    """Share of its information that each row keeps, and whether they keep half of it."""
    measured, left = fill(lanes, 0.0), fill(lanes, 0.0)
    for i in range(q):
        extra = fill(lanes, 0.0)
        for c in range(K):
            v, raw = get(lanes, M, room.v + c), get(lanes, M, room.raw + c * at.m + i)
            extra = extra + raw * raw * (v * (1.0 / get(lanes, M, room.lam + c) - 1.0))
        own, there = get(lanes, M, room.variance + i), get(lanes, M, at.present + i)
        share = choose(there, own / (own + extra), 1.0)
        put(lanes, M, at.row_weight + i, share)
        left = left + there * share
        measured = measured + there
    few = choose(left - 0.5 * measured, 0.0, 1.0)
    put(lanes, M, room.rejected, choose(measured, few, 0.0))
