"""From a covariance to the mean length of the error, which tables often mean by "error"."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import elliprg

from imm_tdoa import _validate
from imm_tdoa.contract import Array


def mean_error(covariance: Any) -> Array:
    """Return E‖e‖ of a Gaussian error e ~ N(0, C) in one, two or three dimensions.

    With λ the eigenvalues of C, those lacking being zero, and R_G Carlson's completely symmetric
    elliptic integral of the second kind (DLMF 19.16.3),

        E‖e‖ = sqrt(8/π) R_G(λ1, λ2, λ3),

    E‖z‖ = sqrt(8/π) of a unit Gaussian z in space times the mean of sqrt(u' C u) over the unit
    sphere. In the plane it is sqrt(2/π) s1 E(1 - s2²/s1²) with the complete elliptic integral E
    (ALGORITHMS §3.6). The ratio to the root mean square lies between 0.798 (a needle) and 0.886
    (a circle) or 0.921 (a sphere).

    Parameters
    ----------
    covariance : (..., d, d)
        Covariances, d = 1 to 3; m² for metres. Infinite variances give an infinite error, NaN
        gives NaN.

    Raises
    ------
    ValueError
        No square matrices of one to three rows, or one that is not positive semi-definite.
    """
    C = np.asarray(covariance, dtype=float)
    if C.ndim < 2 or C.shape[-1] != C.shape[-2] or C.shape[-1] not in (1, 2, 3):
        raise ValueError(
            f"covariance: expected shape (..., d, d) with d from 1 to 3, got {C.shape}"
        )
    variance = np.einsum("...ii->...i", C)
    infinite = np.any(np.isposinf(variance), axis=-1)
    unknown = ~np.isfinite(C).all(axis=(-2, -1))
    C = _validate.covariance("covariance", np.where(unknown[..., None, None], 0.0, C), C.shape[-1])
    eigenvalues = np.maximum(np.linalg.eigvalsh(C), 0.0)
    padded = np.zeros((3, *C.shape[:-2]))
    padded[: C.shape[-1]] = np.moveaxis(eigenvalues, -1, 0)
    length = np.sqrt(8.0 / np.pi) * elliprg(*padded)
    result: Array = np.where(unknown, np.where(infinite, np.inf, np.nan), length)
    return result
