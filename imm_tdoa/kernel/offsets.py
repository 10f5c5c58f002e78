"""Shared offsets eliminated from a scan, and rows taken out of it, compiled."""

from __future__ import annotations

from imm_tdoa.contract import Array, Index
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.memory import Where


@compiled
def any_shared(group: Index) -> bool:
    """Whether any rows share an offset."""
    shared = 0
    for own in group:
        shared += own >= 0
    return shared > 0


@compiled
def eliminate(
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
                    M[nu + j * m + i, lane] -= M[nu + j * m + k, lane]
                    size, own = columns[j], H + j * stride
                    for a in range(size):
                        M[own + i * size + a, lane] -= M[own + k * size + a, lane]
                for p in range(q):
                    M[R + i * m + p, lane] -= M[R + k * m + p, lane]
        for i in range(q):
            k = reference[i, lane]
            if k >= 0 and k != i:
                for p in range(q):
                    M[R + p * m + i, lane] -= M[R + p * m + k, lane]
        for k in range(q):
            if reference[k, lane] == k:
                M[at.free + k, lane] = 0.0
                neutral(M, at, q, k, lane, columns)


@compiled
def neutral(M: Array, at: Where, q: int, k: int, lane: int, columns: Index) -> None:
    """Take row k out of one lane."""
    m = at.m
    for j in range(at.r):
        M[at.nu + j * m + k, lane] = 0.0
        for a in range(columns[j]):
            M[at.H + j * at.stride + k * columns[j] + a, lane] = 0.0
    single_out(M, at.R, q, m, k, lane)


@compiled
def single_out(M: Array, A: int, q: int, m: int, k: int, lane: int) -> None:
    """Make row and column k of one lane's A (m, m) those of the unit matrix."""
    for p in range(q):
        M[A + k * m + p, lane] = 0.0
        M[A + p * m + k, lane] = 0.0
    M[A + k * m + k, lane] = 1.0
