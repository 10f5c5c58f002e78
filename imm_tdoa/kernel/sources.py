"""Sources of error: how they enter the rows of a scan, and what the scan says of them, compiled."""

from __future__ import annotations

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.layout import Robust
from imm_tdoa.kernel.memory import Room, Where
from imm_tdoa.kernel.vectors import Lanes, choose, fill, get, put


@compiled
def take(
    lanes: Lanes,
    M: Array,
    at: Where,
    room: Room,
    how: Robust,
    block: int,
    targets: int,
    t: int,
    rows: Index,
    q: int,
    grouped: bool,
    reference: Index,
    first: Index,
    alone: Index,
) -> int:
    """Gather the directions in which sources enter the rows; how many sources there are.

    The gate takes rows for sources, too, but for those that are a source's only one: they would
    be judged twice. `first` (k + m,) becomes the first row that each enters; `alone` is
    scratch (m,).
    """
    m, K = at.m, how.directions.shape[3]
    own, k = how.directions.shape[0] > 1, t if how.directions.shape[1] > 1 else 0
    for i in range(q):
        alone[i] = 0
    for c in range(K):
        raw, entered, last, unit = room.raw + c * m, 0, 0, False
        first[c] = 0
        for i in range(q):
            if own:
                for lane in range(len(lanes)):
                    target = block + min(lane, targets - 1)
                    M[raw + i, lane] = how.directions[target, k, rows[i], c]
            else:
                value = how.directions[0, k, rows[i], c]
                put(lanes, M, raw + i, value)
                if value != 0.0:
                    if entered == 0 and not grouped:
                        first[c] = i
                    entered, last, unit = entered + 1, i, abs(value) == 1.0
            there = get(lanes, M, at.present + i)
            put(lanes, M, raw + i, choose(there, get(lanes, M, raw + i), 0.0))
        if entered == 1 and unit:
            alone[last] = 1
    count = K
    for row in range(q if how.gates else 0):
        if alone[row] == 0:
            for i in range(q):
                put(lanes, M, room.raw + count * m + i, 0.0)
            there = get(lanes, M, at.present + row)
            put(lanes, M, room.raw + count * m + row, there)
            first[count] = 0 if grouped else row
            count += 1
    for c in range(count):
        for i in range(q):
            raw, D = room.raw + c * m, room.D + c * m
            put(lanes, M, D + i, get(lanes, M, raw + i))
            if grouped:
                for lane in range(len(lanes)):
                    other = reference[i, lane]
                    if other >= 0:
                        M[D + i, lane] -= M[raw + other, lane]
                there = get(lanes, M, at.free + i)
                put(lanes, M, D + i, choose(there, get(lanes, M, D + i), 0.0))
    return int(count)


@compiled
def test(
    lanes: Lanes,
    M: Array,
    q: int,
    m: int,
    C: int,
    pivot: int,
    white: int,
    d: int,
    first: int,
    e: int,
    score: int,
    information: int,
) -> None:
    """Score d' S^-1 nu and information d' S^-1 d of a source that enters no row before `first`.

    `white` is C^-1 nu; e (q,): scratch.
    """
    total, known = fill(lanes, 0.0), fill(lanes, 0.0)
    for i in range(first, q):
        own = get(lanes, M, d + i)
        for k in range(first, i):
            own = own - get(lanes, M, C + i * m + k) * get(lanes, M, e + k)
        own = own * get(lanes, M, pivot + i)
        put(lanes, M, e + i, own)
        total = total + own * get(lanes, M, white + i)
        known = known + own * own
    put(lanes, M, score, total)
    put(lanes, M, information, known)
