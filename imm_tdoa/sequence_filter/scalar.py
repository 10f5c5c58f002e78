"""The scalar Kalman filter of one time-difference sequence (Source B; ALGORITHMS §6.1, §6.3).

Random walk plus white noise: state x, its variance P, process noise Q per epoch, measurement
noise R. Pure functions on arrays of any shape, in metres and metres squared. A sequence that has
not begun has NaN for its state; a missing measurement is NaN.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array


class Update(NamedTuple):
    """State and variance after a measurement, the gain, and how far the measurement was off.

    Where nothing was measured the state is the prediction and the gain 0; where a sequence
    begins, the state is the measurement, its variance R and the gain 1. `spread` is the standard
    deviation that the innovation `nu` should have.
    """

    x: Array
    P: Array
    K: Array
    nu: Array
    spread: Array


def update(x: Array, P: Array, z: Array, R: Array) -> Update:
    """Take measurements z of variance R into predictions x of variance P."""
    begun, measured = np.isfinite(x), np.isfinite(z)
    both, first = begun & measured, ~begun & measured
    S = P + R
    K = np.where(both, P / np.where(both, S, 1.0), np.where(first, 1.0, 0.0))
    nu = np.where(both, z - x, 0.0)
    new = np.where(first, z, np.where(begun, x, np.nan) + np.where(both, K * nu, 0.0))
    variance = np.where(first, R, np.where(both, (1.0 - K) * P, P))
    return Update(new, variance, K, nu, np.sqrt(np.where(both, S, np.inf)))


def steady_gain(q: float | Array) -> Array:
    """Return the gain that the filter settles at (§6.3).

    K = (sqrt(q² + 4q) - q) / 2, from P = P - K P + Q.

    Parameters
    ----------
    q : float or (...)
        Ratio Q/R of process noise to measurement noise, above 0.
    """
    q = np.asarray(q, dtype=float)
    result: Array = 0.5 * (np.sqrt(q * q + 4.0 * q) - q)
    return result


def steady_lag(rate: float | Array, gain: float | Array) -> Array:
    """Return how far the state trails a ramp: rate (1 - K) / K (§6.3).

    Parameters
    ----------
    rate : float or (...)
        Slope of the ramp per epoch, in the unit of the state.
    gain : float or (...)
        Steady gain K.
    """
    K = np.asarray(gain, dtype=float)
    result: Array = np.asarray(rate, dtype=float) * (1.0 - K) / K
    return result
