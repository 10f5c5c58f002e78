"""Gross errors, one target at a time: `imm_tdoa.robust` compiled, function for function.

Arrays here are one target's: innovations nu (parts, q) and their covariances S (parts, q, q) under
each mode and, in the gate, last by the bank's moments; directions d (q, k) in which sources of
error enter the q rows; `present` (q,) is 1 for rows that count.
"""

from __future__ import annotations

import math

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.kernel.compiling import allocating, compiled
from imm_tdoa.robust import AMBIGUOUS, ROUNDS, SAME, SETTLED, TESTABLE

LOG_2PI = math.log(2.0 * math.pi)
ROUNDING = (0.0, 1e-13, 1e-11, 1e-9)


@compiled
def cholesky(S: Array, present: Array, C: Array) -> bool:
    """Lower factor C of S, rows that are not present neutral; whether S was definite."""
    q = len(present)
    for rounding in ROUNDING:
        good = True
        for i in range(q):
            for k in range(i + 1):
                both = present[i] * present[k] > 0.0
                total = S[i, k] if both else (1.0 if i == k else 0.0)
                if i == k:
                    total *= 1.0 + rounding
                for p in range(k):
                    total -= C[i, p] * C[k, p]
                if k < i:
                    C[i, k] = total / C[k, k]
                else:
                    good = good and total > 0.0
                    C[i, i] = math.sqrt(total) if total > 0.0 else 1.0
        if good:
            return True
    return False


@compiled
def whitened(C: Array, y: Array, present: Array, w: Array) -> None:
    """w = C^-1 y, y zero in rows that are not present."""
    for i in range(len(y)):
        total = y[i] if present[i] > 0.0 else 0.0
        for k in range(i):
            total -= C[i, k] * w[k]
        w[i] = total / C[i, i]


@compiled
def log_sum(values: Array) -> float:
    """Log of the sum of exponentials."""
    top = -np.inf
    for value in values:
        top = max(top, value)
    if not math.isfinite(top):
        return top
    total = 0.0
    for value in values:
        total += math.exp(value - top)
    return top + math.log(total)


@compiled
def _judge(
    nu: Array,
    S: Array,
    present: Array,
    d: Array,
    C: Array,
    w: Array,
    e: Array,
    statistic: Array,
    information: Array,
) -> tuple[float, float, bool]:
    """Judge errors along the columns of d by N(0, S): log-density, log-determinant, success."""
    q = len(present)
    if not cholesky(S, present, C):
        return 0.0, 0.0, False
    whitened(C, nu, present, w)
    square, log_det = 0.0, 0.0
    for i in range(q):
        square += w[i] * w[i]
        log_det += 2.0 * math.log(C[i, i])
    for c in range(d.shape[1]):
        whitened(C, d[:, c], present, e)
        score, known, alone = 0.0, 0.0, 0.0
        for i in range(q):
            score += e[i] * w[i]
            known += e[i] * e[i]
            if present[i] > 0.0:
                alone += d[i, c] ** 2 * S[i, i]
        information[c] = known
        statistic[c] = score * score / known if known * alone > TESTABLE else 0.0
    return -0.5 * (square + log_det), log_det, True


