"""Sigma points: how a Gaussian passes through a function that bends (ALGORITHMS §4).

A function is replaced by the straight line that fits it best over the Gaussian, with what the
line misses as noise of its own (statistical linearisation). For the points of the unscented
transform that is the unscented Kalman filter, for those of the cubature rule the cubature Kalman
filter, and everything after it is the plain Kalman filter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.gaussian import symmetric

Rule = Literal["ukf", "ckf"]

SINGULAR = 1e-13  # share of its variance that a component has to itself, which counts as none


class Line(NamedTuple):
    """The straight line that fits a function over a Gaussian.

    Attributes
    ----------
    y : (..., m)
        The function's mean over the Gaussian.
    H : (..., m, n)
        The line's slope.
    rest : (..., m, m)
        Covariance of what the line misses, positive semi-definite.
    """

    y: Array
    H: Array
    rest: Array


def points(rule: Rule, n: int) -> tuple[Array, Array]:
    """Return unit sigma points (k, n) and their weights (k,).

    ``"ukf"``: Julier, Uhlmann & Durrant-Whyte (2000) with kappa = 3 - n, which has a Gaussian's
    fourth moments along each axis. ``"ckf"``: Arasaratnam & Haykin (2009), third-degree
    spherical-radial cubature, no point in the middle.

    Parameters
    ----------
    rule : "ukf" or "ckf"
        Which.
    n : int
        Number of components.
    """
    total = 3.0 if rule == "ukf" else float(n)
    spread = np.sqrt(total) * np.concatenate([np.eye(n), -np.eye(n)])
    weight = np.full(2 * n, 0.5 / total)
    if rule == "ckf":
        return spread, weight
    return np.concatenate([np.zeros((1, n)), spread]), np.append(1.0 - n / total, weight)


def fit(
    function: Callable[[Array], Array],
    x: Array,
    P: Array,
    rule: Rule,
    difference: Callable[[Array, Array], Array] = np.subtract,
) -> Line:
    """Fit a line to `function` over N(x, P) at the rule's sigma points.

    Parameters
    ----------
    function : callable
        Takes states (..., k, n), returns values (..., k, m).
    x, P : (..., n), (..., n, n)
        The Gaussian; P may be singular.
    rule : "ukf" or "ckf"
        Which sigma points.
    difference : callable
        Difference of two values, for values that wrap.
    """
    unit, weight = points(rule, x.shape[-1])
    root, inverse = roots(P)
    spread = unit @ np.swapaxes(root, -1, -2)
    middle = function(x[..., None, :])
    away = difference(function(x[..., None, :] + spread), middle)
    mean = np.einsum("k,...km->...m", weight, away)
    away = away - mean[..., None, :]
    slope = np.einsum("k,...km,kn->...mn", weight, away, unit)  # in units of the Gaussian's root
    H = slope @ inverse
    left = away - unit @ np.swapaxes(slope, -1, -2)
    return Line(middle[..., 0, :] + mean, H, _definite(left, weight))


def roots(P: Array) -> tuple[Array, Array]:
    """Return lower triangular L and W (..., n, n): L L' = P, and W its inverse where P is regular.

    Cholesky's factor in units of the standard deviations; a component that the ones before it
    determine has a column of zeros in L and a row of zeros in W.

    Parameters
    ----------
    P : (..., n, n)
        Symmetric and positive semi-definite.
    """
    n = P.shape[-1]
    variance = np.einsum("...ii->...i", P)
    sd = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    rest = P / (sd[..., :, None] * sd[..., None, :])
    L, regular = np.zeros(P.shape), np.zeros(variance.shape, dtype=bool)
    for k in range(n):
        pivot = rest[..., k, k]
        regular[..., k] = pivot > SINGULAR
        root = np.sqrt(np.where(regular[..., k], pivot, 1.0))[..., None]
        column = np.where(regular[..., k, None], rest[..., :, k] / root, 0.0)
        column[..., :k] = 0.0
        L[..., :, k] = column
        rest = rest - column[..., :, None] * column[..., None, :]
    W = np.linalg.inv(L + np.where(regular, 0.0, 1.0)[..., None] * np.eye(n))
    W = np.where(regular[..., None], W, 0.0) / sd[..., None, :]
    return sd[..., None] * L, W


def _definite(left: Array, weight: Array) -> Array:
    """Covariance of the residuals (..., k, m), which a negative weight may not make negative."""
    C = symmetric(np.einsum("k,...ki,...kj->...ij", weight, left, left))
    if np.all(weight >= 0.0):
        return C
    w, V = np.linalg.eigh(C)
    result: Array = symmetric((V * np.maximum(w, 0.0)[..., None, :]) @ np.swapaxes(V, -1, -2))
    return result
