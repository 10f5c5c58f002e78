"""How far one estimate is from the truth, and from what it says of itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtri

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

    Returns
    -------
    float or (...)
        The root mean square; NaN where no row counts.
    """
    square = np.sum(array("error", error, (None, "d"), finite=False) ** 2, axis=-1)
    known = np.isfinite(square)
    count = np.count_nonzero(known, axis=axis)
    total = np.sum(np.where(known, square, 0.0), axis=axis)
    return np.sqrt(np.where(count > 0, total, np.nan) / np.maximum(count, 1))


def nees(error: Any, covariance: Any) -> Array:
    """Normalised estimation error squared e' P^-1 e (...), chi-square with d degrees of freedom.

    Parameters
    ----------
    error : (..., d)
        Estimate minus truth.
    covariance : (..., d, d)
        What the estimator says of it; NaN gives NaN.

    Raises
    ------
    ValueError
        Shapes that do not fit, a singular covariance.
    """
    e = array("error", error, (None, "d"), finite=False)
    d = e.shape[-1]
    P = array("covariance", covariance, (None, d, d), finite=False)
    known = np.asarray(np.isfinite(e).all(axis=-1) & np.isfinite(P).all(axis=(-2, -1)))
    P = np.where(known[..., None, None], P, np.eye(d))
    e = np.where(known[..., None], e, 0.0)
    try:
        solved = np.linalg.solve(P, e[..., None])[..., 0]
    except np.linalg.LinAlgError as error_:
        raise ValueError("covariance: a matrix is singular") from error_
    result: Array = np.where(known, np.einsum("...i,...i->...", e, solved), np.nan)
    return result


def nis(innovation: Any, covariance: Any) -> Array:
    """Normalised innovation squared nu' S^-1 nu (...); the same form as `nees`.

    Parameters
    ----------
    innovation : (..., m)
        nu, measurement minus prediction.
    covariance : (..., m, m)
        S, what the filter says of it.
    """
    return nees(innovation, covariance)


def error_radius(covariance: Any, probability: float = 0.95) -> Array:
    """Radius (...) that the position error stays under with a given probability.

    The error's squared length is a sum of independent chi-square terms weighted by the
    eigenvalues of the covariance; its distribution is matched by a scaled chi-square with the
    same mean and variance (Satterthwaite), exact for a circle and for a needle.

    Parameters
    ----------
    covariance : (..., d, d)
        Covariance of the position error.
    probability : float
        Between 0 and 1.

    Raises
    ------
    ValueError
        No square matrices, or no probability.
    """
    P = array("covariance", covariance, (None, "d", "d"), finite=False)
    P = array("covariance", P, (None, P.shape[-1], P.shape[-1]), finite=False)
    if not 0.0 < probability < 1.0:
        raise ValueError(
            f"probability: expected a probability between 0 and 1, got {probability!r}"
        )
    mean = np.einsum("...ii->...", P)
    square = np.einsum("...ij,...ji->...", P, P)
    with np.errstate(invalid="ignore", divide="ignore"):
        dof = np.where(square > 0.0, mean**2 / square, 1.0)
        result: Array = np.sqrt(chdtri(dof, 1.0 - probability) * mean / dof)
    return result
