"""What errors to expect of a filter, without drawing a single random number (ALGORITHMS §5.3)."""

from __future__ import annotations

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, MeasurementModel, MotionModel
from imm_tdoa.reproduce.motion_form.faithful import jacobian
from imm_tdoa.reproduce.motion_form.switches import Columns

NODES = 401  # of the quadrature along the long axis of an error ellipse
SHORT_NODES = 101
REACH = 7.0  # standard deviations


def mean_length(mean: Array, covariance: Array) -> Array:
    """Return E|e| (...) of a planar Gaussian error e with any mean.

    By quadrature along the axes of the ellipse; for a mean of zero it is
    sqrt(2/pi) s1 E(1 - s2²/s1²), s1 >= s2 the standard deviations along them, E the complete
    elliptic integral (§3.6).

    Parameters
    ----------
    mean : (..., 2)
        Mean error (bias).
    covariance : (..., 2, 2)
        Covariance of the error about it.
    """
    variance, axes = np.linalg.eigh(covariance)
    std = np.sqrt(np.maximum(variance, 0.0))
    along = np.einsum("...ji,...j->...i", axes, mean)

    def nodes(count: int) -> tuple[Array, Array]:
        u = np.linspace(-REACH, REACH, count)
        weight = np.exp(-0.5 * u**2)
        return u, weight / weight.sum()

    (u, wu), (v, wv) = nodes(SHORT_NODES), nodes(NODES)
    short = along[..., 0, None] + std[..., 0, None] * u
    long = along[..., 1, None] + std[..., 1, None] * v
    length = np.hypot(short[..., :, None], long[..., None, :])
    result: Array = np.einsum("...ij,i,j->...", length, wu, wv)
    return result


def error_covariance(
    measurement: MeasurementModel,
    model: MotionModel,
    times: Array,
    truth: Array,
    *,
    noise: Array,
    spread: Array,
    prior: Array,
    columns: Columns = "zeros",
) -> Array:
    """Return the covariance (..., T, 2, 2) of a filter's position error about its mean, m².

    The extended Kalman filter linearised along the truth. Its gains follow from what it believes:
    `prior`, its own R and Jacobian. Its error follows from what is the case: `spread`, `noise`,
    the right Jacobian. Where both agree this is the posterior Cramér-Rao bound of the motion.

    Parameters
    ----------
    measurement, model, columns
        The filter's, as in `faithful.extended_kalman`.
    times : (T,)
        Epochs, s.
    truth : (..., T, 6)
        True position, velocity and acceleration, m, m/s, m/s².
    noise : (m, m)
        True covariance of the measured range differences, m².
    spread : (..., n, n)
        True covariance of the first state's error.
    prior : (..., n, n)
        Covariance that the filter believes its first state to have.
    """
    n = prior.shape[-1]
    C, P = spread, prior
    covariances = [C[..., :2, :2]]
    for k in range(1, len(times)):
        dt, time = float(times[k] - times[k - 1]), float(times[k])
        x = truth[..., k, :n]
        F = model.jacobian(x, dt)
        C = gaussian.predict_covariance(C, F, np.zeros((n, n)))
        P = gaussian.predict_covariance(P, F, model.process_noise(dt, 2))
        H = jacobian(measurement, x, dt, time, columns)
        R = measurement.noise_covariance(x[..., :2], np.zeros_like(x[..., :2]), time)
        S = gaussian.symmetric(H @ P @ np.swapaxes(H, -1, -2) + R)
        K = np.swapaxes(np.linalg.solve(S, H @ P), -1, -2)
        P = _joseph(P, K, H, R)
        C = _joseph(C, K, jacobian(measurement, x, dt, time, "zeros"), noise)
        covariances.append(C[..., :2, :2])
    return np.stack(covariances, axis=-3)


def _joseph(P: Array, K: Array, H: Array, R: Array) -> Array:
    left = np.eye(P.shape[-1]) - K @ H
    return gaussian.symmetric(left @ P @ np.swapaxes(left, -1, -2) + K @ R @ np.swapaxes(K, -1, -2))
