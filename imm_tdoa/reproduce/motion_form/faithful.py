"""Source A's own estimators, so plain that they can be made as wrong as they were printed.

The library's filters refuse a wrong Jacobian or sign; these take them, batched over targets and
runs. With everything right they are the library's, which a test holds them to.
"""

from __future__ import annotations

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, MeasurementModel, MotionModel
from imm_tdoa.reproduce.motion_form.switches import Columns


def jacobian(
    measurement: MeasurementModel, x: Array, dt: float, time: float, columns: Columns
) -> Array:
    """Return d measurement / d state (..., m, n) of states [p; v; a] in the plane.

    ``"dt-scaled"``: the paper's (29), whose velocity and acceleration columns are the position's
    times dt and dt²/2. That is the Jacobian with respect to the state one step earlier, so that
    the propagation is counted twice (§5.2-9). Right are zeros.
    """
    p = x[..., :2]
    H, _ = measurement.jacobian(p, np.zeros_like(p), time)
    scales = (1.0, dt, 0.5 * dt**2) if columns == "dt-scaled" else (1.0, 0.0, 0.0)
    return np.concatenate([scale * H for scale in scales[: x.shape[-1] // 2]], axis=-1)


def extended_kalman(
    measurement: MeasurementModel,
    model: MotionModel,
    times: Array,
    values: Array,
    mean: Array,
    covariance: Array,
    *,
    columns: Columns = "zeros",
    sign: float = 1.0,
) -> Array:
    """Return positions (..., T, 2) by the extended Kalman filter of the paper's §2.

    Parameters
    ----------
    measurement : MeasurementModel
        Time differences, slave minus master.
    model : MotionModel
        Static, constant velocity or constant acceleration; its noise may be zero (26).
    times : (T,)
        Epochs, s; the first is that of `mean`.
    values : (..., T, m)
        Measured differences, s; those of the first epoch are not used.
    mean, covariance : (..., n), (..., n, n)
        State at the first epoch, m, m/s, m/s².
    columns : "zeros" or "dt-scaled"
        The Jacobian, see `jacobian`.
    sign : float
        Factor on the innovation: -1 where data and prediction are master minus slave while the
        Jacobian is slave minus master (§5.2-1).
    """
    z = values * measurement.scale
    x, P = np.broadcast_to(mean, (*z.shape[:-2], mean.shape[-1])), covariance
    positions = [x[..., :2]]
    for k in range(1, len(times)):
        dt, time = float(times[k] - times[k - 1]), float(times[k])
        F = model.jacobian(x, dt)
        x = model.propagate(x, dt)
        P = gaussian.predict_covariance(P, F, model.process_noise(dt, 2))
        p, v = x[..., :2], np.zeros_like(x[..., :2])
        nu = sign * (z[..., k, :] - measurement.predict(p, v, time))
        H = jacobian(measurement, x, dt, time, columns)
        R = measurement.noise_covariance(p, v, time)
        x, P, *_ = gaussian.update(x, P, nu, H, R, np.ones(nu.shape, dtype=bool))
        positions.append(x[..., :2])
    return np.stack(positions, axis=-2)


def iterates(
    measurement: MeasurementModel,
    values: Array,
    first: Array,
    count: int,
    *,
    sign: float = 1.0,
) -> Array:
    """Return the positions (..., count + 1, 2) that the paper's iteration (5), (9) goes through.

    Weighted by the noise covariance, which the paper's best linear unbiased estimate lacks.

    Parameters
    ----------
    measurement : MeasurementModel
        Time differences, slave minus master.
    values : (..., m)
        One epoch's differences, s.
    first : (..., 2)
        First guess, m.
    count : int
        Steps to take, converged or not.
    sign : float
        As in `extended_kalman`: with -1 every step goes the right length the wrong way, and the
        error doubles.
    """
    z = values * measurement.scale
    p = np.broadcast_to(first, (*z.shape[:-1], 2))
    positions = [p]
    for _ in range(count):
        v = np.zeros_like(p)
        H, _ = measurement.jacobian(p, v, 0.0)
        nu = sign * (z - measurement.predict(p, v, 0.0))
        L = gaussian.factor(measurement.noise_covariance(p, v, 0.0), "noise covariance")
        J, w = np.linalg.solve(L, H), np.linalg.solve(L, nu[..., None])
        normal = np.swapaxes(J, -1, -2) @ J
        p = p + np.linalg.solve(normal, np.swapaxes(J, -1, -2) @ w)[..., 0]
        positions.append(p)
    return np.stack(positions, axis=-2)
