"""Between a block's memory and the arrays of all targets, compiled.

A lane too many, where the last block is not full, repeats the block's last target.
"""

from __future__ import annotations

import math

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel.layout import Feed, Record
from imm_tdoa.kernel.memory import Where
from imm_tdoa.kernel.vectors import compiled
from imm_tdoa.makeup import RANGE_RATE


@compiled
def load(M: Array, records: Array, x: int, size: int, block: int, targets: int) -> None:
    """Spread a block's records over the lanes; lanes too many repeat the last target."""
    for lane in range(M.shape[1]):
        record = records[block + min(lane, targets - 1)]
        for k in range(size):
            M[x + k, lane] = record[k]


@compiled
def store(
    M: Array, at: Where, record: Record, x: int, records: Array, block: int, targets: int
) -> None:
    """Gather the block's states into its records; x: where the means are now."""
    for lane in range(targets):
        for k in range(at.means + at.squares):
            records[block + lane, k] = M[x + k, lane]
        for k in range(at.r + 1):
            records[block + lane, record.log_p + k] = M[at.log_p + k, lane]


@compiled
def keep(records: Array, out: Array, k: int, block: int, targets: int) -> None:
    """Copy the block's records to those that are kept, as number k."""
    for lane in range(targets):
        for i in range(records.shape[1]):
            out[block + lane, k, i] = records[block + lane, i]


@compiled
def say(
    M: Array,
    at: Where,
    record: Record,
    rows: Index,
    q: int,
    records: Array,
    block: int,
    targets: int,
) -> None:
    """Note what the scan said, or that it said nothing."""
    for lane in range(targets):
        own = records[block + lane]
        for i in range(at.m):
            own[record.row_weight + i] = np.nan
        heard = q > 0 and M[at.heard, lane] > 0.0
        own[record.dof] = M[at.heard, lane] if heard else 0.0
        own[record.nis] = M[at.bank, lane] if heard else np.nan
        for j in range(at.r):
            own[record.mode_log_likelihood + j] = M[at.log_l + j, lane] if q > 0 else 0.0
            own[record.mode_nis + j] = M[at.nis + j, lane] if heard else np.nan
        for i in range(q):
            if M[at.present + i, lane] > 0.0:
                own[record.row_weight + rows[i]] = M[at.row_weight + i, lane]
        own[record.lost] = 0.0
        own[record.reopened] = 0.0


@compiled
def take_step(M: Array, at: Where, n: Index, order: Index, tables: Array, step: Index) -> bool:
    """Spread the tables of each lane's time step; whether every entry of the chain is positive."""
    r = len(n)
    positive = True
    for lane in range(M.shape[1]):
        table = tables[step[lane]]
        positive = positive and table[0] > 0.0
        k = 1
        fj, Qj = at.f, at.Q
        for j in range(r):
            for i in range(order[j] ** 2):
                M[fj + i, lane] = table[k + i]
            k += order[j] ** 2
            fj += order[j] ** 2
            for i in range(n[j] ** 2):
                M[Qj + i, lane] = table[k + i]
            k += n[j] ** 2
            Qj += n[j] ** 2
        for i in range(r * r):
            M[at.Pi + i, lane] = table[k + i]
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
    L = M.shape[1]
    own_values, own_usable = min(1, values.shape[0] - 1), min(1, usable.shape[0] - 1)
    own_pairs, own_since = min(1, station.shape[1] - 1), min(1, since.shape[0] - 1)
    for i in range(len(kind)):
        heard = 0.0
        for lane in range(L):
            target = block + min(lane, targets - 1)
            value = values[own_values * target, t, i] * scale[i]
            there = 1.0 if math.isfinite(value) and t >= since[own_since * target] else 0.0
            if kind[i] <= RANGE_RATE:
                s, s0 = station[i, own_pairs * lane], reference[i, own_pairs * lane]
                there = there if math.isfinite(M[at.place + s * at.d, lane]) else 0.0
                if s0 >= 0:
                    there = there if math.isfinite(M[at.place + s0 * at.d, lane]) else 0.0
            M[at.z + q, lane] = value if there > 0.0 else 0.0
            M[at.present + q, lane] = there
            heard += there
        if usable.shape[0] > 0:
            heard = 0.0
            for lane in range(L):
                if usable[own_usable * (block + min(lane, targets - 1)), t, i] == 0:
                    M[at.present + q, lane] = 0.0
                heard += M[at.present + q, lane]
        if heard > 0.0:
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
    M: Array, at: Where, noise: Array, block: int, targets: int, t: int, rows: Index, q: int
) -> None:
    """Noise covariance of the present rows; unit variance, uncorrelated, for the others."""
    own, k = min(1, noise.shape[0] - 1), t if noise.shape[1] > 1 else 0
    for i in range(q):
        for j in range(i + 1):
            neutral = 1.0 if i == j else 0.0
            for lane in range(M.shape[1]):
                value = noise[own * (block + min(lane, targets - 1)), k, rows[i], rows[j]]
                both = M[at.present + i, lane] * M[at.present + j, lane]
                M[at.R + i * at.m + j, lane] = value if both > 0.0 else neutral
                M[at.R + j * at.m + i, lane] = M[at.R + i * at.m + j, lane]
