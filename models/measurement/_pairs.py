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
    m = pairs.shape[-2]
    if m < 2:
        return present
    if pairs.ndim == 2:
        rank = np.linalg.matrix_rank(incidence(pairs, stations))
        if rank == m:
            return present
    batch = np.broadcast_shapes(pairs.shape[:-2], present.shape[:-1])
    present = np.broadcast_to(present, (*batch, m))
    # Kruskal's spanning forest over the present rows, in order: root of each station's tree
    root = np.broadcast_to(np.arange(stations), (*batch, stations))
    kept = np.zeros((*batch, m), dtype=bool)
    for i in range(m):
        ends = np.broadcast_to(pairs[..., i, :], (*batch, 2))
        a, b = np.moveaxis(np.take_along_axis(root, ends, axis=-1), -1, 0)
        kept[..., i] = present[..., i] & (a != b)
        joins = kept[..., i, None] & (root == a[..., None])
        root = np.where(joins, b[..., None], root)
    return kept
