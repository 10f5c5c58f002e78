"""A scan read by a robust filter, and whether the track can still be trusted, compiled.

What `imm_tdoa.robust` and `imm_tdoa.reopening` say, for the lanes of a block one by one.
"""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel import robust
from imm_tdoa.kernel.compiling import allocating, compiled
from imm_tdoa.kernel.layout import Robust
from imm_tdoa.kernel.memory import Where

REJECTED, USED, LOST, SINCE, SNAPSHOT = 0, 1, 2, 3, 4  # columns of the trust records


@compiled
def reopens(how: Robust, block: int, targets: int) -> bool:
    """Whether some target of the block is lost, and rejected its last scan."""
    for target in range(block, block + targets):
        if how.trust[target, LOST] > 0.0 and how.trust[target, REJECTED] > 0.0:
            return True
    return False


@compiled
def offsets(
    M: Array, at: Where, q: int, rows: Index, group: Index, columns: Index, reference: Index
) -> None:
    """Eliminate shared offsets, as `gaussian.offset_contrast` does, in place.

    What is free is what is present less the rows taken as references; `reference` (m, L) is set
    to each row's reference, -1: none.
    """
    r, m, stride, R, nu, H = at.r, at.m, at.stride, at.R, at.nu, at.H
    for lane in range(M.shape[1]):
        for i in range(q):
            reference[i, lane] = -1
            M[at.free + i, lane] = M[at.present + i, lane]
        for i in range(q):
            if group[rows[i]] < 0 or M[at.present + i, lane] == 0.0:
                continue
            best = -1
            for k in range(q):
                alike = group[rows[k]] == group[rows[i]] and M[at.present + k, lane] > 0.0
                if alike and (best < 0 or M[R + k * m + k, lane] < M[R + best * m + best, lane]):
                    best = k
            reference[i, lane] = best
        for i in range(q):
            k = reference[i, lane]
            if k >= 0 and k != i:
                for j in range(r):
                    _subtract(M, nu + j * m, i, k, 1, 1, 1, lane)
                    size = columns[j]
                    _subtract(M, H + j * stride, i, k, size, size, 1, lane)
                _subtract(M, R, i, k, m, q, 1, lane)
        for i in range(q):
            k = reference[i, lane]
            if k >= 0 and k != i:
                _subtract(M, R, i, k, 1, q, m, lane)
        for k in range(q):
            if reference[k, lane] == k:
                M[at.free + k, lane] = 0.0
                _neutral(M, at, q, k, lane, columns)


@compiled
def _subtract(
    M: Array, A: int, i: int, k: int, apart: int, count: int, step: int, lane: int
) -> None:
    """Subtract row k of A from row i, rows `apart`; or column from column, rows `step` apart."""
    for p in range(count):
        M[A + i * apart + p * step, lane] -= M[A + k * apart + p * step, lane]


@compiled
def _neutral(M: Array, at: Where, q: int, k: int, lane: int, columns: Index) -> None:
    """Take row k out of lane lane."""
    m, R = at.m, at.R
    for j in range(at.r):
        M[at.nu + j * m + k, lane] = 0.0
        for a in range(columns[j]):
            M[at.H + j * at.stride + k * columns[j] + a, lane] = 0.0
    for p in range(q):
        M[R + k * m + p, lane] = 0.0
        M[R + p * m + k, lane] = 0.0
    M[R + k * m + k, lane] = 1.0


