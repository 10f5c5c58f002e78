"""Rows of one kind, whatever their pairs, as differences of ranges against one station each."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.geometry import incidence


class Merged(NamedTuple):
    """Whitened rows z (N, m) = D (N, m, S) ranges, and which stations they connect (N, S, S)."""

    z: Array
    D: Array
    connected: Mask

    @classmethod
    def of(cls, part: Any, times: Array, z: Array, known: Mask, heard: Mask) -> Merged:
        S = heard.shape[-1]
        if hasattr(part, "pairs"):
            D = np.broadcast_to(incidence(part.pairs, S), (*z.shape, S))
        else:
            D = np.broadcast_to(np.eye(S), (*z.shape, S))
        known = known & ~np.any((D != 0.0) & ~heard[:, None, :], axis=-1)
        R = np.broadcast_to(part.sensor_covariance(times), (*z.shape, z.shape[-1]))
        both = known[:, :, None] & known[:, None, :]
        T, left = gaussian.offset_contrast(np.einsum("nii->ni", R), known, part.offset_group)
        z = np.einsum("...ij,...j->...i", T, np.where(known, z, 0.0))
        D = T @ np.where(known[..., None], D, 0.0)
        R = T @ np.where(both, R, 0.0) @ np.swapaxes(T, -1, -2)
        z, D, R = gaussian.mask_rows(z, D, R, left)
        L = gaussian.factor(R, "noise covariance")
        white = np.linalg.solve(L, np.concatenate([D, z[..., None]], axis=-1))
        touched = np.abs(D) > 0.0
        step = np.einsum("nms,nmt->nst", touched.astype(float), touched.astype(float)) > 0.0
        for _ in range(max(S - 1, 1).bit_length()):
            step = np.einsum("nst,ntu->nsu", step.astype(float), step.astype(float)) > 0.0
        return cls(white[..., -1], white[..., :-1], step)

    def against(self, column: Index, known: Mask) -> tuple[Array, Array, Array, Index]:
        """Differences of the `known` columns after the first against it, and what is left over.

        Returns the differences (N, K - 1), a root of their covariance, the chi2 (N,) and the
        number (N,) of the rows.
        """
        one = np.arange(len(column))[:, None]
        D = np.swapaxes(np.swapaxes(self.D, -1, -2)[one, column[:, 1:]], -1, -2)
        D = np.where(known[:, None, :], D, 0.0)
        own = np.any(D != 0.0, axis=-1)
        z = np.where(own, self.z, 0.0)
        A = np.swapaxes(D, -1, -2) @ D
        both = known[:, :, None] & known[:, None, :]
        C = gaussian.symmetric(np.linalg.inv(np.where(both, A, np.eye(A.shape[-1]))))
        x = (C @ np.swapaxes(D, -1, -2) @ z[..., None])[..., 0]
        misfit = z - np.einsum("nmk,nk->nm", D, x)
        root = np.where(known[..., None], gaussian.factor(C, "noise covariance"), 0.0)
        count = np.count_nonzero(own, axis=-1)
        return np.where(known, x, 0.0), root, np.einsum("nm,nm->n", misfit, misfit), count
