"""Against filterpy 2.0: equal where it is right, and each known fault shown beside our answer.

filterpy's conventions: `M` is used as ``mu @ M``, so its rows sum to one, as ours do (its
docstring says the transpose). The constructor mixes once with the initial probabilities, so each
scan is ``predict()`` then ``update(z)``. `x` is given as a 1-D vector. Its likelihoods are in the
linear domain; the cases compared stay far above their floor.
"""

from __future__ import annotations

import sys

import attrs
import filterpy.kalman as fp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import Mode, exact
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.contract import LinearMotion, component_names
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Position


@attrs.frozen(eq=False)
class AnyLinear(LinearMotion):
    """x' = F x + w, w ~ N(0, Q), whatever the time step."""

    F: np.ndarray
    Q: np.ndarray
    order: int

    def components(self, dims):
        return component_names(dims, self.order)

    def transition(self, dt, dims):
        return np.broadcast_to(self.F, (*np.shape(dt), *self.F.shape))

    def process_noise(self, dt, dims):
        return np.broadcast_to(self.Q, (*np.shape(dt), *self.Q.shape))


def spd(rng, n, scale):
    A = rng.normal(size=(n, n))
    return scale * (A @ A.T / n + 0.1 * np.eye(n))


def filterpy_imm(models, dims, dt, x, P, R, mu, Pi):
    n = len(x)
    filters = []
    for model in models:
        kf = fp.KalmanFilter(dim_x=n, dim_z=dims)
        kf.x, kf.P = x.copy(), P.copy()
        kf.F = np.array(model.jacobian(np.zeros(n), dt))
        kf.Q = np.array(model.process_noise(dt, dims))
        kf.H, kf.R = np.eye(dims, n), R.copy()
        filters.append(kf)
    return fp.IMMEstimator(filters, np.array(mu), np.array(Pi))


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    r=st.integers(2, 4),
    dims=st.integers(1, 3),
    order=st.sampled_from([1, 2]),
    dt=st.floats(0.05, 5.0),
    wild=st.booleans(),
)
def test_equal_banks_agree_at_every_step(seed, r, dims, order, dt, wild):
    rng = np.random.default_rng(seed)
    n = dims * (order + 1)
    if wild:
        models = [
            AnyLinear(
                np.eye(n) + 0.2 * rng.normal(size=(n, n)),
                spd(rng, n, 10.0 ** rng.uniform(-2, 1)),
                order,
            )
            for _ in range(r)
        ]
    else:
        kind = {1: ConstantVelocity, 2: ConstantAcceleration}[order]
        models = [
            kind(**{("psd", "std")[k % 2]: float(10.0 ** rng.uniform(-2, 1))}) for k in range(r)
        ]
    Pi = rng.dirichlet(np.ones(r), size=r)
    mu = rng.dirichlet(np.ones(r))
    sigma = rng.uniform(0.5, 2.0, dims)
    x, P = rng.normal(size=n), spd(rng, n, 5.0)
    ours = IMM(Bank(models, transition=Pi, prior=mu), Position(sigma, dims=dims))
    theirs = filterpy_imm(models, dims, dt, x, P, np.diag(sigma**2), mu, Pi)
    state, t = ours.start(0.0, x, P), 0.0
    for _ in range(8):
        z = state.mean[:dims] + rng.normal(size=dims)
        t += dt
        theirs.predict()
        theirs.update(z)
        state = ours.step(state, t, z)
        scale = np.sqrt(np.diag(theirs.P))
        assert_allclose(state.mean, theirs.x, rtol=1e-9, atol=1e-9 * scale.max())
        assert np.max(np.abs(state.covariance - theirs.P) / np.outer(scale, scale)) < 1e-9
        assert_allclose(state.mode_probability, theirs.mu, rtol=1e-9, atol=1e-12)


# --- the faults of filterpy 2.0, and what is right ----------------------------------------------

PI = np.array([[0.95, 0.05], [0.1, 0.9]])
SLOW, FAST = ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)
X0, P0 = np.zeros(2), np.diag([10.0, 1.0])


def pair(Pi=PI, mu=(0.8, 0.2)):
    ours = IMM(Bank([SLOW, FAST], transition=Pi, prior=mu), Position(1.0, dims=1))
    theirs = filterpy_imm([SLOW, FAST], 1, 1.0, X0, P0, np.eye(1), mu, Pi)
    return ours, ours.start(0.0, X0, P0), theirs


def test_missed_measurement_scores_the_last_one_again():
    ours, state, theirs = pair()
    theirs.predict()
    theirs.update(np.array([4.0]))
    before = theirs.mu.copy()
    # an innovation of zero is scored with the last innovation covariance, miss after miss
    last = np.array([1.0 / np.sqrt(2 * np.pi * kf.S[0, 0]) for kf in theirs.filters])
    reused = right = before
    state = ours.step(state, 1.0, [4.0])
    log_likelihood = state.log_likelihood
    assert_allclose(state.mode_probability, before, rtol=1e-12)
    for k in range(20):
        theirs.predict()
        theirs.update(None)
        reused = (reused @ PI) * last
        reused, right = reused / reused.sum(), right @ PI
        assert_allclose(theirs.mu, reused, rtol=1e-9)
        state = ours.step(state, 2.0 + k, [np.nan])
        assert_allclose(state.mode_probability, right, rtol=1e-13)
    assert state.log_likelihood == log_likelihood
    assert abs(reused[0] - right[0]) > 0.03


