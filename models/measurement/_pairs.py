"""Differences of what stations share: their noise, and which of them say something new."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.geometry import difference_covariance, incidence


def shared_noise(variance: Array, pairs: Index) -> Array:
    """Return the covariance (..., m, m) of differences of station noise (..., S).

    Where a station's variance is NaN (nothing was measured there), the rows of that station are
    NaN and no other is touched.
    """
    unknown = np.isnan(variance)
    if not np.any(unknown):
        return difference_covariance(variance, pairs)
    R = difference_covariance(np.where(unknown, 0.0, variance), pairs)
    D = np.abs(incidence(pairs, variance.shape[-1]))
    row = np.einsum("...ms,...s->...m", D, unknown.astype(float)) > 0.0
    return np.where(row[..., :, None] | row[..., None, :], np.nan, R)


def spanning_rows(pairs: Index, present: Mask) -> Mask:
    """Return `present` (..., m) less the rows that close a loop with earlier present rows.

    With differences made of shared arrival times, a row that closes a loop is the sum of the
    others: it adds no information and makes R singular.
    """
    stations = int(pairs.max(initial=0)) + 1
    if pairs.ndim == 2:
        rank = np.linalg.matrix_rank(incidence(pairs, stations)) if len(pairs) else 0
        if rank == len(pairs):
            return present
    m = pairs.shape[-2]
    batch = np.broadcast_shapes(pairs.shape[:-2], present.shape[:-1])
    rows = np.broadcast_to(present, (*batch, m)).reshape(-1, m)
    ends = np.broadcast_to(pairs, (*batch, m, 2)).reshape(-1, m, 2)
    kept = np.array([_forest(p, e, stations) for p, e in zip(rows, ends, strict=True)])
    return kept.reshape(*batch, m)


def _forest(present: Mask, ends: Index, stations: int) -> list[bool]:
    """Kruskal's spanning forest over the present rows, in order."""
    tree = list(range(stations))
    kept = []
    for there, (a, b) in zip(present, ends, strict=True):
        root_a, root_b = tree[a], tree[b]
        new = bool(there) and root_a != root_b
        if new:
            tree = [root_b if root == root_a else root for root in tree]
        kept.append(new)
    return kept
