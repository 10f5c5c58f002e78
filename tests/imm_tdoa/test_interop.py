"""Bank to filterpy and back: the same numbers."""

from __future__ import annotations

import subprocess
import sys

import filterpy.kalman as fp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interop_cases import BANKS, CA_NAMES, CV_NAMES, kalman
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, interop
from imm_tdoa.interop import from_filterpy, to_filterpy
from imm_tdoa.models import Position


def spd(rng, n, scale=1.0):
    A = rng.normal(size=(n, n))
    return scale * (A @ A.T / n + 0.1 * np.eye(n))


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


def test_filterpy_loads_when_used():
    code = (
        "import sys, imm_tdoa\n"
        "assert 'filterpy' not in sys.modules\n"
        "imm_tdoa.interop.from_filterpy\n"
        "assert 'filterpy' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert interop.__all__ == sorted(interop.__all__)
