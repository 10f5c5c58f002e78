"""Filters, banks and models that filterpy and we cannot share: refused, and in which words."""

from __future__ import annotations

import filterpy.kalman as fp
import numpy as np
import pytest
from interop_cases import BANKS, CA_NAMES, CV_NAMES, kalman

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.contract import Measurement
from imm_tdoa.interop import from_filterpy, to_filterpy
from imm_tdoa.models import TDOA, TOA, ConstantVelocity, CoordinatedTurn, Position


def changed(**attributes):
    kf = kalman()
    for name, value in attributes.items():
        setattr(kf, name, value)
    return kf


class Drifting(fp.KalmanFilter):
    """Predicts in its own way."""

    def predict(self, u=None, B=None, F=None, Q=None):
        self.x = self.x + 1.0


R = kalman().R
OTHER_H = kalman().H * [[1.0], [2.0]]
ON_ACCELERATION = np.kron(np.eye(2), [[1.0, 0.0, 0.1]])


@pytest.mark.parametrize(
    ("filters", "match"),
    [
        ([], "filters: expected a list of KalmanFilter, got"),
        (kalman(), "filters: expected a list of KalmanFilter"),
        ([kalman(), None], r"filters: filters\[1\] is no filterpy KalmanFilter"),
        ([fp.ExtendedKalmanFilter(4, 2)], r"filters: filters\[0\] is no filterpy KalmanFilter"),
        ([Drifting(4, 2)], r"filters: filters\[0\] is no filterpy KalmanFilter"),
        ([changed(B=np.ones((4, 1)))], r"filters\[0\] has a control matrix B"),
        ([kalman(), changed(alpha=1.02)], r"filters\[1\] has a fading memory, alpha = 1.02"),
        ([changed(M=np.ones((4, 2)))], r"filters\[0\] has process noise correlated"),
        ([kalman(), changed(R=2 * R)], r"filters\[1\].R: differs from that of filters\[0\]"),
        ([kalman(), changed(H=OTHER_H)], r"filters\[1\].H: differs from that of filters\[0\]"),
        ([changed(R=5.0)], r"filters\[0\].R: expected shape \(2, 2\)"),
        ([changed(Q=0.1)], r"filters\[0\].Q: expected shape \(4, 4\)"),
        ([changed(F=lambda dt: dt)], r"filters\[0\].F: expected numbers"),
        ([changed(P=-np.eye(4))], r"filters\[0\].P: a variance on its diagonal is negative"),
        ([changed(R=np.ones((2, 2)))], "R: expected a positive definite matrix"),
        ([changed(x=np.zeros(6))], r"filters\[0\].x: expected shape"),
        ([kalman(order=2)], r"filters\[0\].F: expected shape \(4, 4\), got \(6, 6\)"),
        (fp.IMMEstimator([kalman(), kalman()], [0.5, 0.5], 0.5 * np.ones((2, 2))), "imm.filters"),
    ],
)
def test_what_is_no_plain_kalman_filter(filters, match):
    with pytest.raises(ValueError, match=match):
        from_filterpy(filters, components=CV_NAMES, dt=0.5)


def test_a_measured_acceleration_is_refused():
    kf = kalman(order=2)
    kf.H = ON_ACCELERATION
    with pytest.raises(ValueError, match=r"filters\[0\].H: acts on 'ax'; a measurement here sees"):
        from_filterpy([kf], components=CA_NAMES, dt=0.5)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"components": "x"}, "components: expected names"),
        ({"components": ("x", "vx", "y", "x")}, "components: expected different names"),
        ({"components": ("px", "vx", "py", "vy")}, "components: names: expected the position"),
        ({"components": ("x", "vx", "z", "vz")}, "components: names: expected the position"),
        ({"components": [CV_NAMES]}, "components: expected names for each of 2 filters, got 1"),
        ({"components": [CV_NAMES, ("x", "vx", "ax", "j")]}, "the same space dimensions"),
        ({"components": ("x", "vx", "y", "ay")}, "expected all of"),
        ({"dt": -1.0}, "dt: expected a number above 0"),
        ({"transition": [[0.9, 0.3], [0.1, 0.7]]}, "transition: .* is it transposed"),
        ({"mode_probability": [0.4, 0.4]}, "prior: expected"),
    ],
)
def test_refused_options(options, match):
    given = {"components": CV_NAMES, "dt": 0.5, **options}
    with pytest.raises(ValueError, match=match):
        from_filterpy([kalman(), kalman(2.0)], **given)


class Offset(Measurement):
    """Position from an origin elsewhere."""

    dims, size = 2, 2

    def predict(self, position, velocity, time):
        return position + 5.0

    def jacobian(self, position, velocity, time):
        H = np.broadcast_to(np.eye(2), (*position.shape[:-1], 2, 2))
        return H, 0.0 * H

    def noise_covariance(self, position, velocity, time):
        return np.eye(2)


class Blurred(Offset):
    """Noise that grows with the distance."""

    def predict(self, position, velocity, time):
        return position

    def noise_covariance(self, position, velocity, time):
        return (1.0 + position[..., :1, None] ** 2) * np.eye(2)


STATIONS = Stations([[0.0, 0.0], [1e3, 0.0], [0.0, 1e3]])


@pytest.mark.parametrize(
    ("bank", "measurement", "dt", "match"),
    [
        ("two-cv", TDOA(STATIONS, toa_sigma=1e-8), 1.0, "of TDOA the rows are not"),
        ("two-cv", TOA(STATIONS, sigma=1e-8), 1.0, "of TOA rows share an unknown offset"),
        ("two-cv", Offset(), 1.0, "of Offset the rows are not: they have a constant part"),
        ("two-cv", Blurred(), 1.0, "of Blurred the noise depends on where the emitter is"),
        ("two-cv", Position, 1.0, "measurement: no measurement model"),
        ("two-cv", Position(1.0), 0.0, "dt: expected a number above 0"),
        (None, Position(1.0), 1.0, "bank: expected a Bank, got None"),
    ],
)
def test_what_filterpy_cannot_take(bank, measurement, dt, match):
    with pytest.raises(ValueError, match=match):
        to_filterpy(BANKS.get(bank), measurement, dt)


def test_models_and_states_filterpy_cannot_take():
    turn = Bank([ConstantVelocity(psd=1.0), CoordinatedTurn(psd=1.0)])
    with pytest.raises(ValueError, match="bank: mode 'coordinated-turn' is not linear"):
        to_filterpy(turn, Position(1.0), 1.0)
    bank, measurement = BANKS["two-cv"], Position(1.0)
    other = IMM(turn, measurement).start(0.0, np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match="state: expected a state of this bank's modes"):
        to_filterpy(bank, measurement, 1.0, other)
    batch = IMM(bank, measurement).start(0.0, np.zeros((3, 2)), np.eye(2))
    with pytest.raises(
        ValueError, match=r"state: expected one target, got a batch of shape \(3,\)"
    ):
        to_filterpy(bank, measurement, 1.0, batch)
