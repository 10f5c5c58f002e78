"""What lies where in a block's memory: the rows of M at which each vector or matrix begins."""

from __future__ import annotations

from typing import NamedTuple

from imm_tdoa.contract import Index
from imm_tdoa.kernel.compiling import compiled


class Where(NamedTuple):
    """Sizes, and where in the memory things begin; r modes, m rows, S stations, d dimensions.

    Attributes
    ----------
    r, d, m, S, N : int
        Numbers of modes, dimensions, rows, stations, and components of the largest mode.
    means, squares : int
        Components of all modes, and of all their covariances.
    stride : int
        Rows of M that one mode's Jacobian takes.
    x, P
        Means and covariances of the modes, as in a record.
    log_p, total, bank, heard, log_l, nis, weight, lost, reopened
        The rest of a record (`layout.Record`), in its order: log-probabilities (r) and
        log-likelihood; NIS against the whole bank's moments, how many rows count; log-likelihood
        and NIS of each mode (r); weight of each row (m); whether lost, or reopened.
    x_other, P_other
        Room for the modes of the next step.
    Q, f, Pi
        As in a table of a time step (`plan.Plan.tables`): process noise (as P), transition per
        axis (order² a mode), chain (r, r).
    w, log_c, xm, Pm, d0, d1, FP
        Mixing weights (r, r), predicted log-probabilities (r), and scratch of the prediction.
    place, speed, G
        Of the stations (S, d), and their geometry (S, 2 + 2 d).
    z, present, free, row_weight
        The q rows that count: values, 1 where measured, 1 where not taken as a reference or left
        out, and their weights.
    R, nu, H, HP, S_
        Noise (m, m), and for each mode innovation (m), Jacobian, H P and its covariance (m, m).
    mean, Sm
        Moments of the whole bank's innovation; they follow those of the last mode.
    C, pivot, K, E, white
        Scratch of the update.
    record, size : int
        Rows of a record, and of M.
    """

    r: int
    d: int
    m: int
    S: int
    N: int
    means: int
    squares: int
    stride: int
    x: int
    P: int
    log_p: int
    total: int
    bank: int
    heard: int
    log_l: int
    nis: int
    weight: int
    lost: int
    reopened: int
    x_other: int
    P_other: int
    Q: int
    f: int
    Pi: int
    w: int
    log_c: int
    xm: int
    Pm: int
    d0: int
    d1: int
    FP: int
    place: int
    speed: int
    G: int
    z: int
    present: int
    free: int
    row_weight: int
    R: int
    nu: int
    mean: int
    H: int
    HP: int
    S_: int
    Sm: int
    C: int
    pivot: int
    K: int
    E: int
    white: int
    record: int
    size: int


@compiled
def lay_out(n: Index, order: Index, d: int, m: int, S: int) -> Where:
    """Return where things lie for modes of n (r,) components and `order` (r,) derivatives."""
    r, N = len(n), 0
    means, squares, orders = 0, 0, 0
    for j in range(r):
        N = max(N, n[j])
        means += n[j]
        squares += n[j] * n[j]
        orders += order[j] * order[j]
    stride = m * 2 * d
    log_p = means + squares
    log_l = log_p + r + 3
    weight = log_l + 2 * r
    record = weight + m + 2
    other_x = record
    Q = other_x + means + squares
    f = Q + squares
    Pi = f + orders
    w = Pi + r * r
    log_c = w + r * r
    xm = log_c + r
    Pm = xm + N
    d0 = Pm + N * N
    d1 = d0 + r * N
    FP = d1 + r * N
    place = FP + N * N
    speed = place + S * d
    G = speed + S * d
    z = G + S * (2 + 2 * d)
    present = z + m
    free = present + m
    row_weight = free + m
    R = row_weight + m
    nu = R + m * m
    mean = nu + r * m
    H = mean + m
    HP = H + r * stride
    S_ = HP + r * m * N
    Sm = S_ + r * m * m
    C = Sm + m * m
    pivot = C + m * m
    K = pivot + m
    E = K + m * N
    white = E + m * N
    return Where(
        r=r, d=d, m=m, S=S, N=N, means=means, squares=squares, stride=stride, x=0, P=means,
        log_p=log_p, total=log_p + r, bank=log_p + r + 1, heard=log_p + r + 2, log_l=log_l,
        nis=log_l + r, weight=weight, lost=weight + m, reopened=weight + m + 1,
        x_other=other_x, P_other=other_x + means,
        Q=Q, f=f, Pi=Pi, w=w, log_c=log_c, xm=xm, Pm=Pm, d0=d0, d1=d1, FP=FP,
        place=place, speed=speed, G=G, z=z, present=present, free=free, row_weight=row_weight,
        R=R, nu=nu, H=H, HP=HP, S_=S_, C=C, pivot=pivot, K=K, E=E, white=white,
        Sm=Sm, mean=mean, record=record, size=white + m,
    )  # fmt: skip


