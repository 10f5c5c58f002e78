"""The gate for gross errors: `imm_tdoa.robust.gate`, compiled.

All lanes are judged at once, and again for as long as a source has to go in any of them; what is
done where one goes is done in that lane alone.
"""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel import offsets, sources, updating, weighing
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.elementary import exp, finite, log
from imm_tdoa.kernel.memory import Room, Where
from imm_tdoa.kernel.vectors import Lanes, Vector, anywhere, choose, fill, get, put, sqrt
from imm_tdoa.robust import AMBIGUOUS, TESTABLE

CLEAN, CHANGED, INDEFINITE = 0, 1, 2


@compiled
def gate(
    lanes: Lanes,
    M: Array,
    at: Where,
    room: Room,
    q: int,
    columns: Index,
    threshold: float,
    count: int,
    first: Index,
    reference: Index,
) -> int:
    """Leave out sources in place: `CLEAN` where none goes, else `CHANGED`; or `INDEFINITE`."""
    before = fill(lanes, 0.0)
    for i in range(q):
        there = get(lanes, M, at.free + i)
        put(lanes, M, room.there + i, there)
        before = before + there
    for c in range(count):
        put(lanes, M, room.suspect + c, 0.0)
    put(lanes, M, room.gone, 0.0)
    put(lanes, M, room.price, 0.0)
    put(lanes, M, room.rejected, 0.0)
    weighing.moments(lanes, M, at, q)
    for turn in range(q + 1):
        if not judge(lanes, M, at, room, q, count, first):
            return INDEFINITE
        if turn == 0:
            put(lanes, M, room.whole, log_det(lanes, M, at, room))
        if turn == q or not accuse(lanes, M, at, room, count, threshold):
            break
        for lane in range(len(lanes)):
            worst = int(M[room.worst, lane])
            if worst >= 0:
                leave_out(M, at, room, q, columns, count, worst, lane)
        for c in range(count):
            first[c] = 0
    kept = fill(lanes, 0.0)
    for i in range(q):
        kept = kept + get(lanes, M, room.there + i)
    left = log_det(lanes, M, at, room)
    on_the_gate = -0.5 * (kept * threshold + left)
    worse = on_the_gate - log_sum(lanes, M, room.joint, at.r)
    hopeless = choose(worse, kept, 0.0)
    if anywhere(hopeless):
        left, kept = choose(hopeless, 0.0, left), choose(hopeless, 0.0, kept)
        put(lanes, M, room.gone, choose(hopeless, 1.0, get(lanes, M, room.gone)))
        put(lanes, M, room.joint, hopeless)
        for lane in range(len(lanes)):
            if M[room.joint, lane] > 0.0:
                leave_all_out(M, at, room, q, columns, reference, lane)
    gone = get(lanes, M, room.gone)
    if not anywhere(gone):
        return CLEAN
    for i in range(q):
        put(lanes, M, at.free + i, get(lanes, M, room.there + i))
    whole = get(lanes, M, room.whole)
    price = -0.5 * ((before - kept) * (threshold + updating.LOG_2PI) + whole - left)
    put(lanes, M, room.price, choose(gone, price, 0.0))
    few = choose(before - 2.0 * kept + 0.5, choose(before, 1.0, 0.0), 0.0)
    put(lanes, M, room.rejected, choose(gone, few, 0.0))
    return CHANGED


@compiled
def judge(lanes: Lanes, M: Array, at: Where, room: Room, q: int, count: int, first: Index) -> bool:
    """Judge the rows and every source under each mode and by the bank's moments; success."""
    m = at.m
    for j in range(at.r + 1):
        S, nis = at.S_ + j * m * m, at.nis + j if j < at.r else at.bank
        if not updating.factor(lanes, M, q, m, S, at.C, at.pivot):
            return False
        updating.whiten(lanes, M, q, m, at.C, at.pivot, at.nu + j * m, at.white)
        updating.log_density(
            lanes, M, q, at.white, at.pivot, room.nothing, nis, room.log_density + j
        )
        for c in range(count):
            D = room.D + c * m
            here = j * count + c
            information = room.information + here
            sources.test(
                lanes, M, q, m, at.C, at.pivot, at.white, D, first[c], at.E, room.score,
                information,
            )  # fmt: skip
            alone = fill(lanes, 0.0)
            for i in range(first[c], q):
                d = get(lanes, M, D + i)
                alone = alone + d * d * get(lanes, M, S + i * m + i)
            known, score = get(lanes, M, information), get(lanes, M, room.score)
            square = choose(known * alone - TESTABLE, score * score / known, 0.0)
            put(lanes, M, room.statistic + here, square)
    for j in range(at.r):
        joint = get(lanes, M, room.log_density + j) + get(lanes, M, at.log_c + j)
        put(lanes, M, room.joint + j, joint)
    return True


@compiled
def log_det(lanes: Lanes, M: Array, at: Where, room: Room) -> Vector:
    """Log-determinant of the bank's innovation covariance, as judged."""
    return -2.0 * get(lanes, M, room.log_density + at.r) - get(lanes, M, at.bank)


@compiled
def log_sum(lanes: Lanes, M: Array, values: int, count: int) -> Vector:
    """Log of the sum of exponentials."""
    top = fill(lanes, -np.inf)
    for j in range(count):
        value = get(lanes, M, values + j)
        top = choose(value - top, value, top)
    top = choose(finite(top), top, 0.0)
    total = fill(lanes, 0.0)
    for j in range(count):
        total = total + exp(get(lanes, M, values + j) - top)
    return top + log(total)