@allocating
def gate(
    log_weight: Array,
    nu: Array,
    S: Array,
    H: Array,
    R: Array,
    present: Array,
    d: Array,
    sources: int,
    threshold: float,
    left_out: Array,
) -> tuple[float, bool, bool]:
    """Leave out sources as `imm_tdoa.robust.gate` does, in place.

    nu (r + 1, q), S (r + 1, q, q), H (r, q, c), R (q, q), present (q,) and d (q, k) become those
    of the combinations kept; `left_out` (k,) is set where a candidate goes. The first `sources`
    columns of d are sources, the others rows.

    Returns
    -------
    tuple
        The price, whether the scan is rejected, and whether the numbers held.
    """
    r, q, k = len(log_weight), len(present), d.shape[1]
    C, w, e = np.zeros((q, q)), np.zeros(q), np.zeros(q)
    statistic, information = np.zeros((r + 1, k)), np.zeros((r + 1, k))
    log_density = np.zeros(r + 1)
    joint = np.zeros(r)
    gain, suspect = np.zeros(k), np.zeros(k)
    before = np.sum(present)
    raw_rows = np.zeros(k)
    for c in range(k):
        for i in range(q):
            if d[i, c] != 0.0:
                raw_rows[c] = 1.0
    whole_log_det, log_det = 0.0, 0.0
    gone = False
    for turn in range(q + 1):
        for j in range(r + 1):
            log_density[j], log_det, good = _judge(
                nu[j], S[j], present, d, C, w, e, statistic[j], information[j]
            )
            if not good:
                return 0.0, False, False
        if turn == 0:
            whole_log_det = log_det
        if turn == q:
            break
        with_it = log_sum(log_density[:r] + log_weight)
        best = -np.inf
        for c in range(k):
            alive = False
            for i in range(q):
                alive = alive or d[i, c] != 0.0
            gain[c] = -np.inf
            if alive:
                for j in range(r):
                    known = information[j, c] if information[j, c] > 0.0 else 1.0
                    joint[j] = log_density[j] + log_weight[j]
                    joint[j] += 0.5 * (statistic[j, c] - math.log(known))
                known = information[r, c] if information[r, c] > 0.0 else 1.0
                gain[c] = log_sum(joint) - 0.5 * (threshold - math.log(known)) - with_it
            best = max(best, gain[c])
        worst = -1
        for c in range(k):
            if not math.isfinite(gain[c]):
                suspect[c] = 0.0
            if gain[c] > 0.0 and gain[c] >= best - AMBIGUOUS:
                suspect[c] = 1.0
            if suspect[c] > 0.0 and worst < 0:
                worst = c
        if worst < 0:
            break
        gone = True
        left_out[worst] = 1.0
        _eliminate(worst, nu, S, H, R, present, d)
    on_the_gate = -0.5 * (np.sum(present) * threshold + log_det)
    hopeless = log_sum(log_density[:r] + log_weight) < on_the_gate
    if hopeless and np.sum(present) > 0.0:
        gone = True
        for c in range(sources, k):
            left_out[c] = max(left_out[c], raw_rows[c])
        present[:] = 0.0
        log_det = 0.0
    if not gone:
        return 0.0, False, True
    kept = np.sum(present)
    price = -0.5 * ((before - kept) * (threshold + LOG_2PI) + whole_log_det - log_det)
    return price, bool(2.0 * kept <= before and before > 0.0), True


@allocating
def _eliminate(c: int, nu: Array, S: Array, H: Array, R: Array, present: Array, d: Array) -> None:
    """Combine the rows so that the error along column c of d occurs in none, and one row goes."""
    q, parts = len(present), len(nu)
    largest = 0.0
    for i in range(q):
        largest = max(largest, abs(d[i, c]))
    pivot, least = -1, np.inf
    for i in range(q):
        touched = present[i] > 0.0 and abs(d[i, c]) > TESTABLE * largest
        if touched and S[parts - 1, i, i] < least:
            pivot, least = i, S[parts - 1, i, i]
    if pivot < 0:
        return
    ratio = np.zeros(q)
    for i in range(q):
        touched = present[i] > 0.0 and abs(d[i, c]) > TESTABLE * largest
        if touched and i != pivot:
            ratio[i] = d[i, c] / d[pivot, c]
    for j in range(parts):
        for i in range(q):
            nu[j, i] -= ratio[i] * nu[j, pivot]
        _congruent(S[j], ratio, pivot)
    for j in range(len(H)):
        for i in range(q):
            for a in range(H.shape[2]):
                H[j, i, a] -= ratio[i] * H[j, pivot, a]
    _congruent(R, ratio, pivot)
    present[pivot] = 0.0
    for column in range(d.shape[1]):
        there = d[pivot, column]
        for i in range(q):
            d[i, column] -= ratio[i] * there
            if present[i] == 0.0 or abs(d[i, column]) <= 1e-12:
                d[i, column] = 0.0


@compiled
def _congruent(S: Array, ratio: Array, pivot: int) -> None:
    """S to T S T', T = I - ratio e_pivot'."""
    q = len(ratio)
    for i in range(q):
        if ratio[i] != 0.0:
            for k in range(q):
                S[i, k] -= ratio[i] * S[pivot, k]
    for k in range(q):
        if ratio[k] != 0.0:
            for i in range(q):
                S[i, k] -= ratio[k] * S[i, pivot]