def test_second_update_at_one_instant_applies_the_chain_again():
    ours, state, theirs = pair()
    theirs.predict()
    theirs.update(np.array([1.0]))
    first = theirs.mu.copy()
    predicted = [(kf.x.copy(), kf.P.copy()) for kf in theirs.filters]
    theirs.update(np.array([1.5]))
    likelihood = np.array(
        [
            np.exp(-0.5 * ((1.5 - x[0]) ** 2 / (P[0, 0] + 1) + np.log(2 * np.pi * (P[0, 0] + 1))))
            for x, P in predicted
        ]
    )
    stepped, right = (first @ PI) * likelihood, first * likelihood
    assert_allclose(theirs.mu, stepped / stepped.sum(), rtol=1e-9)

    state = ours.step(ours.step(state, 1.0, [1.0]), 1.0, [1.5])
    assert_allclose(state.mode_probability, right / right.sum(), rtol=1e-12)
    assert abs(theirs.mu[0] - state.mode_probability[0]) > 0.01


def test_two_rows_at_one_instant_are_one_scan_of_two_rows():
    """What the second update should have been: the joint update of both sensors."""
    bank = Bank([SLOW, FAST], transition=PI, prior=[0.8, 0.2])
    stations = Stations([[0.0], [100.0], [-50.0]])
    tdoa = TDOA(stations, tdoa_sigma=1.0, pairs=[[0, 1], [0, 2]], speed=1.0)
    imm = IMM(bank, tdoa)
    start = imm.start(0.0, X0 + np.array([10.0, 0.0]), P0)
    together = imm.step(start, 1.0, [-79.0, -31.0])
    apart = imm.step(imm.step(start, 1.0, [-79.0, np.nan]), 1.0, [np.nan, -31.0])
    assert_allclose(apart.mode_probability, together.mode_probability, rtol=1e-12)
    assert_allclose(apart.mean, together.mean, rtol=1e-12)
    assert_allclose(apart.covariance, together.covariance, rtol=1e-12)
    assert_allclose(apart.log_likelihood, together.log_likelihood, rtol=1e-12)


def test_one_outlier_resets_the_mode_probabilities():
    ours, state, theirs = pair()
    outlier = np.array([1e3])
    theirs.predict()
    theirs.update(outlier)
    assert_array_equal([kf.likelihood for kf in theirs.filters], [sys.float_info.min] * 2)
    assert_allclose(theirs.mu, np.array([0.8, 0.2]) @ PI, rtol=1e-12)

    state = ours.step(state, 1.0, outlier)
    log_l = []
    for model in (SLOW, FAST):
        F, Q = model.transition(1.0, 1), model.process_noise(1.0, 1)
        S = (F @ P0 @ F.T + Q)[0, 0] + 1.0
        log_l.append(-0.5 * (1e6 / S + np.log(2 * np.pi * S)))
    odds = np.log([0.8, 0.2] @ PI) + log_l
    assert min(log_l) < -4e4
    assert_allclose(np.diff(state.log_mode_probability), np.diff(odds), rtol=1e-12)
    assert state.mode_probability[1] == 1.0
    assert_allclose(state.log_likelihood, odds[1], rtol=1e-12)


def test_extended_filters_cannot_be_members():
    members = []
    for _ in range(2):
        ekf = fp.ExtendedKalmanFilter(dim_x=2, dim_z=1)
        ekf.x = np.zeros(2)
        members.append(ekf)
    theirs = fp.IMMEstimator(members, [0.5, 0.5], PI)
    with pytest.raises(TypeError):
        theirs.update(np.array([1.0]))

    stations = Stations([[0.0, 0.0], [1e3, 0.0], [0.0, 1e3]])
    imm = IMM(Bank([SLOW, FAST], transition=PI), TDOA(stations, toa_sigma=1e-8))
    state = imm.step(imm.start(0.0, [300.0, 400.0], 1e4 * np.eye(2)), 1.0, [1e-7, -2e-7])
    assert np.all(np.isfinite(state.mean))


def test_the_documented_matrix_is_the_transpose_of_the_used_one():
    assert "probability of\n        switching from filter j to filter i" in fp.IMMEstimator.__doc__
    assert "M[i,j]" in fp.IMMEstimator.__doc__
    skew = np.array([[0.99, 0.01], [0.4, 0.6]])
    ours, state, theirs = pair(Pi=skew)
    theirs.predict()
    theirs.update(np.array([0.7]))

    def mode(model):
        return Mode(
            ("x", "vx"),
            lambda dt: model.transition(dt, 1),
            lambda dt: model.process_noise(dt, 1),
        )

    (mu,), (evidence,) = exact(
        [mode(SLOW), mode(FAST)], [0.8, 0.2], skew, X0, P0, [0.7], np.array([[1.0, 0.0]]), np.eye(1)
    )
    state = ours.step(state, 1.0, [0.7])
    assert_allclose(state.mode_probability, mu, rtol=1e-12)
    assert_allclose(state.log_likelihood, evidence, rtol=1e-12)
    assert_allclose(theirs.mu, mu, rtol=1e-12)  # so its rows sum to one, whatever it says
    as_documented = skew @ np.array([0.8, 0.2])  # what the docstring's M[i, j] would predict
    assert abs(as_documented[0] / as_documented.sum() - ([0.8, 0.2] @ skew)[0]) > 0.1
