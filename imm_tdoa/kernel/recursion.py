"""The recursion of the IMM over blocks of targets: the compiled form of `imm_tdoa.cycle`.

One block is as many targets as there are lanes. It is taken through all its scans before the
next, so that what it works on stays in the fastest memory.
"""

from __future__ import annotations

import math

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel import gathering, gating, looking, mixing, offsets, reading, updating, weighing
from imm_tdoa.kernel.compiling import allocating, compiled
from imm_tdoa.kernel.layout import Feed, Robust, Spec
from imm_tdoa.kernel.memory import Where, lay_out, make_room
from imm_tdoa.kernel.vectors import Lanes, get, put

LINE = 8  # numbers in a line of the processor's fastest memory
FINE, INDEFINITE, IMPOSSIBLE, REOPENS, INFINITE = 0, 1, 2, 3, 4


@allocating
def run(
    lanes: Lanes,
    spec: Spec,
    feed: Feed,
    robust: Robust | None,
    records: Array,
    out: Array,
    kept: Index,
    stride: int,
    first: int,
    last: int,
    start: int,
    begin: int,
) -> tuple[int, int, int]:
    """Take the targets `first` to `last` (exclusive) through all scans.

    The targets of the first block begin with scan `begin`, the others with scan `start`.

    Parameters
    ----------
    robust : Robust, optional
        How gross errors are treated; the code for them is compiled only where there is one.
    records : (B * size,)
        The targets' states before the first scan, one after the other; afterwards those after
        the last.
    out : (B * stride,)
        Filled with the records after the scans that are kept, `stride` numbers to each target.
    kept : (T,)
        Which of these records each scan's is; -1: none.

    Returns
    -------
    tuple of int
        `FINE`, or what happened, with the scan and the target: `INDEFINITE`, an innovation
        covariance that is not positive definite; `IMPOSSIBLE`, a scan that no mode explains;
        `REOPENS`, a target of the block is lost and is to be predicted from long ago: the block's
        records are those before that scan.
    """
    L = len(lanes)
    n, order, kind, scale, group = spec.n, spec.order, spec.kind, spec.scale, spec.group
    birth, pattern, frame = spec.birth, spec.pattern, spec.frame
    tables, steps, values, usable = feed.tables, feed.step, feed.values, feed.usable
    since, noise, places, speeds = feed.since, feed.noise, feed.place, feed.speed
    moving, own_steps = places.shape[1] > 1, steps.shape[0] > 1
    at = lay_out(n, order, spec.dims, len(kind), places.shape[2])
    m, T = at.m, steps.shape[1]
    size = at.size
    first_row = alone = np.zeros(0, np.int64)
    if robust is not None:
        sources = robust.directions.shape[3]
        room = make_room(at, sources, robust.trust.shape[1])
        size = room.size
        first_row, alone = np.zeros(sources + m, np.int64), np.zeros(m, np.int64)
    whole = np.zeros(size * L + LINE)
    edge = -(whole.ctypes.data // 8) % LINE  # vectors that lie across lines take twice as long
    M = whole[edge : edge + size * L].reshape(size, L)
    columns = np.zeros(at.r, np.int64)
    for j in range(at.r):
        columns[j] = min(n[j], 2 * at.d if spec.rates else at.d)
    grouped = offsets.any_shared(group)
    step, positive = np.zeros(L if own_steps else 1, np.int64), False
    rows, used = np.zeros(m, np.int64), np.zeros(at.S, np.int64)
    own_pairs = feed.station.shape[0] > 1
    station, reference = feed.station[0, 0], feed.reference[0, 0]
    if own_pairs:
        station, reference = np.zeros((m, L), np.int64), np.zeros((m, L), np.int64)
    taken_from = np.zeros((m if grouped or robust is not None else 0, L), np.int64)
    for i in range(len(taken_from)):
        for lane in range(L):
            taken_from[i, lane] = -1

    for block in range(first, last, L):
        targets = min(L, last - block)
        x, P, other_x, other_P = at.x, at.P, at.x_other, at.P_other
        gathering.load(M, at, records, block, targets)
        if robust is not None:
            reading.load(M, room, robust.trust, block, targets)
        for lane in range(len(step)):
            step[lane] = -1
        here = begin if block == first else start
        for t in range(here, T):
            if robust is not None and reading.reopens(lanes, M, room):
                size = at.record
                gathering.store(lanes, M, at, x, records, block * size, size, targets)
                reading.store(M, room, robust.trust, block, targets)
                return REOPENS, t, block
            fresh = False
            for lane in range(len(step)):
                own = steps[block + min(lane, targets - 1) if own_steps else 0, t]
                fresh = fresh or own != step[lane]
                step[lane] = own
            if fresh:
                positive = gathering.take_step(lanes, M, at, tables, step)
            if moving or t == here:
                gathering.take_stations(M, at, places, speeds, block, targets, t)
            if own_pairs:
                gathering.take_pairs(feed, block, targets, t, station, reference)
            elif feed.station.shape[1] > 1:
                station, reference = feed.station[0, t], feed.reference[0, t]
            q = gathering.take_values(
                lanes, M, at, kind, scale, values, usable, since, block, targets, t, station,
                reference, rows,
            )  # fmt: skip
            predict(
                lanes, M, at, n, order, spec.rule, birth, pattern, positive, x, P, other_x, other_P
            )
            x, P, other_x, other_P = other_x, other_P, x, P
            extras = kept[t] >= 0 or t == T - 1
            if q > 0:
                heard = gathering.heard_stations(kind, rows, q, station, reference, used)
                gathering.take_noise(lanes, M, at, noise, block, targets, t, rows, q)
                compare(
                    lanes, M, at, n, columns, spec.rates, rows, q, kind, station, reference, frame,
                    used, heard, x,
                )  # fmt: skip
                if robust is not None:
                    reading.remember(lanes, M, at, room, q)
                if grouped:
                    offsets.eliminate(M, at, q, rows, group, columns, taken_from)
                else:
                    for i in range(q):
                        put(lanes, M, at.free + i, get(lanes, M, at.present + i))
                covariances(lanes, M, at, n, columns, q, P)
                for i in range(q):
                    put(lanes, M, at.row_weight + i, 1.0)
                if robust is not None:
                    read = reading.read(
                        lanes, M, at, room, robust, block, targets, t, rows, q, columns, grouped,
                        taken_from, first_row, alone,
                    )  # fmt: skip
                    if read == gating.INDEFINITE:
                        return INDEFINITE, t, block
                    if read == gating.CHANGED:
                        covariances(lanes, M, at, n, columns, q, P)
                total = get(lanes, M, at.free)
                for i in range(1, q):
                    total = total + get(lanes, M, at.free + i)
                put(lanes, M, at.heard, total)
                if extras and not weighing.judge(lanes, M, at, q):
                    return INDEFINITE, t, block
                if not update(lanes, M, at, n, columns, q, x, P):
                    return INDEFINITE, t, block
                impossible = weighing.weigh(lanes, M, at)
                if impossible >= 0:
                    return IMPOSSIBLE, t, block + min(impossible, targets - 1)
                if robust is not None:
                    reading.conclude(lanes, M, at, room, robust, block, targets, t, x)
            else:
                for j in range(at.r):
                    put(lanes, M, at.log_p + j, get(lanes, M, at.log_c + j))
            if extras:
                gathering.say(lanes, M, at, rows, q)
                if robust is not None:
                    put(lanes, M, at.lost, get(lanes, M, room.trust + reading.LOST))
                size = at.record
                if t == T - 1:
                    gathering.store(lanes, M, at, x, records, block * size, size, targets)
                if kept[t] >= 0:
                    begun = block * stride + kept[t] * size
                    gathering.store(lanes, M, at, x, out, begun, stride, targets)
        if robust is not None:
            reading.store(M, room, robust.trust, block, targets)
    return FINE, 0, 0


@compiled
def predict(
    lanes: Lanes,
    M: Array,
    at: Where,
    n: Index,
    order: Index,
    rule: int,
    birth: Array,
    pattern: Array,
    positive: bool,
    x: int,
    P: int,
    next_x: int,
    next_P: int,
) -> None:
    """Mix the modes and predict each by its own motion model (§9.1 steps 1 to 3)."""
    if at.r > 1:
        mixing.weights(lanes, M, at.r, at.log_p, at.Pi, positive, at.w, at.log_c)
    else:
        put(lanes, M, at.log_c, get(lanes, M, at.log_p))
    xj, Pj, fj = 0, 0, at.f
    for j in range(at.r):
        from_x, from_P = x, P
        if at.r > 1:
            mixing.mix(lanes, M, n, j, rule, birth, at.w, x, P, at.xm, at.Pm, at.d0, at.d1)
            from_x, from_P = at.xm, at.Pm
        mixing.predict(
            lanes, M, at.d, order[j], fj, pattern, j, at.Q + Pj, from_x, from_P, at.FP,
            next_x + xj, next_P + Pj,
        )  # fmt: skip
        xj, Pj, fj = xj + n[j], Pj + n[j] * n[j], fj + order[j] * order[j]


@compiled
def compare(
    lanes: Lanes,
    M: Array,
    at: Where,
    n: Index,
    columns: Index,
    rates: bool,
    rows: Index,
    q: int,
    kind: Index,
    station: Index,
    reference: Index,
    frame: Array,
    stations: Index,
    heard: int,
    x: int,
) -> None:
    """Innovations and Jacobians of every mode."""
    xj = x
    for j in range(at.r):
        looking.geometry(
            lanes, M, at.d, rates, n[j] > at.d, stations, heard, xj, at.place, at.speed, at.G
        )
        looking.innovate(
            lanes, M, at.d, columns[j], rows, q, kind, station, reference, frame, xj, at.G, at.z,
            at.present, at.nu + j * at.m, at.H + j * at.stride,
        )  # fmt: skip
        xj += n[j]


@compiled
def covariances(
    lanes: Lanes, M: Array, at: Where, n: Index, columns: Index, q: int, P: int
) -> None:
    """Innovation covariances of every mode."""
    Pj = P
    for j in range(at.r):
        updating.innovation_covariance(
            lanes, M, n[j], columns[j], q, at.m, Pj, at.H + j * at.stride, at.R,
            at.HP + j * at.m * at.N, at.S_ + j * at.m * at.m,
        )  # fmt: skip
        Pj += n[j] * n[j]


@compiled
def update(
    lanes: Lanes, M: Array, at: Where, n: Index, columns: Index, q: int, x: int, P: int
) -> bool:
    """Update every mode with the scan; whether each innovation covariance was definite."""
    xj, Pj = x, P
    for j in range(at.r):
        nu, H, HP = at.nu + j * at.m, at.H + j * at.stride, at.HP + j * at.m * at.N
        if not updating.factor(lanes, M, q, at.m, at.S_ + j * at.m * at.m, at.C, at.pivot):
            return False
        updating.whiten(lanes, M, q, at.m, at.C, at.pivot, nu, at.white)
        updating.log_density(lanes, M, q, at.white, at.pivot, at.heard, at.nis + j, at.log_l + j)
        updating.update(
            lanes, M, n[j], columns[j], q, at.m, nu, H, at.R, HP, at.C, at.pivot, at.K, at.E, xj, Pj
        )
        xj, Pj = xj + n[j], Pj + n[j] * n[j]
    return True


@allocating
def step(
    lanes: Lanes,
    ints: Index,
    floats: Array,
    table: Array,
    values: Array,
    record: Array,
    estimate: Array,
) -> int:
    """Take one target through one scan; `record` (size,) becomes that after it.

    Parameters
    ----------
    ints, floats : (i,), (f,)
        What `imm_tdoa.kernel.stepping.packed` made of a plan.
    table : (1, W)
        Of the time step.
    values : (m,)
        What was measured.
    estimate : (n + n²,)
        Filled with the mean and covariance of all modes together.

    Returns
    -------
    int
        `FINE`, or what went wrong.
    """
    for value in values:
        if math.isinf(value):
            return INFINITE
    dims, r, m, k, S, n_max = ints[0], ints[3], ints[4], ints[5], ints[6], ints[7]
    i = 8
    order, n = ints[i : i + r], ints[i + r : i + 2 * r]
    i += 2 * r
    kind, group = ints[i : i + m], ints[i + m : i + 2 * m]
    station = ints[i + 2 * m : i + 3 * m].reshape(1, 1, m, 1)
    reference = ints[i + 3 * m : i + 4 * m].reshape(1, 1, m, 1)
    i = n_max
    birth, pattern = floats[:i], floats[i : i + r * k * k].reshape(r, k, k)
    i += r * k * k
    scale, frame = floats[i : i + m], floats[i + m : i + m + 12]
    i += m + 12
    noise = floats[i : i + m * m].reshape(1, 1, m, m)
    i += m * m
    place = floats[i : i + S * dims].reshape(1, 1, S, dims)
    speed = floats[i + S * dims : i + 2 * S * dims].reshape(1, 1, S, dims)
    nx, nP = 0, 0
    for j in range(r):
        nx += n[j]
        nP += n[j] * n[j]
    spec = Spec(dims, ints[1], ints[2] != 0, order, n, birth, pattern, kind, group, scale, frame)
    none = np.zeros(1, np.int64)
    feed = Feed(
        table, none.reshape(1, 1), values.reshape(1, 1, m), none, np.zeros((0, 0, m), np.int64),
        noise, place, speed, station, reference,
    )  # fmt: skip
    kept = np.zeros(1, np.int64)
    kept[0] = -1
    code, _, _ = run(lanes, spec, feed, None, record, record, kept, 0, 0, 1, 0, 0)
    weighing.combine(nx + nP, n, n_max, record, estimate)
    return int(code)
