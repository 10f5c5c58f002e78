"""Weighted Gaussians: the one idea that carries the IMM, model selection and Gaussian sums."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array


def normalise(log_weight: Array) -> tuple[Array, Array]:
    """Return log weights (..., N) that sum to one, and the log of their former sum (...).

    Where every weight is zero the logs stay -inf and so does the sum.
    """
    top = np.max(log_weight, axis=-1, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    shifted = log_weight - top
    with np.errstate(divide="ignore"):
        rest = np.log(np.sum(np.exp(shifted), axis=-1, keepdims=True))
    return shifted - np.where(np.isfinite(rest), rest, 0.0), (rest + top)[..., 0]


def moments(weight: Array, x: Array, P: Array) -> tuple[Array, Array]:
    """Mean (..., n) and covariance (..., n, n) of a mixture, spread of the means included.

    Parameters
    ----------
    weight : (..., N)
        Weights that sum to one.
    x : (..., N, n)
        Component means.
    P : (..., N, n, n)
        Component covariances.
    """
    mean = np.einsum("...i,...ia->...a", weight, x)
    d = x - mean[..., None, :]
    spread = P + d[..., :, None] * d[..., None, :]
    covariance = np.einsum("...i,...iab->...ab", weight, spread)
    return mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
