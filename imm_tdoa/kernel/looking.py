"""What a mode expects of a scan: innovations and Jacobians (ALGORITHMS §1), compiled."""

from __future__ import annotations

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.earth import height
from imm_tdoa.kernel.vectors import Lanes, choose, fill, get, put, sqrt
from imm_tdoa.makeup import AXIS, HEIGHT, RANGE_RATE


@compiled
def geometry(
    lanes: Lanes,
    M: Array,
    dims: int,
    rates: bool,
    moves: bool,
    stations: Index,
    count: int,
    x: int,
    place: int,
    speed: int,
    G: int,
) -> None:
    """Range, range rate, direction u and the rate's gradient b of each station, seen from x.

    place, speed: (S, d), of all stations, of which the first `count` of `stations` matter.
    G: (S, 2 + 2 d). x has a velocity where it `moves`.
    """
    for k in range(count):
        s = stations[k]
        g = G + s * (2 + 2 * dims)
        u, b = g + 2, g + 2 + dims
        square = fill(lanes, 0.0)
        for a in range(dims):
            away = get(lanes, M, x + a) - get(lanes, M, place + s * dims + a)
            square = square + away * away
            put(lanes, M, u + a, away)
        distance = sqrt(square)
        put(lanes, M, g, distance)
        one = 1.0 / choose(distance, distance, 1.0)
        for a in range(dims):
            put(lanes, M, u + a, get(lanes, M, u + a) * one)
        if not rates:
            continue
        rate = fill(lanes, 0.0)
        for a in range(dims):
            w = -get(lanes, M, speed + s * dims + a)
            if moves:
                w = w + get(lanes, M, x + dims + a)
            rate = rate + get(lanes, M, u + a) * w
            put(lanes, M, b + a, w)
        put(lanes, M, g + 1, rate)
        for a in range(dims):
            across = get(lanes, M, b + a) - rate * get(lanes, M, u + a)
            put(lanes, M, b + a, across * one)


@compiled
def innovate(
    lanes: Lanes,
    M: Array,
    dims: int,
    columns: int,
    rows: Index,
    q: int,
    kind: Index,
    station: Index,
    reference: Index,
    frame: Array,
    x: int,
    G: int,
    z: int,
    present: int,
    nu: int,
    H: int,
) -> None:
    """Innovations nu[i] = z[i] - h(x)[i] and Jacobians H[i, a] of the first q `rows`.

    Both are zero where a row is not present.

    station, reference: (m, 1 or L), the same for all lanes or each lane's own; reference -1:
    none. The `columns` of H are those of the position and, where there are more than `dims`, of
    the velocity.
    """
    for i in range(q):
        row = rows[i]
        Hi = H + i * columns
        if kind[row] == AXIS or kind[row] == HEIGHT:
            _coordinate(lanes, M, columns, kind[row], station[row, 0], frame, x, nu + i, Hi)
        elif station.shape[1] == 1:
            s, s0 = station[row, 0], reference[row, 0]
            _difference(lanes, M, dims, columns, kind[row] == RANGE_RATE, s, s0, G, nu + i, Hi)
        else:
            rate = kind[row] == RANGE_RATE
            for lane in range(len(lanes)):
                s, s0 = station[row, lane], reference[row, lane]
                _own_difference(M, dims, columns, rate, s, s0, G, nu + i, Hi, lane)
        there = get(lanes, M, present + i)
        away = get(lanes, M, z + i) - get(lanes, M, nu + i)
        put(lanes, M, nu + i, choose(there, away, 0.0))
        for a in range(columns):
            put(lanes, M, Hi + a, choose(there, get(lanes, M, Hi + a), 0.0))


@compiled
def _difference(
    lanes: Lanes,
    M: Array,
    dims: int,
    columns: int,
    rate: bool,
    s: int,
    s0: int,
    G: int,
    h: int,
    H: int,
) -> None:
    """Predicted row and its Jacobian: station s less reference s0, or s alone where that is -1."""
    g, g0 = G + s * (2 + 2 * dims), G + s0 * (2 + 2 * dims)
    what = 1 if rate else 0
    value = get(lanes, M, g + what)
    if s0 >= 0:
        value = value - get(lanes, M, g0 + what)
    put(lanes, M, h, value)
    for a in range(dims):
        along = get(lanes, M, g + 2 + a)
        if s0 >= 0:
            along = along - get(lanes, M, g0 + 2 + a)
        if columns > dims:
            put(lanes, M, H + dims + a, along if rate else fill(lanes, 0.0))
        if rate:
            across = get(lanes, M, g + 2 + dims + a)
            if s0 >= 0:
                across = across - get(lanes, M, g0 + 2 + dims + a)
            put(lanes, M, H + a, across)
        else:
            put(lanes, M, H + a, along)


@compiled
def _own_difference(
    M: Array,
    dims: int,
    columns: int,
    rate: bool,
    s: int,
    s0: int,
    G: int,
    h: int,
    H: int,
    lane: int,
) -> None:
    """The same in one lane, which has a pair of its own."""
    g, g0 = G + s * (2 + 2 * dims), G + s0 * (2 + 2 * dims)
    what = 1 if rate else 0
    slope = 2 + dims if rate else 2
    M[h, lane] = M[g + what, lane] - (M[g0 + what, lane] if s0 >= 0 else 0.0)
    for a in range(dims):
        M[H + a, lane] = M[g + slope + a, lane] - (M[g0 + slope + a, lane] if s0 >= 0 else 0.0)
        if columns > dims:
            along = M[g + 2 + a, lane] - (M[g0 + 2 + a, lane] if s0 >= 0 else 0.0)
            M[H + dims + a, lane] = along if rate else 0.0


@compiled
def _coordinate(
    lanes: Lanes,
    M: Array,
    columns: int,
    kind: int,
    axis: int,
    frame: Array,
    x: int,
    h: int,
    H: int,
) -> None:
    """A coordinate of the emitter itself, or its height above the ellipsoid."""
    for a in range(columns):
        put(lanes, M, H + a, 0.0)
    if kind == AXIS:
        put(lanes, M, h, get(lanes, M, x + axis))
        put(lanes, M, H + axis, 1.0)
        return
    for lane in range(len(lanes)):
        up, M[H, lane], M[H + 1, lane], M[H + 2, lane] = height(
            frame, M[x, lane], M[x + 1, lane], M[x + 2, lane]
        )
        M[h, lane] = up
