"""Between a block's memory and the arrays of all targets, compiled.

A lane too many, where the last block is not full, repeats the block's last target.
"""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.elementary import finite
from imm_tdoa.kernel.layout import Feed
from imm_tdoa.kernel.memory import Where
from imm_tdoa.kernel.vectors import EIGHT, Lanes, anywhere, choose, get, put, scatter
from imm_tdoa.makeup import RANGE_RATE


@compiled
def load(M: Array, at: Where, records: Array, block: int, targets: int) -> None:
    """Spread a block's states over the lanes; lanes too many repeat the last target."""
    for lane in range(M.shape[1]):
        begin = (block + min(lane, targets - 1)) * at.record
        for k in range(at.total + 1):
            M[k, lane] = records[begin + k]


@compiled
def store(
    lanes: Lanes, M: Array, at: Where, x: int, out: Array, begin: int, stride: int, targets: int
) -> None:
    """Write the block's records to `out`, `stride` numbers apart; x: where the means are now."""
    state = at.means + at.squares
    _write(lanes, M, x, state, out, begin, stride, targets)
    _write(lanes, M, at.log_p, at.record - state, out, begin + state, stride, targets)


@compiled
def _write(
    lanes: Lanes, M: Array, row: int, count: int, out: Array, begin: int, stride: int, targets: int
) -> None:
    """Write so many rows of the memory, EIGHT at a time where there are as many."""
    if count < EIGHT:
        for lane in range(targets):
            for k in range(count):
                out[begin + lane * stride + k] = M[row + k, lane]
        return
    for k in range(0, count, EIGHT):
        here = min(k, count - EIGHT)
        scatter(lanes, M, row + here, out, begin + here, stride, targets - 1)


@compiled
def say(lanes: Lanes, M: Array, at: Where, rows: Index, q: int) -> None:
    """Note what the scan said, or that it said nothing."""
    if q == 0:
        put(lanes, M, at.heard, 0.0)
        for j in range(at.r):
            put(lanes, M, at.log_l + j, 0.0)
    heard = get(lanes, M, at.heard)
    put(lanes, M, at.bank, choose(heard, get(lanes, M, at.bank), np.nan))
    for j in range(at.r):
        put(lanes, M, at.nis + j, choose(heard, get(lanes, M, at.nis + j), np.nan))
    for i in range(at.m):
        put(lanes, M, at.weight + i, np.nan)
    for i in range(q):
        weight = choose(get(lanes, M, at.present + i), get(lanes, M, at.row_weight + i), np.nan)
        put(lanes, M, at.weight + rows[i], weight)


@compiled
def take_step(lanes: Lanes, M: Array, at: Where, tables: Array, step: Index) -> bool:
    """Spread the table of the time step, or each lane's; whether all chains are positive."""
    positive = True
    for own in step:
        positive = positive and tables[own, 0] > 0.0
    for k in range(at.w - at.Q):
        if len(step) == 1:
            put(lanes, M, at.Q + k, tables[step[0], 1 + k])
        else:
            for lane in range(len(lanes)):
                M[at.Q + k, lane] = tables[step[lane], 1 + k]
    return positive


@compiled
def take_stations(
    M: Array, at: Where, places: Array, speeds: Array, block: int, targets: int, t: int
) -> None:
    own, k = min(1, places.shape[0] - 1), t if places.shape[1] > 1 else 0
    S, d = places.shape[2:]
    for lane in range(M.shape[1]):
        target = own * (block + min(lane, targets - 1))
        for s in range(S):
            for a in range(d):
                M[at.place + s * d + a, lane] = places[target, k, s, a]
                M[at.speed + s * d + a, lane] = speeds[target, k, s, a]


@compiled
def take_pairs(
    feed: Feed, block: int, targets: int, t: int, station: Array, reference: Array
) -> None:
    k = t if feed.station.shape[1] > 1 else 0
    for i in range(station.shape[0]):
        for lane in range(station.shape[1]):
            station[i, lane] = feed.station[block + min(lane, targets - 1), k, i, 0]
            reference[i, lane] = feed.reference[block + min(lane, targets - 1), k, i, 0]


@compiled
def take_values(
    lanes: Lanes,
    M: Array,
    at: Where,
    kind: Index,
    scale: Array,
    values: Array,
    usable: Index,
    since: Index,
    block: int,
    targets: int,
    t: int,
    station: Index,
    reference: Index,
    rows: Index,
) -> int:
    """Gather the rows that some lane measured; how many there are.

    A row is present where it is a number, says something new, and its stations are heard.
    """
    q = 0
    own_values, own_usable = min(1, values.shape[0] - 1), min(1, usable.shape[0] - 1)
    own_pairs, own_since = station.shape[1] > 1, min(1, since.shape[0] - 1)
    for i in range(len(kind)):
        z, present = at.z + q, at.present + q
        for lane in range(len(lanes)):
            target = block + min(lane, targets - 1)
            value = values[own_values * target, t, i]
            M[z, lane] = value if t >= since[own_since * target] else np.nan
        value = get(lanes, M, z) * scale[i]
        known = finite(value)
        if kind[i] <= RANGE_RATE and own_pairs:
            for lane in range(len(lanes)):
                s, s0 = station[i, lane], reference[i, lane]
                M[present, lane] = M[at.place + s * at.d, lane]
                if s0 >= 0:
                    M[present, lane] += M[at.place + s0 * at.d, lane]
            known = known * finite(get(lanes, M, present))
        elif kind[i] <= RANGE_RATE:
            s, s0 = station[i, 0], reference[i, 0]
            known = known * finite(get(lanes, M, at.place + s * at.d))
            if s0 >= 0:
                known = known * finite(get(lanes, M, at.place + s0 * at.d))
        there = choose(known, 1.0, 0.0)
        put(lanes, M, z, choose(known, value, 0.0))
        put(lanes, M, present, there)
        if usable.shape[0] > 0:
            for lane in range(len(lanes)):
                if usable[own_usable * (block + min(lane, targets - 1)), t, i] == 0:
                    M[present, lane] = 0.0
            there = get(lanes, M, present)
        if anywhere(there):
            rows[q] = i
            q += 1
    return q


@compiled
def heard_stations(
    kind: Index, rows: Index, q: int, station: Index, reference: Index, used: Index
) -> int:
    """List the stations behind the rows; how many there are."""
    count = 0
    for s in range(len(used)):
        needed = False
        for k in range(q):
            i = rows[k]
            if kind[i] <= RANGE_RATE:
                for lane in range(station.shape[1]):
                    needed = needed or station[i, lane] == s or reference[i, lane] == s
        if needed:
            used[count] = s
            count += 1
    return count


@compiled
def take_noise(
    lanes: Lanes,
    M: Array,
    at: Where,
    noise: Array,
    block: int,
    targets: int,
    t: int,
    rows: Index,
    q: int,
) -> None:
    """Noise covariance of the present rows; unit variance, uncorrelated, for the others."""
    own, k = noise.shape[0] > 1, t if noise.shape[1] > 1 else 0
    for i in range(q):
        for j in range(i + 1):
            R = at.R + i * at.m + j
            if own:
                for lane in range(len(lanes)):
                    M[R, lane] = noise[block + min(lane, targets - 1), k, rows[i], rows[j]]
            else:
                put(lanes, M, R, noise[0, k, rows[i], rows[j]])
            both = get(lanes, M, at.present + i) * get(lanes, M, at.present + j)
            value = choose(both, get(lanes, M, R), 1.0 if i == j else 0.0)
            put(lanes, M, R, value)
            put(lanes, M, at.R + j * at.m + i, value)
