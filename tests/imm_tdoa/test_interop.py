"""Bank to filterpy and back: the same numbers, and refusals of what would not be the same."""

from __future__ import annotations

import subprocess
import sys

import attrs
import filterpy.kalman as fp
import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations, interop
from imm_tdoa.contract import LinearMotion, Measurement
from imm_tdoa.interop import FixedStep, LinearMeasurement, from_filterpy, to_filterpy
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Singer,
    Static,
)
from imm_tdoa.testing import check_measurement_model, check_motion_model

CV_NAMES = ("x", "vx", "y", "vy")
CA_NAMES = ("x", "vx", "ax", "y", "vy", "ay")


def spd(rng, n, scale=1.0):
    A = rng.normal(size=(n, n))
    return scale * (A @ A.T / n + 0.1 * np.eye(n))


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


def indices(names, wanted):
    return [names.index(c) for c in wanted]


# --- from filterpy -------------------------------------------------------------------------------


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), column=st.booleans())
def test_parallel_filters_step_by_step(seed, column):
    """The identity chain: each filter alone, and its log-likelihood, to 1e-10."""
    rng = np.random.default_rng(seed)
    dt = 0.5
    filters = [kalman(0.1, 0, column=column), kalman(0.2, 1, column=column), kalman(2.0, 2)]
    names = [("x", "y"), CV_NAMES, CA_NAMES]
    mu = rng.dirichlet(np.ones(3))
    bank, measurement, state = from_filterpy(
        filters, components=names, dt=dt, transition=np.eye(3), mode_probability=mu, time=7.0
    )
    assert bank.names == ("FixedStep-1", "FixedStep-2", "FixedStep-3")
    assert state.time == 7.0
    imm = IMM(bank, measurement)
    total = np.log(mu)
    for k in range(12):
        z = np.array([100.0, 200.0]) + rng.normal(0.0, 10.0, 2)
        missed = k in (4, 5)
        for i, kf in enumerate(filters):
            kf.predict()
            kf.update(None if missed else z)
            total[i] += 0.0 if missed else kf.log_likelihood
        state = imm.step(state, 7.0 + (k + 1) * dt, np.full(2, np.nan) if missed else z)
        for j, kf in enumerate(filters):
            order = indices(names[j], state.space.modes[j])
            x, P = np.ravel(kf.x)[order], kf.P[np.ix_(order, order)]
            assert_allclose(state.means[j], x, rtol=1e-10, atol=1e-10)
            assert_allclose(state.covariances[j], P, rtol=1e-9, atol=1e-10)
    log_L = np.logaddexp.reduce(total)
    assert_allclose(state.log_likelihood, log_L, rtol=1e-10)
    assert_allclose(state.log_mode_probability, total - log_L, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("column", [False, True])
def test_mixing_is_that_of_their_estimator(column):
    rng = np.random.default_rng(1)
    M, mu = np.array([[0.95, 0.05], [0.2, 0.8]]), np.array([0.7, 0.3])
    filters = [kalman(0.01, column=column), kalman(5.0, column=column)]
    theirs = fp.IMMEstimator(filters, mu, M)
    bank, measurement, state = from_filterpy(
        theirs.filters,
        components=CV_NAMES,
        dt=0.5,
        transition=theirs.M,
        mode_probability=theirs.mu,
        names=("calm", "lively"),
    )
    assert state.modes == ("calm", "lively")
    order = indices(CV_NAMES, ("x", "y", "vx", "vy"))
    imm = IMM(bank, measurement)
    for k in range(30):
        z = np.array([100.0, 200.0]) + rng.normal(0.0, 5.0, 2)
        theirs.predict()
        theirs.update(z[:, None] if column else z)
        state = imm.step(state, 0.5 * (k + 1), z)
        assert_allclose(state.mean, np.ravel(theirs.x)[order], rtol=1e-9)
        assert_allclose(state.covariance, theirs.P[np.ix_(order, order)], rtol=1e-8, atol=1e-9)
        assert_allclose(state.mode_probability, theirs.mu, rtol=1e-9)


def test_filters_of_unequal_dimension_mix_here():
    bank, measurement, state = from_filterpy(
        [kalman(0.1, 1), kalman(1.0, 2)],
        components=[CV_NAMES, CA_NAMES],
        dt=0.5,
        transition=[[0.9, 0.1], [0.1, 0.9]],
        birth_std={"acceleration": 3.0},
    )
    assert state.components == ("x", "y", "vx", "vy", "ax", "ay")
    t = 0.5 * np.arange(1, 60)
    path = np.stack([100.0 + 3.0 * t + 2.0 * t**2, 200.0 - 2.0 * t], axis=-1)
    track = IMM(bank, measurement).run(t, path, start=state)
    assert track.mode_probability[-1, 1] > 0.5
    assert np.linalg.norm(track.position[-1] - path[-1]) < 1.0
    with pytest.raises(ValueError, match="All filters must have the same state dimension"):
        fp.IMMEstimator([kalman(0.1, 1), kalman(1.0, 2)], [0.5, 0.5], 0.5 * np.ones((2, 2)))


def test_velocity_may_be_measured_and_other_components_may_be_there():
    kf = fp.KalmanFilter(dim_x=3, dim_z=2)
    kf.F = np.array([[1, 0.0, 2.0], [0, 0.9, 0], [0, 0, 1]])
    kf.H = np.array([[1, 0, 0], [0, 0, 1.0]])
    kf.x = np.array([1.0, 2.0, 3.0])
    bank, measurement, state = from_filterpy([kf], components=("x", "drift", "vx"), dt=2.0)
    assert state.components == ("x", "vx", "drift")
    assert_array_equal(state.means[0], [1.0, 3.0, 2.0])
    assert_array_equal(measurement.H, np.eye(2))
    kf.predict()
    kf.update(np.array([8.0, 2.5]))
    state = IMM(bank, measurement).step(state, 2.0, [8.0, 2.5])
    assert_allclose(state.means[0], kf.x[[0, 2, 1]], rtol=1e-12)
    assert_allclose(state.covariances[0], kf.P[np.ix_([0, 2, 1], [0, 2, 1])], rtol=1e-12)
    assert_allclose(state.log_likelihood, kf.log_likelihood, rtol=1e-12)


# --- to filterpy ---------------------------------------------------------------------------------

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


@pytest.mark.parametrize("name", BANKS)
@pytest.mark.parametrize("dims", [1, 2, 3])
def test_there_and_back_again_is_exact(name, dims):
    bank, rng = BANKS[name], np.random.default_rng(dims)
    n = len(bank.space(dims).components)
    measurement = Position(rng.uniform(1.0, 3.0, dims), dims=dims)
    state = IMM(bank, measurement).start(5.0, rng.normal(size=n), spd(rng, n))
    filters, mu, M = to_filterpy(bank, measurement, 0.7, state)
    for j, kf in enumerate(filters):
        assert kf.x.shape == (len(bank.space(dims).modes[j]), 1)
    again, rows, restored = from_filterpy(
        filters,
        components=bank.space(dims).modes,
        dt=0.7,
        transition=M,
        mode_probability=mu,
        time=5.0,
    )
    for j, (old, new) in enumerate(zip(bank.models, again.models, strict=True)):
        assert_array_equal(old.transition(0.7, dims), new.transition(0.7, dims))
        assert_array_equal(old.process_noise(0.7, dims), new.process_noise(0.7, dims))
        assert_array_equal(state.means[j], restored.means[j])
        assert_array_equal(state.covariances[j], restored.covariances[j])
    assert_array_equal(again.chain(0.7), bank.chain(0.7))
    assert_allclose(restored.mode_probability, state.mode_probability, rtol=1e-15)
    assert restored.space.modes == state.space.modes
    z = rng.normal(size=(6, dims))
    t = 5.0 + 0.7 * np.arange(1, 7)
    one = IMM(bank, measurement).run(t, z, start=state)
    two = IMM(again, rows).run(t, z, start=restored)
    assert_allclose(two.mean, one.mean, rtol=1e-12, atol=1e-13)
    assert_allclose(two.covariance, one.covariance, rtol=1e-12, atol=1e-13)
    assert_allclose(two.log_likelihood, one.log_likelihood, rtol=1e-12)
    twice = to_filterpy(again, rows, 0.7, restored)
    for a, b in zip(filters, twice.filters, strict=True):
        for field in ("F", "Q", "H", "R", "x", "P"):
            assert_array_equal(getattr(a, field), getattr(b, field))


def test_without_a_state_filterpy_s_own_defaults_stay():
    filters, mu, M = to_filterpy(BANKS["two-cv"], Position(2.0), 1.0)
    assert_array_equal(mu, [0.5, 0.5])
    assert_array_equal(M, [[0.9, 0.1], [0.3, 0.7]])
    assert_array_equal(filters[0].x, np.zeros((4, 1)))
    assert_array_equal(filters[0].P, np.eye(4))
    assert_array_equal(filters[1].H, np.eye(2, 4))
    filters[0].F[0, 0] = 5.0  # theirs, not ours
    assert BANKS["two-cv"].models[0].transition(1.0, 2)[0, 0] == 1.0


def test_the_matrix_is_used_by_rows():
    """An asymmetric chain through their estimator is ours, so rows sum to one there too."""
    bank, measurement = BANKS["two-cv"], Position(2.0)
    state = IMM(bank, measurement).start(0.0, np.zeros(4), 9.0 * np.eye(4))
    theirs = fp.IMMEstimator(*to_filterpy(bank, measurement, 1.0, state))
    for k in range(5):
        z = np.array([1.0, -2.0]) * k
        theirs.predict()
        theirs.update(z[:, None])
        state = IMM(bank, measurement).step(state, k + 1.0, z)
        assert_allclose(theirs.mu, state.mode_probability, rtol=1e-9)
        assert_allclose(theirs.x[:, 0], state.mean, rtol=1e-9, atol=1e-12)


def test_units_are_those_of_the_values():
    class Kilometres(Position):
        @property
        def scale(self):
            return np.full(2, 1e3)

    filters, _, _ = to_filterpy(BANKS["two-cv"], Kilometres(50.0), 1.0)
    assert_allclose(filters[0].H, 1e-3 * np.eye(2, 4))
    assert_allclose(filters[0].R, 0.05**2 * np.eye(2))


# --- the models that come of it ------------------------------------------------------------------


@attrs.frozen(eq=False)
class AnyStep(LinearMotion):
    """A `FixedStep` that takes every step for its own, so that the laws can be tried on it."""

    model: FixedStep
    composes: bool = False

    def components(self, dims):
        return self.model.components(dims)

    def _step(self, dt):
        dt = np.asarray(dt, dtype=float)
        return np.where(dt > 0.0, self.model.dt, dt)

    def transition(self, dt, dims):
        return self.model.transition(self._step(dt), dims)

    def process_noise(self, dt, dims):
        return self.model.process_noise(self._step(dt), dims)

    def propagate(self, x, dt):
        return self.model.propagate(x, self._step(dt))

    def jacobian(self, x, dt):
        return self.model.jacobian(x, self._step(dt))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_fixed_step_obeys_the_laws_that_compare_no_steps(order):
    names = [("x", "y"), CV_NAMES, CA_NAMES][order]
    bank, _, _ = from_filterpy([kalman(1.0, order)], components=names, dt=0.5)
    check_motion_model(
        AnyStep(bank.models[0]), examples=15, without=["semigroup", "noise composes", "kinematics"]
    )


def test_a_linear_measurement_obeys_the_laws():
    measurement = LinearMeasurement([[1, 0, 0.5, 0], [0, 1, 0, 0], [0, 0, 1, 1]], np.eye(3) + 0.2)
    check_measurement_model(
        measurement,
        examples=15,
        without=["translation", "rotation", "units"],
        bad_arguments=[
            lambda: LinearMeasurement(np.eye(3), np.eye(3)),
            lambda: LinearMeasurement(np.eye(2), np.eye(3)),
            lambda: LinearMeasurement(np.eye(2), np.ones((2, 2))),
            lambda: LinearMeasurement(np.eye(2), np.zeros((2, 2))),
            lambda: LinearMeasurement(np.zeros((0, 2)), np.zeros((0, 0))),
            lambda: LinearMeasurement(np.eye(2), np.eye(2), dims=4),
        ],
    )


def test_a_fixed_step_refuses_other_steps():
    model = FixedStep(np.array([[1, 0.1], [0, 1]]), np.eye(2), ("x", "vx"), 0.1)
    stamps = 1.7e9 + 0.1 * np.arange(4)
    assert_array_equal(model.transition(np.diff(stamps), 1), np.tile(model.F, (3, 1, 1)))
    assert_array_equal(model.process_noise(0.0, 1), np.zeros((2, 2)))
    assert_array_equal(model.transition([0.0, 0.1], 1), [np.eye(2), model.F])
    for step in (0.2, 0.05, 0.1002):
        with pytest.raises(ValueError, match=r"dt: F and Q of this model hold for steps of 0.1 s"):
            model.transition(step, 1)
    imm = IMM(Bank([model]), Position(1.0, dims=1))
    with pytest.raises(ValueError, match=r"steps of 0.1 s \(or 0\), got 0.25 s"):
        imm.run([0.0, 0.1, 0.35], np.zeros((3, 1)), start=imm.start(0.0, [0.0], [[1.0]]))
    with pytest.raises(ValueError, match="dims: this model has 1 space dimensions, got 2"):
        model.components(2)
    with pytest.raises(ValueError, match="dims: expected 1, 2 or 3"):
        model.process_noise(0.1, 4)
    with pytest.raises(ValueError, match="x: expected 2 components"):
        model.propagate(np.zeros(3), 0.1)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"F": np.eye(3)}, "F: expected shape"),
        ({"Q": -np.eye(2)}, "Q: a variance on its diagonal is negative"),
        ({"names": ("x", "x")}, "names: expected different names"),
        ({"names": "xy"}, "names: expected component names"),
        ({"names": ("y", "vy")}, r"names: expected the position among them \(x; x and y"),
        ({"dt": 0.0}, "dt: expected a number above 0"),
    ],
)
def test_no_fixed_step(change, match):
    given = {"F": np.eye(2), "Q": np.eye(2), "names": ("x", "vx"), "dt": 1.0}
    with pytest.raises(ValueError, match=match):
        FixedStep(**{**given, **change})


# --- refusals ------------------------------------------------------------------------------------


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


def test_filterpy_loads_when_used():
    code = (
        "import sys, imm_tdoa\n"
        "assert 'filterpy' not in sys.modules\n"
        "imm_tdoa.interop.from_filterpy\n"
        "assert 'filterpy' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert interop.__all__ == sorted(interop.__all__)
