"""Filters as filterpy's books set them up, and banks, that the tests of `interop` share."""

from __future__ import annotations

import filterpy.kalman as fp
import numpy as np
from filterpy.common import Q_discrete_white_noise

from imm_tdoa import Bank
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Singer, Static

CV_NAMES = ("x", "vx", "y", "vy")
CA_NAMES = ("x", "vx", "ax", "y", "vy", "ay")


def kalman(var=1.0, order=1, dt=0.5, column=True):
    """A filter as filterpy's books set one up: axis by axis, position, velocity, acceleration."""
    n = order + 1
    kf = fp.KalmanFilter(dim_x=2 * n, dim_z=2)
    f = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])[:n, :n]
    kf.F = np.kron(np.eye(2), f)
    q = Q_discrete_white_noise(dim=n, dt=dt, var=var) if n > 1 else var * np.eye(1)
    kf.Q = np.kron(np.eye(2), q)
    kf.H = np.kron(np.eye(2), np.eye(1, n))
    kf.R = np.array([[4.0, 1.0], [1.0, 9.0]])
    x = np.array([100.0, 3.0, 0.1][:n] + [200.0, -2.0, 0.2][:n])
    kf.x = x[:, None] if column else x
    kf.P = np.kron(
        np.diag([50.0, 30.0]), np.array([[2, 0.5, 0.1], [0.5, 1, 0.2], [0.1, 0.2, 1]])[:n, :n]
    )
    return kf


BANKS = {
    "static-cv-ca": Bank(
        [Static(psd=1.0), ConstantVelocity(psd=0.3), ConstantAcceleration(std=0.2)],
        mean_sojourn=[30.0, 20.0, 10.0],
        prior=[0.5, 0.3, 0.2],
    ),
    "singer": Bank([Singer(std=2.0)]),
    "two-cv": Bank(
        [ConstantVelocity(psd=0.1), ConstantVelocity(std=3.0)], transition=[[0.9, 0.1], [0.3, 0.7]]
    ),
}