class Room(NamedTuple):
    """Where things lie that only a robust filter needs, after the rest; k sources of error.

    Attributes
    ----------
    trust
        How far each target is trusted, as in a trust record (`layout.Robust`).
    variance
        Of the rows as they were measured (m).
    raw, D
        Directions (k + m, m) in which sources, and then rows as sources, enter the rows as
        measured, and the rows free of offsets.
    price, rejected, pieces
        Of the scan as it is read: the price, whether it is rejected, and how many independent
        pieces of information it has.
    nothing
        A zero.
    score, log_density, joint
        Of one source; of the rows under each mode, and last the bank's moments (r + 1); scratch.
    statistic, information
        Of each source under each of them (r + 1, k + m).
    there, ratio, gain, suspect, worst, gone, whole
        Of the gate: rows that are left (m), how rows are combined (m); for each source (k + m)
        what leaving it out gains and whether it may be the bad one; which goes first; whether any
        went; the log-determinant of all rows.
    v, heard, trial, lam, noise, square, foreseen, e2
        Of the tails, for each source (k): variance, whether it shows, weight, the better weight,
        variance by its weight, E[e²] and that under the modes as predicted, E[e²] under each
        mode (r, k).
    extra, settled, best
        What is added to S (m, m); whether the weights are found; the best bound.
    size : int
        Rows of M.
    """

    trust: int
    variance: int
    raw: int
    D: int
    price: int
    rejected: int
    pieces: int
    nothing: int
    score: int
    log_density: int
    joint: int
    statistic: int
    information: int
    there: int
    ratio: int
    gain: int
    suspect: int
    worst: int
    gone: int
    whole: int
    v: int
    heard: int
    trial: int
    lam: int
    noise: int
    square: int
    foreseen: int
    e2: int
    extra: int
    settled: int
    best: int
    size: int


@compiled
def make_room(at: Where, k: int, trust: int) -> Room:
    """Return where things lie for k sources of error and trust records of `trust` numbers."""
    r, m = at.r, at.m
    variance = at.size + trust
    raw = variance + m
    D = raw + (k + m) * m
    price = D + (k + m) * m
    score = price + 4
    log_density = score + 1
    joint = log_density + r + 1
    statistic = joint + r
    information = statistic + (r + 1) * (k + m)
    there = information + (r + 1) * (k + m)
    ratio = there + m
    gain = ratio + m
    suspect = gain + k + m
    worst = suspect + k + m
    v = worst + 3
    e2 = v + 7 * k
    extra = e2 + r * k
    settled = extra + m * m
    return Room(
        trust=at.size, variance=variance, raw=raw, D=D, price=price, rejected=price + 1,
        pieces=price + 2, nothing=price + 3, score=score, log_density=log_density, joint=joint,
        statistic=statistic, information=information, there=there, ratio=ratio, gain=gain,
        suspect=suspect, worst=worst, gone=worst + 1, whole=worst + 2,
        v=v, heard=v + k, trial=v + 2 * k, lam=v + 3 * k, noise=v + 4 * k, square=v + 5 * k,
        foreseen=v + 6 * k, e2=e2, extra=extra, settled=settled, best=settled + 1, size=settled + 2,
    )  # fmt: skip
