"""How good an estimate is, where the truth is known."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa._validate import array
from imm_tdoa.contract import Array


def rmse(error: Any, axis: int | tuple[int, ...] | None = None) -> Any:
    """Root mean square of the error's length.

    Parameters
    ----------
    error : (..., d)
        Estimate minus truth; rows with NaN do not count.
    axis : int or tuple, optional
        Axes of (...) to average over; default all.
    """
    e = array("error", error, (None, "d"), finite=False)
    return np.sqrt(np.nanmean(np.sum(e**2, axis=-1), axis=axis))


def nees(error: Any, covariance: Any) -> Array:
    """Normalised estimation error squared e' P^-1 e (...), chi-square with d degrees of freedom.

    Parameters
    ----------
    error : (..., d)
        Estimate minus truth.
    covariance : (..., d, d)
        What the estimator says of it; NaN gives NaN.
    """
    e = array("error", error, (None, "d"), finite=False)
    d = e.shape[-1]
    P = array("covariance", covariance, (None, d, d), finite=False)
    known = np.isfinite(e).all(axis=-1) & np.isfinite(P).all(axis=(-2, -1))
    P = np.where(known[..., None, None], P, np.eye(d))
    solved = np.linalg.solve(P, np.where(known[..., None], e, 0.0)[..., None])[..., 0]
    result: Array = np.where(known, np.einsum("...i,...i->...", e, solved), np.nan)
    return result


def nis(innovation: Any, covariance: Any) -> Array:
    """Normalised innovation squared nu' S^-1 nu (...); the same form as `nees`."""
    return nees(innovation, covariance)


def error_radius(covariance: Any, probability: float = 0.95) -> Array:
    """Radius (...) that the position error stays under with `probability`, by the covariance.

    The error's squared length is a sum of independent chi-square terms weighted by the
    eigenvalues of the covariance (..., d, d); its distribution is matched by a scaled chi-square
    with the same mean and variance (Satterthwaite), exact for a circle and for a needle.
    """
    from scipy.stats import chi2

    P = np.asarray(covariance, dtype=float)
    d = P.shape[-1]
    P = array("covariance", P, (None, d, d), finite=False)
    mean = np.einsum("...ii->...", P)
    square = np.einsum("...ij,...ji->...", P, P)
    with np.errstate(invalid="ignore", divide="ignore"):
        dof = np.where(square > 0.0, mean**2 / square, 1.0)
        result: Array = np.sqrt(chi2.ppf(probability, dof) * mean / dof)
    return result