@compiled
def accuse(lanes: Lanes, M: Array, at: Where, room: Room, count: int, threshold: float) -> bool:
    """Find which source is to go next in each lane, -1: none; whether one is in any."""
    with_it = log_sum(lanes, M, room.joint, at.r)
    best = fill(lanes, -np.inf)
    for c in range(count):
        top = fill(lanes, -np.inf)
        for j in range(at.r):
            own = get(lanes, M, room.joint + j)
            own = own + 0.5 * get(lanes, M, room.statistic + j * count + c)
            top = choose(own - top, own, top)
        shift = choose(finite(top), top, 0.0)
        bank = get(lanes, M, room.information + at.r * count + c)
        total = fill(lanes, 0.0)
        for j in range(at.r):
            own = get(lanes, M, room.joint + j)
            own = own + 0.5 * get(lanes, M, room.statistic + j * count + c) - shift
            known = get(lanes, M, room.information + j * count + c)
            total = total + exp(own) * sqrt(bank / choose(known, known, 1.0))
        gain = shift + log(total) - 0.5 * threshold - with_it
        gain = choose(bank, gain, -np.inf)
        put(lanes, M, room.gain + c, gain)
        best = choose(gain - best, gain, best)
    worst = fill(lanes, -1.0)
    for c in range(count - 1, -1, -1):
        gain = get(lanes, M, room.gain + c)
        suspect = choose(finite(gain), get(lanes, M, room.suspect + c), 0.0)
        near = choose(gain - best + AMBIGUOUS, 1.0, suspect)
        suspect = choose(gain, near, suspect)
        put(lanes, M, room.suspect + c, suspect)
        worst = choose(suspect, 1.0 * c, worst)
    put(lanes, M, room.worst, worst)
    return bool(anywhere(worst + 1.0))


@compiled
def leave_out(
    M: Array, at: Where, room: Room, q: int, columns: Index, count: int, c: int, lane: int
) -> None:
    """Combine the rows so that the error of source c occurs in none, and one row goes."""
    m, there, ratio, D = at.m, room.there, room.ratio, room.D + c * at.m
    M[room.gone, lane] = 1.0
    largest = 0.0
    for i in range(q):
        largest = max(largest, abs(M[D + i, lane]))
        if M[room.raw + c * m + i, lane] != 0.0:
            M[at.row_weight + i, lane] = 0.0
    pivot, least = q, np.inf
    for i in range(q):
        touched = M[there + i, lane] > 0.0 and abs(M[D + i, lane]) > TESTABLE * largest
        if touched and M[at.Sm + i * m + i, lane] < least:
            pivot, least = i, M[at.Sm + i * m + i, lane]
        M[ratio + i, lane] = M[D + i, lane] if touched else 0.0
    if pivot == q:
        return
    divisor = M[ratio + pivot, lane]
    for i in range(q):
        M[ratio + i, lane] /= divisor
    M[ratio + pivot, lane] = 0.0
    for j in range(at.r + 1):
        nu, S = at.nu + j * m, at.S_ + j * m * m
        for i in range(q):
            M[nu + i, lane] -= M[ratio + i, lane] * M[nu + pivot, lane]
            for k in range(i):
                M[S + k * m + i, lane] = M[S + i * m + k, lane]
        congruent(M, S, q, m, ratio, pivot, lane)
        offsets.single_out(M, S, q, m, pivot, lane)
    M[at.mean + pivot, lane] = 0.0
    for j in range(at.r):
        H, size = at.H + j * at.stride, columns[j]
        for i in range(q):
            for a in range(size):
                there_too = M[H + pivot * size + a, lane]
                M[H + i * size + a, lane] -= M[ratio + i, lane] * there_too
    congruent(M, at.R, q, m, ratio, pivot, lane)
    offsets.neutral(M, at, q, pivot, lane, columns)
    M[there + pivot, lane] = 0.0
    for a in range(count):
        D = room.D + a * m
        entered = M[D + pivot, lane]
        for i in range(q):
            M[D + i, lane] -= M[ratio + i, lane] * entered
            if M[there + i, lane] == 0.0 or abs(M[D + i, lane]) <= 1e-12:
                M[D + i, lane] = 0.0


@compiled
def congruent(M: Array, S: int, q: int, m: int, ratio: int, pivot: int, lane: int) -> None:
    """S (m, m) to T S T', T = I - ratio e_pivot'."""
    for i in range(q):
        share = M[ratio + i, lane]
        if share != 0.0:
            for k in range(q):
                M[S + i * m + k, lane] -= share * M[S + pivot * m + k, lane]
    for k in range(q):
        share = M[ratio + k, lane]
        if share != 0.0:
            for i in range(q):
                M[S + i * m + k, lane] -= share * M[S + i * m + pivot, lane]


@compiled
def leave_all_out(
    M: Array, at: Where, room: Room, q: int, columns: Index, reference: Index, lane: int
) -> None:
    """Leave out every row of one lane that had something to say of its own."""
    for i in range(q):
        alive = False
        for k in range(q):
            shows = k == i or reference[k, lane] == i
            alive = alive or (shows and M[at.free + k, lane] > 0.0)
        if alive and M[at.present + i, lane] > 0.0:
            M[at.row_weight + i, lane] = 0.0
    for i in range(q):
        M[room.there + i, lane] = 0.0
        if M[at.free + i, lane] > 0.0:
            offsets.neutral(M, at, q, i, lane, columns)
