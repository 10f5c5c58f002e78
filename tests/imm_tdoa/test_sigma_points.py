"""Sigma points: moments, lines through bending functions, and the filters made of them."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imm_tdoa import IMM, Bank, Stations, sigma_points
from imm_tdoa.models import (
    TDOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Static,
)
from imm_tdoa.prediction import predict

RULES = ("ukf", "ckf")
seeds = st.integers(0, 2**32 - 1)
STATIONS = Stations([[0.0, 0.0], [9e3, 1e3], [2e3, 8e3], [-7e3, -5e3]])


def spd(rng, n):
    A = rng.normal(size=(n, n + 2))
    return A @ A.T


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("n", range(1, 8))
def test_the_points_have_the_moments_of_a_unit_gaussian(rule, n):
    points, weight = sigma_points.points(rule, n)
    assert_allclose(weight.sum(), 1.0, rtol=1e-13)
    assert_allclose(weight @ points, 0.0, atol=1e-13)
    assert_allclose(np.einsum("k,ki,kj->ij", weight, points, points), np.eye(n), atol=1e-13)
    if rule == "ukf":  # along each axis even the fourth moment, 3
        assert_allclose(np.einsum("k,ki->i", weight, points**4), 3.0, rtol=1e-13)


@settings(deadline=None, max_examples=40)
@given(seed=seeds, rule=st.sampled_from(RULES), rank=st.integers(0, 4))
def test_a_line_is_fitted_exactly_and_singular_covariances_are_no_trouble(seed, rule, rank):
    rng = np.random.default_rng(seed)
    H, c, x = rng.normal(size=(3, 4)), rng.normal(size=3), rng.normal(size=4)
    scale = 10.0 ** rng.uniform(-6, 6, 4)
    A = rng.normal(size=(4, rank)) * scale[:, None]
    P = A @ A.T
    H = H / scale
    line = sigma_points.fit(lambda s: s @ H.T + c, x, P, rule)
    size = np.abs(H @ x).max() + np.abs(c).max() + np.sqrt(np.abs(H @ P @ H.T).max())
    assert_allclose(line.y, H @ x + c, atol=1e-9 * size)
    assert_allclose(line.H @ P, H @ P, atol=1e-6 * np.abs(H).max() * max(np.abs(P).max(), 1e-300))
    assert_allclose(line.rest, 0.0, atol=1e-12 * size**2)
    root, inverse = sigma_points.roots(P)
    assert_allclose(root @ root.T, P, atol=1e-9 * max(np.abs(P).max(), 1e-300))
    assert_allclose(root @ inverse @ root, root, atol=1e-6 * max(np.abs(root).max(), 1e-300))


@pytest.mark.parametrize("rule", RULES)
def test_a_parabola_has_its_mean_and_is_no_line(rule):
    """E[x²] = m² + P, slope 2 m; what the line misses has the variance 2 P² (ukf)."""
    m, P = 1.5, 4.0
    line = sigma_points.fit(lambda s: s**2, np.array([m]), np.array([[P]]), rule)
    assert_allclose(line.y, m**2 + P)
    assert_allclose(line.H, 2 * m)
    assert_allclose(line.rest, 2 * P**2 if rule == "ukf" else 0.0, atol=1e-12)


def test_what_the_line_misses_is_never_negative():
    """With n > 3 the middle point's weight is negative."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        A, P = rng.normal(size=(3, 6, 6)), spd(rng, 6)
        line = sigma_points.fit(
            lambda s, A=A: np.einsum("...a,iab,...b->...i", s, A, s), rng.normal(size=6), P, "ukf"
        )
        assert np.linalg.eigvalsh(line.rest).min() >= -1e-9 * np.abs(line.rest).max()


@pytest.mark.parametrize("rule", RULES)
def test_a_turn_is_predicted_as_by_many_samples(rule):
    """Mean and covariance of an uncertain turn, against 400 000 draws."""
    model = CoordinatedTurn(psd=0.0, turn_rate_psd=0.0)
    x, dt = np.array([0.0, 0.0, 10.0, 0.0, 0.2]), 2.0
    P = np.diag([1.0, 1.0, 0.25, 0.25, 0.01])
    rng = np.random.default_rng(1)
    draws = model.propagate(rng.multivariate_normal(x, P, size=400_000), dt)
    got = predict(model, x, P, np.asarray(dt), 2, rule)
    plain = predict(model, x, P, np.asarray(dt), 2)
    C = np.cov(draws.T)
    sd = np.sqrt(np.diag(C))
    off, plain_off = (np.max(np.abs(p.x - draws.mean(axis=0)) / sd) for p in (got, plain))
    wide, plain_wide = (np.max(np.abs(np.diag(p.P) / np.diag(C) - 1.0)) for p in (got, plain))
    assert off < 0.02  # three standard errors of the draws: 0.005
    assert off < 0.2 * plain_off
    assert wide < (0.5 if rule == "ukf" else 1.5) * plain_wide


