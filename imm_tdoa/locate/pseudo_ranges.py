"""Ranges up to a constant, from any measurement model whose rows are sums of ranges.

A measurement model does not say how it is made, only what it predicts. Rows that are linear
combinations of ranges to the stations (arrival times, their differences) are recognised by
fitting just that to their predictions.
"""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.geometry import ranges
from imm_tdoa.locate.problem import Problem

FITS = 1e-7  # relative misfit below which a row counts as a sum of ranges


def pseudo_ranges(problem: Problem) -> tuple[Array, Array, Mask]:
    """Return stations (B, S, d), ranges plus a constant (B, S) to them, and which are heard.

    One scan of each fit is used, that in which most of its rows stand.
    """
    scan = np.argmax(np.count_nonzero(problem.present, axis=-1), axis=-1)
    s, D = _range_sums(problem, scan)
    fit = np.arange(len(problem.z))
    present = problem.present[fit, scan] & np.any(D != 0.0, axis=-1)
    z = np.where(present, problem.z[fit, scan], 0.0)
    D = np.where(present[..., None], D, 0.0)
    heard = np.asarray(np.any(D != 0.0, axis=-2) & np.isfinite(s).all(axis=-1))
    Dt = np.swapaxes(D, -1, -2)
    together = np.where(heard[:, :, None] & heard[:, None, :], 1.0, np.eye(s.shape[1]))
    N = Dt @ D + together + 1e-9 * np.eye(s.shape[1])  # the constant is set by a sum of zero
    tau = np.linalg.solve(N, Dt @ z[..., None])[..., 0]
    return s, np.where(heard, tau, 0.0), heard


def _range_sums(problem: Problem, scan: Index) -> tuple[Array, Array]:
    """Stations (B, S, d) at `scan` (B,) and D (B, k, S), which makes rows from ranges to them.

    Rows that no matrix makes, and rows that do not depend on ranges, are zero in D.
    """
    B = len(problem.z)
    model, time = problem.one_scan(scan)
    L = len(time)
    measured = np.isfinite(problem.scans.values[np.arange(B), scan])
    if L == 1:
        measured = np.any(measured, axis=0, keepdims=True)
    s = _distinct(model.anchors(time, measured[:, None]), L)
    x, r = _samples(s)
    y = model.predict(x, np.zeros_like(x), time)[..., problem.rows]
    X = np.linalg.pinv(r, rcond=1e-13) @ y
    misfit = np.max(np.abs(r @ X - y), axis=-2)
    X = np.where((misfit <= FITS * np.max(np.abs(y), axis=-2))[:, None], X, 0.0)
    D = np.swapaxes(np.where(np.abs(X) > 1e-3, X, 0.0), -1, -2)
    return np.broadcast_to(s, (B, *s.shape[1:])), np.broadcast_to(D, (B, *D.shape[1:]))


def _distinct(s: Array, L: int) -> Array:
    """Stations (L, S, d) from anchors (..., S', d), once each: stacked models share theirs."""
    s = np.broadcast_to(s, (L, 1, *s.shape[-2:]))[:, 0]
    known = np.asarray(np.isfinite(s).all(axis=-1))
    columns = np.where(known[..., None], s, np.inf).swapaxes(0, 1)
    _, first = np.unique(columns, axis=0, return_index=True)
    heard = np.any(known[:, first], axis=0)
    return s[:, first[heard]]


def _samples(s: Array) -> tuple[Array, Array]:
    """Places (L, P, d) near and among stations (L, S, d), and ranges (L, P, S); NaN gives 0."""
    L, S, d = s.shape
    known = np.asarray(np.isfinite(s).all(axis=-1, keepdims=True))
    count = np.maximum(np.count_nonzero(known, axis=1), 1)
    centre = (np.sum(np.where(known, s, 0.0), axis=1) / count)[:, None]
    s = np.where(known, s, centre)
    spread = 1.0 + np.sqrt(np.sum((s - centre) ** 2, axis=(1, 2)) / count[:, 0])
    scatter = np.random.default_rng(0).normal(size=(2 * S + 5, d))
    scatter[:S] *= 0.1
    base = np.concatenate([s, np.broadcast_to(centre, (L, S + 5, d))], axis=1)
    x = base + 1.5 * spread[:, None, None] * scatter
    return x, np.where(known.swapaxes(1, 2), ranges(x, s[:, None])[0], 0.0)
