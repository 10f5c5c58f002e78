"""Normal matrices: their inverse in units that suit them, and whether they have one."""

from __future__ import annotations

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Mask

REGULAR = 1e-11  # least eigenvalue over largest of a normal matrix of unit diagonal


def spectrum(A: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues w, eigenvectors V of A (..., n, n) in units where its diagonal is 1; the units.

    A = diag(units) V diag(w) V' diag(units); the units (..., n) are floored against zeros.
    """
    units = np.sqrt(np.einsum("...ii->...i", A))
    top = np.max(units, axis=-1, keepdims=True)
    units = np.maximum(units, np.where(top > 0.0, 1e-9 * top, 1.0))
    w, V = np.linalg.eigh(A / (units[..., :, None] * units[..., None, :]))
    return np.maximum(w, 0.0), V, units


def inverse(A: Array) -> tuple[Array, Mask]:
    """Inverse of A (..., n, n), NaN where it is singular to working accuracy; and where not."""
    w, V, units = spectrum(A)
    regular: Mask = np.asarray(w[..., 0] > REGULAR * w[..., -1])
    w = np.where(regular[..., None], w, np.nan)
    unit = np.einsum("...ik,...k,...jk->...ij", V, 1.0 / w, V)
    return gaussian.symmetric(unit / (units[..., :, None] * units[..., None, :])), regular