@allocating
def read(
    M: Array,
    at: Where,
    how: Robust,
    lane: int,
    target: int,
    t: int,
    q: int,
    rows: Index,
    columns: Index,
    variances: Array,
    reference: Index,
    verdict: Array,
) -> bool:
    """Read one lane's scan robustly, in place; whether the numbers held.

    `variances` (m,): of the rows as measured. `verdict` (3,) becomes the price, whether the scan
    is rejected, and how many independent pieces of information it has.
    """
    r, m, stride, R, nu, H, S = at.r, at.m, at.stride, at.R, at.nu, at.H, at.S_
    present, free, log_c, row_weight = at.present, at.free, at.log_c, at.row_weight
    own = min(1, how.directions.shape[0] - 1) * target
    then = t if how.directions.shape[1] > 1 else 0
    own_v = min(1, how.variance.shape[0] - 1) * target
    then_v = t if how.variance.shape[1] > 1 else 0
    sources = how.directions.shape[3]
    log_weight, there = np.zeros(r), np.zeros(q)
    pieces, measured = 0.0, 0.0
    for j in range(r):
        log_weight[j] = M[log_c + j, lane]
    for i in range(q):
        there[i] = M[free + i, lane]
        pieces += there[i]
        measured += M[present + i, lane]
        M[row_weight + i, lane] = 1.0
    verdict[0], verdict[1], verdict[2] = 0.0, 0.0, pieces
    if measured == 0.0:
        return True
    raw = np.zeros((q, sources + q))
    for i in range(q):
        if M[present + i, lane] > 0.0:
            for c in range(sources):
                raw[i, c] = how.directions[own, then, rows[i], c]
            raw[i, sources + i] = 1.0
    d = raw.copy()
    for i in range(q):
        k = reference[i, lane]
        if k >= 0 and k != i:
            for c in range(sources + q):
                d[i, c] -= raw[k, c]
    for i in range(q):
        if there[i] == 0.0:
            d[i, :] = 0.0
    parts = r + 1 if how.gates else r
    innovation, covariance = np.zeros((parts, q)), np.zeros((parts, q, q))
    for j in range(r):
        for i in range(q):
            innovation[j, i] = M[nu + j * m + i, lane]
            for p in range(i + 1):
                covariance[j, i, p] = M[S + j * m * m + i * m + p, lane]
                covariance[j, p, i] = covariance[j, i, p]
    if not how.gates:
        more = np.zeros(sources)
        v = np.zeros(sources)
        for c in range(sources):
            v[c] = how.variance[own_v, then_v, c]
        price, good = robust.student_t(
            log_weight, innovation, covariance, there, d[:, :sources].copy(), v,
            how.degrees_of_freedom, how.constant, how.digamma, more,
        )  # fmt: skip
        left = 0.0
        for i in range(q):
            extra = 0.0
            for c in range(sources):
                extra += raw[i, c] ** 2 * more[c]
            share = variances[i] / (variances[i] + extra)
            if M[present + i, lane] > 0.0:
                M[row_weight + i, lane] = share
                left += share
            for p in range(q):
                for c in range(sources):
                    M[R + i * m + p, lane] += d[i, c] * more[c] * d[p, c]
        verdict[0] = price
        verdict[1] = 1.0 if left <= 0.5 * measured else 0.0
        return bool(good)
    _moments(log_weight, innovation, covariance, there)
    slopes, noise = np.zeros((r, q, stride // m)), np.zeros((q, q))
    for i in range(q):
        for p in range(q):
            noise[i, p] = M[R + i * m + p, lane]
        for j in range(r):
            for a in range(columns[j]):
                slopes[j, i, a] = M[H + j * stride + i * columns[j] + a, lane]
    left_out = np.zeros(sources + q)
    price, rejected, good = robust.gate(
        log_weight, innovation, covariance, slopes, noise, there, d, sources, how.threshold,
        left_out,
    )  # fmt: skip
    verdict[0] = price
    verdict[1] = 1.0 if rejected else 0.0
    if np.sum(left_out) == 0.0:
        return bool(good)
    for i in range(q):
        for c in range(sources + q):
            if left_out[c] > 0.0 and raw[i, c] != 0.0:
                M[row_weight + i, lane] = 0.0
        for j in range(r):
            M[nu + j * m + i, lane] = innovation[j, i]
            for a in range(columns[j]):
                M[H + j * stride + i * columns[j] + a, lane] = slopes[j, i, a]
        for p in range(q):
            M[R + i * m + p, lane] = noise[i, p]
    for i in range(q):
        if M[free + i, lane] > 0.0 and there[i] == 0.0:
            M[free + i, lane] = 0.0
            _neutral(M, at, q, i, lane, columns)
    return bool(good)


@compiled
def _moments(log_weight: Array, nu: Array, S: Array, present: Array) -> None:
    """Put the moments of the modes' innovations last; rows that are not present neutral."""
    r, q = len(log_weight), len(present)
    for i in range(q):
        nu[r, i] = 0.0
        for j in range(r):
            nu[r, i] += np.exp(log_weight[j]) * nu[j, i]
    for i in range(q):
        for p in range(q):
            S[r, i, p] = 0.0
            for j in range(r):
                spread = (nu[j, i] - nu[r, i]) * (nu[j, p] - nu[r, p])
                S[r, i, p] += np.exp(log_weight[j]) * (S[j, i, p] + spread)


@compiled
def trust_after(
    M: Array,
    at: Where,
    how: Robust,
    target: int,
    lane: int,
    t: int,
    x: int,
    rejected: bool,
    pieces: float,
) -> None:
    """Trust in a target after a scan (`imm_tdoa.reopening.Trust.after`)."""
    if pieces == 0.0:
        return
    own, patience = how.trust[target], how.patience
    own[REJECTED] = own[REJECTED] + 1.0 if rejected else 0.0
    own[USED] = 0.0 if rejected else own[USED] + 1.0
    lost = (own[LOST] > 0.0 and own[USED] < patience) or own[REJECTED] >= patience
    own[LOST] = 1.0 if lost else 0.0
    if rejected or lost:
        return
    own[SINCE] = how.time[target if how.time.shape[0] > 1 else 0, t]
    size = at.means + at.squares
    for k in range(size):
        own[SNAPSHOT + k] = M[x + k, lane]
    for j in range(at.r):
        own[SNAPSHOT + size + j] = M[at.log_p + j, lane]