@allocating
def student_t(
    log_weight: Array,
    nu: Array,
    S: Array,
    present: Array,
    d: Array,
    variance: Array,
    dof: float,
    constant: float,
    digamma: float,
    more: Array,
) -> tuple[float, bool]:
    """Trust sources less as `imm_tdoa.robust.student_t` does.

    nu (r, q), S (r, q, q): under each mode; d (q, k): the sources' directions. `more` (k,) is set
    to the variance that each source gets in addition. `constant` and `digamma` are the parts of
    the tail's price that do not depend on a weight.

    Returns
    -------
    tuple
        The price, and whether the numbers held.
    """
    r, q, k = len(log_weight), len(present), d.shape[1]
    heard, v = np.zeros(k), np.ones(k)
    for c in range(k):
        if math.isfinite(variance[c]) and variance[c] > 0.0:
            v[c] = variance[c]
            for i in range(q):
                if d[i, c] != 0.0:
                    heard[c] = 1.0
        if heard[c] == 0.0:
            d[:, c] = 0.0
    trial, lam, new = np.ones(k), np.ones(k), np.ones(k)
    square, e2 = np.zeros(k), np.zeros((r, k))
    joint, log_l = np.zeros(r), np.zeros(r)
    C, w, g, SQ = np.zeros((q, q)), np.zeros(q), np.zeros(q), np.zeros((q, q))
    best, price = -np.inf, 0.0
    for begin in range(2):
        trial[:] = 1.0
        for turn in range(ROUNDS):
            for j in range(r):
                good, log_l[j] = _explain(nu[j], S[j], present, d, v, trial, C, w, g, SQ, e2[j])
                if not good:
                    return 0.0, False
            square[:] = 0.0
            if turn == 0 and begin == 1:
                for j in range(r):
                    square += math.exp(log_weight[j]) * e2[j]
            else:
                for j in range(r):
                    joint[j] = log_weight[j] + log_l[j]
                total = log_sum(joint)
                for j in range(r):
                    square += math.exp(joint[j] - total) * e2[j]
            still = True
            for c in range(k):
                new[c] = 1.0
                if heard[c] > 0.0:
                    new[c] = min((dof + 1.0) / (dof + square[c] / v[c]), 1.0)
                still = still and abs(new[c] - trial[c]) <= SETTLED * new[c]
                trial[c] = new[c]
            if still:
                break
        cost = 0.0
        for c in range(k):
            if heard[c] > 0.0:
                cost += _tail_price(trial[c], dof, constant, digamma)
        for j in range(r):
            good, log_l[j] = _explain(nu[j], S[j], present, d, v, trial, C, w, g, SQ, e2[j])
            if not good:
                return 0.0, False
            joint[j] = log_weight[j] + log_l[j]
        bound = log_sum(joint) + cost
        if bound > best + SAME:
            best, price = bound, cost
            lam[:] = trial
    for c in range(k):
        more[c] = v[c] * (1.0 / lam[c] - 1.0) if heard[c] > 0.0 else 0.0
    return price, True


@compiled
def _explain(
    nu: Array,
    S: Array,
    present: Array,
    d: Array,
    v: Array,
    lam: Array,
    C: Array,
    w: Array,
    g: Array,
    SQ: Array,
    e2: Array,
) -> tuple[bool, float]:
    """E[e²] (k,) of the sources' errors given the innovation, and its log-density."""
    q, k = len(present), len(v)
    for i in range(q):
        for j in range(q):
            SQ[i, j] = S[i, j]
            for c in range(k):
                SQ[i, j] += d[i, c] * (v[c] / lam[c] - v[c]) * d[j, c]
    if not cholesky(SQ, present, C):
        return False, 0.0
    whitened(C, nu, present, w)
    square, log_det = 0.0, 0.0
    for i in range(q):
        square += w[i] * w[i]
        log_det += 2.0 * math.log(C[i, i])
    for c in range(k):
        whitened(C, d[:, c], present, g)
        score, known = 0.0, 0.0
        for i in range(q):
            score += g[i] * w[i]
            known += g[i] * g[i]
        noise = v[c] / lam[c]
        e2[c] = (noise * score) ** 2 + max(noise - noise * noise * known, 0.0)
    return True, -0.5 * (square + log_det)


@compiled
def _tail_price(lam: float, dof: float, constant: float, digamma: float) -> float:
    """What the variational bound pays for trusting a source by `lam` instead of 1."""
    a, a0 = 0.5 * (dof + 1.0), 0.5 * dof
    b = a / lam
    log_lam = digamma - math.log(b)
    divergence = constant + a0 * (math.log(b) - math.log(a0)) + a * (a0 - b) / b
    return 0.5 * (log_lam - math.log(lam)) - divergence
