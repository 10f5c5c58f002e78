"""A scan read by a robust filter, and whether the track can still be trusted, compiled.

What `imm_tdoa.robust` and `imm_tdoa.reopening` say, for all lanes of a block at once.
"""

from __future__ import annotations

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel import gating, sources, tails
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.layout import Robust
from imm_tdoa.kernel.memory import Room, Where
from imm_tdoa.kernel.vectors import Lanes, anywhere, choose, fill, get, put

REJECTED, USED, LOST, SINCE, SNAPSHOT = 0, 1, 2, 3, 4  # columns of the trust records


@compiled
def load(M: Array, room: Room, trust: Array, block: int, targets: int) -> None:
    """Spread the trust in a block's targets over the lanes."""
    for lane in range(M.shape[1]):
        target = block + min(lane, targets - 1)
        for k in range(trust.shape[1]):
            M[room.trust + k, lane] = trust[target, k]


@compiled
def store(M: Array, room: Room, trust: Array, block: int, targets: int) -> None:
    """Write the trust in a block's targets."""
    for lane in range(targets):
        for k in range(trust.shape[1]):
            trust[block + lane, k] = M[room.trust + k, lane]


@compiled
def reopens(lanes: Lanes, M: Array, room: Room) -> bool:
    """Whether some target of the block is lost, and rejected its last scan."""
    lost, rejected = get(lanes, M, room.trust + LOST), get(lanes, M, room.trust + REJECTED)
    return bool(anywhere(choose(lost, rejected, 0.0)))


@compiled
def remember(lanes: Lanes, M: Array, at: Where, room: Room, q: int) -> None:
    """Keep the variances of the rows as measured."""
    for i in range(q):
        put(lanes, M, room.variance + i, get(lanes, M, at.R + i * at.m + i))


@compiled
def read(
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
    columns: Index,
    grouped: bool,
    reference: Index,
    first: Index,
    alone: Index,
) -> int:
    """Read the scan in place; `gating.CLEAN`, `CHANGED` where rows have changed, `INDEFINITE`.

    `reference` (m, L) is what each row was freed of offsets by, -1: nothing. `first` (k + m,) and
    `alone` (m,): scratch.
    """
    put(lanes, M, room.nothing, 0.0)
    pieces = fill(lanes, 0.0)
    for i in range(q):
        pieces = pieces + get(lanes, M, at.free + i)
    put(lanes, M, room.pieces, pieces)
    count = sources.take(
        lanes, M, at, room, how, block, targets, t, rows, q, grouped, reference, first, alone
    )
    if how.gates:
        done = gating.gate(lanes, M, at, room, q, columns, how.threshold, count, first, reference)
        return int(done)
    if tails.student_t(lanes, M, at, room, how, block, targets, t, q, first):
        return gating.CLEAN
    return gating.INDEFINITE


@compiled
def conclude(
    lanes: Lanes,
    M: Array,
    at: Where,
    room: Room,
    how: Robust,
    block: int,
    targets: int,
    t: int,
    x: int,
) -> None:
    """Add the price of what was not read, and see how far the targets are to be trusted now."""
    price = get(lanes, M, room.price)
    put(lanes, M, at.total, get(lanes, M, at.total) + price)
    for j in range(at.r):
        put(lanes, M, at.log_l + j, get(lanes, M, at.log_l + j) + price)
    trust_after(lanes, M, at, room, how, block, targets, t, x)


@compiled
def trust_after(
    lanes: Lanes,
    M: Array,
    at: Where,
    room: Room,
    how: Robust,
    block: int,
    targets: int,
    t: int,
    x: int,
) -> None:
    """Trust in the targets after a scan (`imm_tdoa.reopening.Trust.after`)."""
    own, enough = room.trust, how.patience - 0.5
    heard, rejected = get(lanes, M, room.pieces), get(lanes, M, room.rejected)
    was_rejected, was_used = get(lanes, M, own + REJECTED), get(lanes, M, own + USED)
    was_lost = get(lanes, M, own + LOST)
    on_end = choose(rejected, was_rejected + 1.0, 0.0)
    used = choose(rejected, 0.0, was_used + 1.0)
    lost = choose(was_lost, choose(enough - used, 1.0, 0.0), 0.0)
    lost = choose(on_end - enough, 1.0, lost)
    put(lanes, M, own + REJECTED, choose(heard, on_end, was_rejected))
    put(lanes, M, own + USED, choose(heard, used, was_used))
    put(lanes, M, own + LOST, choose(heard, lost, was_lost))
    good = choose(rejected + lost, 0.0, choose(heard, 1.0, 0.0))
    since = get(lanes, M, own + SINCE)
    if how.time.shape[0] > 1:
        for lane in range(len(lanes)):
            M[own + SINCE, lane] = how.time[block + min(lane, targets - 1), t]
    else:
        put(lanes, M, own + SINCE, how.time[0, t])
    put(lanes, M, own + SINCE, choose(good, get(lanes, M, own + SINCE), since))
    size = at.means + at.squares
    for k in range(size):
        kept = own + SNAPSHOT + k
        put(lanes, M, kept, choose(good, get(lanes, M, x + k), get(lanes, M, kept)))
    for j in range(at.r):
        kept = own + SNAPSHOT + size + j
        put(lanes, M, kept, choose(good, get(lanes, M, at.log_p + j), get(lanes, M, kept)))
