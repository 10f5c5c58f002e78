"""What lies where in a block's memory: the rows of M at which each vector or matrix begins."""

from __future__ import annotations

from typing import NamedTuple

from imm_tdoa.contract import Index
from imm_tdoa.kernel.vectors import compiled


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
    x, P, log_p, total
        Modes as in a record: means, covariances, log-probabilities; the log-likelihood.
    x_other, P_other
        Room for the modes of the next step.
    Q, f, Pi
        Process noise (as P), transition per axis (order² a mode), chain (r, r).
    w, log_c, xm, Pm, d0, d1, FP
        Mixing weights (r, r), predicted log-probabilities (r), and scratch of the prediction.
    place, speed, G
        Of the stations (S, d), and their geometry (S, 2 + 2 d).
    z, present, free, heard
        The q rows that count: values, 1 where measured, 1 where not taken as a reference or left
        out, and how many of those.
    R, nu, H, HP, S_
        Noise (m, m), and for each mode innovation (m), Jacobian, H P and its covariance (m, m).
    C, pivot, K, E, white
        Scratch of the update.
    Sm, mean, bank
        Moments of the whole bank's innovation, and its NIS.
    log_l, nis
        Log-likelihood and NIS of each mode (r).
    top, row_weight
        Scratch; weight of each row (m).
    size : int
        Rows of M.
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
    heard: int
    R: int
    nu: int
    H: int
    HP: int
    S_: int
    C: int
    pivot: int
    K: int
    E: int
    white: int
    Sm: int
    mean: int
    bank: int
    log_l: int
    nis: int
    top: int
    row_weight: int
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
    other_x = log_p + r + 1
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
    count = free + m
    R = count + 1
    nu = R + m * m
    H = nu + r * m
    HP = H + r * stride
    S_ = HP + r * m * N
    C = S_ + r * m * m
    pivot = C + m * m
    K = pivot + m
    E = K + m * N
    white = E + m * N
    Sm = white + m
    mean = Sm + m * m
    bank = mean + m
    log_l = bank + 1
    nis = log_l + r
    top = nis + r
    row_weight = top + 1
    return Where(
        r=r, d=d, m=m, S=S, N=N, means=means, squares=squares, stride=stride,
        x=0, P=means, log_p=log_p, total=log_p + r, x_other=other_x, P_other=other_x + means,
        Q=Q, f=f, Pi=Pi, w=w, log_c=log_c, xm=xm, Pm=Pm, d0=d0, d1=d1, FP=FP,
        place=place, speed=speed, G=G, z=z, present=present, free=free, heard=count,
        R=R, nu=nu, H=H, HP=HP, S_=S_, C=C, pivot=pivot, K=K, E=E, white=white,
        Sm=Sm, mean=mean, bank=bank, log_l=log_l, nis=nis, top=top, row_weight=row_weight,
        size=row_weight + m,
    )  # fmt: skip
