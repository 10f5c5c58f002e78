"""How well candidates fit predictions: normalised innovations, densities, gates."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from imm_tdoa import _validate, gaussian
from imm_tdoa.contract import Array, Index, Mask


class Fit(NamedTuple):
    """Candidates against Gaussians: `nu` and `present` (..., L, q), the rest (..., L).

    Missing rows have innovation 0; `nis`, `log_det` and the number of `rows` are as if they had
    been cut out.
    """

    nu: Array
    present: Mask
    nis: Array
    log_det: Array
    rows: Index

    @property
    def log_density(self) -> Array:
        """Log of the Gaussian density of each candidate's rows."""
        result: Array = -0.5 * (self.nis + self.log_det + self.rows * gaussian.LOG_2PI)
        return result


def innovations(z: Array, mean: Array, angular: Mask) -> Array:
    """Innovations (..., L, q) of candidates `z` (L, q) from means (..., q); NaN stays NaN."""
    nu = z - mean[..., None, :]
    result: Array = np.where(angular, gaussian.wrap(nu), nu)
    return result


def fit(nu: Array, S: Array, known: Mask) -> Fit:
    """Judge innovations `nu` (..., L, q) by covariances `S` (..., q, q).

    Rows that are NaN in `nu`, or not `known` (..., q), do not count.
    """
    present = np.isfinite(nu) & known[..., None, :]
    nu = np.where(present, nu, 0.0)
    count = np.count_nonzero(present, axis=-1)
    if nu.shape[-1] == 1:
        variance = np.where(present[..., 0], S[..., 0], 1.0)
        return Fit(nu, present, nu[..., 0] ** 2 / variance, np.log(variance), count)
    both = present[..., :, None] & present[..., None, :]
    L = gaussian.factor(np.where(both, S[..., None, :, :], np.eye(nu.shape[-1])))
    white = np.linalg.solve(L, nu[..., None])[..., 0]
    log_det = 2.0 * np.sum(np.log(np.einsum("...ii->...i", L)), axis=-1)
    return Fit(nu, present, np.sum(white**2, axis=-1), log_det, count)


def threshold(probability: float, count: Index) -> Array:
    """Largest normalised innovation squared that passes the gate, for `count` rows each.

    The quantile of the chi-square distribution with `count` degrees of freedom; -1, which
    nothing passes, for no rows at all.
    """
    dof = np.arange(int(np.max(count, initial=0)) + 1)
    table = np.where(dof > 0, chdtri(np.maximum(dof, 1).astype(float), 1.0 - probability), -1.0)
    result: Array = table[count]
    return result


def gate_probability(value: Any) -> float:
    """Return `value` as a probability above 0 and below 1, or raise."""
    number = _validate.positive("gate_probability", value)
    if not number < 1.0:
        raise ValueError(
            f"gate_probability: expected a probability above 0 and below 1, got {value!r}"
        )
    return number
