"""Receivers whose errors stay: consistent where the noise treatment is not; exact if linear."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.constant_receivers import ConstantReceivers
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    RangeRate,
    Stack,
    Static,
)

PLACES = np.array([(0, 0), (4000, 300), (-1500, 3500), (-2500, -2800), (2000, -3000)], float)
SIGMA, OFF, STEP, SPREAD = 3.0, 10.0, 2.0, 15.0
MOTION = ConstantVelocity(psd=0.5)
BANK = Bank([MOTION], birth_std={"velocity": SPREAD})


def declared(**more):
    return Stations(PLACES, position_covariance=np.tile(OFF**2 * np.eye(2), (5, 1, 1)), **more)


@pytest.fixture(scope="module")
def drawn():
    """200 emitters over 40 scans, each seen by receivers 10 m off in a way of their own."""
    rng, N, T = np.random.default_rng(1), 200, 40
    F, Q = MOTION.transition(STEP, 2), MOTION.process_noise(STEP, 2)
    x = np.zeros((N, T, 4))
    x[:, 0] = np.concatenate(
        [rng.uniform(-1500, 1500, (N, 2)), SPREAD * rng.normal(size=(N, 2))], 1
    )
    for k in range(1, T):
        x[:, k] = x[:, k - 1] @ F.T + rng.multivariate_normal(np.zeros(4), Q, N)
    places = PLACES - OFF * rng.normal(size=(N, 5, 2))
    r = np.linalg.norm(x[:, :, None, :2] - places[:, None], axis=-1)
    r = r + SIGMA * rng.normal(size=r.shape)
    return STEP * np.arange(T), x, places, r


def nees(track, x):
    index = [track.space.components.index(c) for c in ("x", "y", "vx", "vy")]
    e, P = track.mean[..., index] - x, track.covariance[..., index, :][..., index]
    return np.einsum("nti,nti->nt", e, np.linalg.solve(P, e[..., None])[..., 0])


def rmse(track, x):
    return np.sqrt(np.mean(np.sum((track.position - x[..., :2]) ** 2, axis=-1), axis=0))


def test_it_is_consistent_and_better_than_taking_the_errors_for_noise(drawn):
    """Mean of 200 NEES of 4 degrees of freedom: 4 ± 0.2; the other grows far beyond it."""
    times, x, places, r = drawn
    z = r[..., 1:] - r[..., :1]
    measurement = TDOA(declared(), toa_sigma=SIGMA, speed=1.0)
    filter_ = ConstantReceivers(BANK, measurement)
    track = filter_.run(times, z)
    ours = nees(track, x).mean(axis=0)
    assert np.all(np.abs(ours - 4.0) < 5.0 * np.sqrt(8.0 / 200))
    assert_allclose(ours.mean(), 4.0, atol=0.5)
    assert_allclose(np.nanmean(track.nis), 4.0, atol=4.0 * np.sqrt(8.0 / (200 * 39)))
    white = IMM(BANK, measurement).run(times, z)
    assert np.all(nees(white, x).mean(axis=0)[5:] > 6.0)
    assert np.all(rmse(track, x)[20:] < 0.95 * rmse(white, x)[20:])
    where, covariance = filter_.receivers(track)
    error = where[:, -1] - places
    assert where.shape == (200, 40, 5, 2)
    assert covariance.shape == (200, 40, 5, 2, 2)
    claimed = np.einsum("nsii->nsi", covariance[:, -1]).mean()
    assert_allclose(np.mean(error**2), claimed, rtol=0.12)
    assert claimed < 0.75 * OFF**2


def test_arrival_times_give_the_same_as_their_differences(drawn):
    times, _, _, r = drawn
    few = r[:3]
    a = ConstantReceivers(BANK, TDOA(declared(), toa_sigma=SIGMA, speed=1.0))
    b = ConstantReceivers(BANK, TOA(declared(), sigma=SIGMA, speed=1.0))
    one = a.run(times, few[..., 1:] - few[..., :1])
    two = b.run(times, few)
    assert_allclose(one.mean, two.mean, rtol=1e-6, atol=1e-5)
    assert_allclose(one.covariance, two.covariance, rtol=1e-5, atol=1e-4)


def test_the_iterated_update_agrees_where_little_bends(drawn):
    times, _, _, r = drawn
    z = r[:3, :, 1:] - r[:3, :, :1]
    measurement = TDOA(declared(), toa_sigma=SIGMA, speed=1.0)
    plain = ConstantReceivers(BANK, measurement).run(times, z)
    track = ConstantReceivers(BANK, measurement, update="iekf").run(times, z)
    sigma = np.sqrt(np.einsum("ntii->nti", plain.covariance))
    assert np.max(np.abs(track.mean - plain.mean) / sigma) < 0.2


def test_the_start_is_the_posterior_of_emitter_and_receivers(drawn):
    """Against dense Bayes: flat in position, prior on the receivers, one linear solve."""
    _, x, _, r = drawn
    z = r[0, 0, 1:] - r[0, 0, :1]
    measurement = TDOA(declared(), toa_sigma=SIGMA, speed=1.0)
    state = ConstantReceivers(Bank([Static(psd=0.0)]), measurement).start(0.0, z)
    p = state.means[0][:2]
    u = (p - PLACES) / np.linalg.norm(p - PLACES, axis=1)[:, None]
    J = np.zeros((4, 12))
    J[:, :2] = u[1:] - u[0]
    for i in range(4):
        J[i, 2:4], J[i, 4 + 2 * i : 6 + 2 * i] = u[0], -u[i + 1]
    R = SIGMA**2 * (np.eye(4) + 1.0)
    prior = np.diag([0.0] * 2 + [OFF**-2.0] * 10)
    dense = np.linalg.inv(J.T @ np.linalg.solve(R, J) + prior)
    assert_allclose(state.covariances[0], dense, rtol=1e-5, atol=1e-6 * dense.max())
    gradient = J.T @ np.linalg.solve(R, z - predicted(p) - J[:, 2:] @ state.means[0][2:])
    assert_allclose(gradient, prior @ state.means[0], atol=1e-5)
    assert np.linalg.norm(p - x[0, 0, :2]) < 100.0


def predicted(p):
    r = np.linalg.norm(p - PLACES, axis=1)
    return r[1:] - r[0]


@pytest.mark.parametrize("update", ["ekf", "ukf"])
def test_a_bank_of_unequal_modes_range_rates_and_lost_stations(drawn, update):
    """Static, constant velocity, turn; velocity errors too; rows missing. It stays consistent."""
    times, x, places, r = drawn
    rng = np.random.default_rng(2)
    stations = declared(velocity_covariance=np.tile(0.01 * np.eye(2), (5, 1, 1)))
    away = x[:20, :, None, :2] - places[:20, None]
    u = away / np.linalg.norm(away, axis=-1, keepdims=True)
    drift = 0.1 * rng.normal(size=(20, 1, 5, 2))
    rates = np.sum(u * (x[:20, :, None, 2:] + drift), axis=-1) + 0.05 * rng.normal(size=(20, 40, 5))
    values = np.concatenate([r[:20], rates], axis=-1)
    values[:, 3:20, 1] = np.nan
    values[:, 7] = np.nan
    measurement = Stack(TOA(stations, sigma=SIGMA, speed=1.0), RangeRate(stations, sigma=0.05))
    bank = Bank(
        [Static(psd=0.0), MOTION, CoordinatedTurn(psd=0.5, turn_rate_psd=1e-6)],
        birth_std={"velocity": SPREAD},
    )
    filter_ = ConstantReceivers(bank, measurement, update=update)
    track = filter_.run(times, values)
    assert track.modes == ("static", "constant-velocity", "coordinated-turn")
    assert track.mode_probability[:, -1, 1:].sum(axis=-1).min() > 0.95
    index = [track.space.components.index(c) for c in ("x", "y", "vx", "vy")]
    e = track.mean[..., index] - x[:20]
    P = track.covariance[..., index, :][..., index]
    last = np.einsum("ni,ni->n", e[:, -1], np.linalg.solve(P[:, -1], e[:, -1, :, None])[..., 0])
    assert 2.0 < last.mean() < 8.0
    assert filter_.receivers(track)[0].shape == (20, 40, 5, 2)


def test_smoothing_knows_the_receivers_too(drawn):
    times, x, _, r = drawn
    filter_ = ConstantReceivers(BANK, TDOA(declared(), toa_sigma=SIGMA, speed=1.0))
    track = filter_.run(times, r[:50, :, 1:] - r[:50, :, :1])
    smooth = track.smooth()
    assert np.mean(rmse(smooth, x[:50])) < np.mean(rmse(track, x[:50]))
    where, _ = filter_.receivers(smooth)
    assert_allclose(where[:, 0], where[:, -1], atol=1e-6)  # constants: known alike at all times


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="made by one set of stations"):
        ConstantReceivers(BANK, Position(sigma=1.0, dims=2))
    with pytest.raises(ValueError, match="declare a position_covariance"):
        ConstantReceivers(BANK, TDOA(Stations(PLACES), toa_sigma=1e-9))
    two = Stack(TDOA(declared(), toa_sigma=1e-9), FDOA(declared(), range_rate_sigma=1.0))
    with pytest.raises(ValueError, match="made by one set of stations"):
        ConstantReceivers(BANK, two)
    filter_ = ConstantReceivers(BANK, TDOA(declared(), toa_sigma=SIGMA, speed=1.0))
    with pytest.raises(ValueError, match="first scan determines no position"):
        filter_.run([0.0, 1.0], [[1.0, np.nan, np.nan, np.nan], [1.0, 2.0, 3.0, 4.0]])
    with pytest.raises(ValueError, match="values: expected shape"):
        filter_.start(0.0, [1.0, 2.0])
