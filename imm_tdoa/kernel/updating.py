"""The Kalman update (ALGORITHMS §4), compiled: `imm_tdoa.gaussian.update` for many targets.

q is the number of rows that count, m of all rows. S and its factor C are lower triangles with
rows of length m.
"""

from __future__ import annotations

import math

from imm_tdoa.contract import Array
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.elementary import log
from imm_tdoa.kernel.vectors import Lanes, anywhere, choose, fill, get, put, sqrt

LOG_2PI = math.log(2.0 * math.pi)
ROUNDING = (1e-13, 1e-11, 1e-9)  # as in imm_tdoa.gaussian
PIVOTS = 16  # factors multiplied before a logarithm is taken; their product stays in range


@compiled
def innovation_covariance(
    lanes: Lanes,
    M: Array,
    n: int,
    columns: int,
    q: int,
    m: int,
    P: int,
    H: int,
    R: int,
    HP: int,
    S: int,
) -> None:
    """HP[i, b] = H P, and S = H P H' + R. R: (m, m), symmetric."""
    for i in range(q):
        Hi, HPi = H + i * columns, HP + i * n
        for b in range(n):
            total = get(lanes, M, Hi) * get(lanes, M, P + b)
            for a in range(1, columns):
                total = total + get(lanes, M, Hi + a) * get(lanes, M, P + a * n + b)
            put(lanes, M, HPi + b, total)
        for k in range(i + 1):
            total = get(lanes, M, R + i * m + k)
            for a in range(columns):
                total = total + get(lanes, M, HPi + a) * get(lanes, M, H + k * columns + a)
            put(lanes, M, S + i * m + k, total)


@compiled
def factor(lanes: Lanes, M: Array, q: int, m: int, S: int, C: int, pivot: int) -> bool:
    """Cholesky factor C of S below its diagonal, pivot[i] = 1/C[i, i]; whether S was definite.

    Where S is indefinite by rounding it is lifted, as `gaussian.innovation_factor` does.
    """
    for i in range(q):
        for k in range(i + 1):
            total = get(lanes, M, S + i * m + k)
            for p in range(k):
                total = total - get(lanes, M, C + i * m + p) * get(lanes, M, C + k * m + p)
            if k < i:
                put(lanes, M, C + i * m + k, total * get(lanes, M, pivot + k))
            else:
                put(lanes, M, C + i * m + i, total)
                put(lanes, M, pivot + i, 1.0 / sqrt(total))
    unsound = fill(lanes, 0.0)
    for i in range(q):
        unsound = choose(get(lanes, M, C + i * m + i), unsound, 1.0)
    good = True
    if anywhere(unsound):
        for lane in range(len(lanes)):
            sound = True
            for i in range(q):
                sound = sound and M[C + i * m + i, lane] > 0.0
            if not sound:
                good = _lifted(M, q, m, S, C, pivot, lane) and good
    return good


@compiled
def _lifted(M: Array, q: int, m: int, S: int, C: int, pivot: int, lane: int) -> bool:
    """Factor one lane's S again, its diagonal lifted by the rounding of its own entries."""
    for rounding in ROUNDING:
        sound = True
        for i in range(q):
            for k in range(i + 1):
                total = M[S + i * m + k, lane] * (1.0 + rounding if i == k else 1.0)
                for p in range(k):
                    total -= M[C + i * m + p, lane] * M[C + k * m + p, lane]
                if k < i:
                    M[C + i * m + k, lane] = total * M[pivot + k, lane]
                else:
                    sound = sound and total > 0.0
                    M[pivot + i, lane] = 1.0 / math.sqrt(total) if total > 0.0 else 0.0
        if sound:
            return True
    return False


@compiled
def whiten(lanes: Lanes, M: Array, q: int, m: int, C: int, pivot: int, y: int, w: int) -> None:
    """w = C^-1 y for a vector y[i]."""
    for i in range(q):
        total = get(lanes, M, y + i)
        for k in range(i):
            total = total - get(lanes, M, C + i * m + k) * get(lanes, M, w + k)
        put(lanes, M, w + i, total * get(lanes, M, pivot + i))


@compiled
def log_density(
    lanes: Lanes, M: Array, q: int, w: int, pivot: int, count: int, nis: int, log_l: int
) -> None:
    """nis = w'w, and the log-density of `count` rows whose white innovation is w."""
    square = fill(lanes, 0.0)
    log_det = fill(lanes, 0.0)
    for begin in range(0, q, PIVOTS):
        product = get(lanes, M, pivot + begin)
        for i in range(begin + 1, min(begin + PIVOTS, q)):
            product = product * get(lanes, M, pivot + i)
        log_det = log_det - log(product)
    for i in range(q):
        square = square + get(lanes, M, w + i) * get(lanes, M, w + i)
    put(lanes, M, nis, square)
    put(lanes, M, log_l, -0.5 * (square + get(lanes, M, count) * LOG_2PI) - log_det)


@compiled
def update(
    lanes: Lanes,
    M: Array,
    n: int,
    columns: int,
    q: int,
    m: int,
    nu: int,
    H: int,
    R: int,
    HP: int,
    C: int,
    pivot: int,
    K: int,
    E: int,
    x: int,
    P: int,
) -> None:
    """x + K nu, and P in Joseph's form, both in place; K, E: scratch, (m, n).

    With W = (I - K H) P, whose rounding error may be as large as P's when P is diffuse, Joseph's
    (I - K H) P (I - K H)' + K R K' is W + (K R - W H') K': the same cancellation of errors to
    first order at a fraction of the work.
    """
    for i in range(q):  # A = C^-1 H P
        for b in range(n):
            total = get(lanes, M, HP + i * n + b)
            for k in range(i):
                total = total - get(lanes, M, C + i * m + k) * get(lanes, M, K + k * n + b)
            put(lanes, M, K + i * n + b, total * get(lanes, M, pivot + i))
    for a in range(n):  # W = P - A'A
        for b in range(a + 1):
            total = get(lanes, M, P + a * n + b)
            for i in range(q):
                total = total - get(lanes, M, K + i * n + a) * get(lanes, M, K + i * n + b)
            put(lanes, M, P + a * n + b, total)
            put(lanes, M, P + b * n + a, total)
    for i in range(q - 1, -1, -1):  # K' = C'^-1 A
        for b in range(n):
            total = get(lanes, M, K + i * n + b)
            for k in range(i + 1, q):
                total = total - get(lanes, M, C + k * m + i) * get(lanes, M, K + k * n + b)
            put(lanes, M, K + i * n + b, total * get(lanes, M, pivot + i))
    for a in range(n):
        mean = get(lanes, M, x + a)
        for i in range(q):
            mean = mean + get(lanes, M, K + i * n + a) * get(lanes, M, nu + i)
        put(lanes, M, x + a, mean)
    for i in range(q):  # E = (K R - W H')'
        for a in range(n):
            total = get(lanes, M, R + i * m) * get(lanes, M, K + a)
            for k in range(1, q):
                total = total + get(lanes, M, R + i * m + k) * get(lanes, M, K + k * n + a)
            for b in range(columns):
                here = P + b * n + a
                total = total - get(lanes, M, here) * get(lanes, M, H + i * columns + b)
            put(lanes, M, E + i * n + a, total)
    for a in range(n):
        for b in range(a + 1):
            total = get(lanes, M, P + a * n + b)
            for i in range(q):
                total = total + get(lanes, M, E + i * n + a) * get(lanes, M, K + i * n + b)
            put(lanes, M, P + a * n + b, total)
            put(lanes, M, P + b * n + a, total)