@pytest.mark.parametrize("rule", RULES)
def test_linear_models_and_measurements_leave_the_kalman_filter(rule):
    bank = Bank([ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)], mean_sojourn=20.0)
    values = np.cumsum(np.random.default_rng(0).normal(size=(20, 2)), axis=0)
    times = np.arange(1.0, 21.0)
    tracks = []
    for update in ("ekf", rule):
        imm = IMM(bank, Position(sigma=1.0, dims=2), update=update)
        tracks.append(imm.run(times, values, start=imm.start(0.0, [0.0, 0.0], np.eye(2))))
    assert_allclose(tracks[1].mean, tracks[0].mean, rtol=1e-8, atol=1e-9)
    assert_allclose(tracks[1].covariance, tracks[0].covariance, rtol=1e-7, atol=1e-9)
    assert_allclose(tracks[1].log_likelihood, tracks[0].log_likelihood, rtol=1e-9)


def test_one_mode_is_filterpys_unscented_filter():
    """Three differences and a drifting place: filterpy 2.0 with Julier's points, kappa = 3 - n.

    In two dimensions every weight is positive and nothing needs to be kept from going negative.
    """
    tdoa, model = TDOA(STATIONS, toa_sigma=30e-9), Drifting()
    rng = np.random.default_rng(2)
    x, P = np.array([1e3, 2e3]), np.diag([2e4, 1e4])
    imm = IMM(Bank([model]), tdoa, update="ukf")
    ukf = UnscentedKalmanFilter(
        dim_x=2,
        dim_z=3,
        dt=2.0,
        hx=lambda s: tdoa.predict(s, 0.0 * s, 0.0),
        fx=model.propagate,
        points=JulierSigmaPoints(2, kappa=1.0),
    )
    ukf.x, ukf.P = x.copy(), P.copy()
    ukf.Q = model.process_noise(2.0, 2)
    ukf.R = tdoa.noise_covariance(x, x, 0.0)
    state = imm.start(0.0, x, P)
    for k in range(6):
        z = tdoa.predict(x + 30.0 * k, x, 0.0) + 9.0 * rng.normal(size=3)
        state = imm.step(state, 2.0 * (k + 1), z / 299_792_458.0)
        ukf.predict()
        # filterpy keeps the propagated points; the textbook draws them anew from the prediction
        ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
        ukf.update(z)
        assert_allclose(state.mean, ukf.x, rtol=1e-9)
        assert_allclose(state.covariance, ukf.P, rtol=1e-6)


class Drifting:
    """A place that drifts, the faster the farther out; not linear."""

    def components(self, dims):
        return ("x", "y")[:dims]

    def propagate(self, x, dt):
        return x + np.asarray(dt)[..., None] * 5.0 * np.sin(x / 300.0)

    def jacobian(self, x, dt):
        bend = np.asarray(dt)[..., None] * 5.0 / 300.0 * np.cos(x / 300.0)
        return np.eye(2) + bend[..., None] * np.eye(2)

    def process_noise(self, dt, dims):
        return 4.0 * np.asarray(dt)[..., None, None] * np.eye(2)


@pytest.mark.parametrize("update", ["iekf", "ukf"])
def test_these_updates_are_not_misled_by_a_diffuse_start_as_the_extended_one_is(update):
    """Near the stations with kilometres of uncertainty: far more consistent than the EKF."""
    rng = np.random.default_rng(3)
    runs = 200
    P = np.diag([1.5e3, 1.5e3]) ** 2
    truth = np.array([2e3, 2e3]) + 1.5e3 * rng.normal(size=(runs, 2))
    tdoa = TDOA(STATIONS, toa_sigma=30e-9)
    z = tdoa.predict(truth, 0 * truth, 0.0) + rng.multivariate_normal(
        np.zeros(3), tdoa.noise_covariance(truth[0], truth[0], 0.0), size=runs
    )

    def consistency(how):
        imm = IMM(Bank([Static(psd=0.0)]), tdoa, update=how)
        state = imm.start(0.0, np.broadcast_to([2e3, 2e3], (runs, 2)), P)
        for _ in range(2):
            state = imm.step(state, state.time, z / 299_792_458.0)
        error = state.mean - truth
        solved = np.linalg.solve(state.covariance, error[..., None])[..., 0]
        return np.mean(np.sum(error * solved, axis=-1))

    assert consistency(update) < 0.2 * consistency("ekf")


@settings(deadline=None, max_examples=20)
@given(seed=seeds, update=st.sampled_from(RULES))
def test_a_batch_is_its_targets_with_times_and_pairs_of_their_own(seed, update):
    rng = np.random.default_rng(seed)
    bank = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)])
    imm = IMM(bank, TDOA(STATIONS, toa_sigma=1e-7), update=update)
    pairs = np.array([[[1, 0], [2, 3]], [[3, 1], [2, 0]]])
    p = np.array([[1e3, 2e3], [4e3, -1e3]])
    starts = imm.start(np.array([0.0, 1.0]), p, np.broadcast_to(1e4 * np.eye(2), (2, 2, 2)))
    time, z = np.array([3.0, 2.5]), 1e-6 * rng.normal(size=(2, 2))
    both = imm.step(starts, time, z, pairs=pairs)
    for b in range(2):
        one = imm.start(float(starts.time[b]), p[b], 1e4 * np.eye(2))
        one = imm.step(one, time[b], z[b], pairs=pairs[b])
        assert_allclose(both.mean[b], one.mean, rtol=1e-9, atol=1e-9)
        assert_allclose(both.covariance[b], one.covariance, rtol=1e-8, atol=1e-8)
