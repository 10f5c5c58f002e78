"""Gross errors in tracks: what the robust filters make of them, and how lost tracks are found."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from robust_cases import P0, SIGMA, SPREAD, STATIONS, C, against, arrivals, seeds, spd
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from imm_tdoa import IMM, Bank, Stations, robust
from imm_tdoa.models import TDOA, TOA, ConstantVelocity, Position, Static


@pytest.mark.parametrize("rule", ["gate", "student-t"])
@pytest.mark.parametrize("corrupted", range(5))
def test_no_reference_is_special_to_a_robust_filter(rule, corrupted):
    """Differences to any station, or arrivals themselves: one gross arrival, one result."""
    z = arrivals(**{f"s{corrupted}": 3e-6})
    bank = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)])
    states = []
    for reference in (0, 3):
        others = [s for s in range(5) if s != reference]
        pairs = np.array([[s, reference] for s in others])
        tdoa = TDOA(STATIONS, toa_sigma=SIGMA, pairs=pairs)
        imm = IMM(bank, tdoa, robust=rule)
        start = imm.start(0.0, P0 + 3.0, 25.0 * np.eye(2))
        states.append(imm.step(start, 1.0, z[others] - z[reference]))
    imm = IMM(bank, TOA(STATIONS, sigma=SIGMA), robust=rule)
    states.append(imm.step(imm.start(0.0, P0 + 3.0, 25.0 * np.eye(2)), 1.0, z + 1.23))
    for other in states[1:]:
        assert_allclose(other.mean[:2], states[0].mean[:2], atol=1e-3)
        assert_allclose(other.covariance[:2, :2], states[0].covariance[:2, :2], rtol=1e-3)
        assert_allclose(other.log_likelihood, states[0].log_likelihood, atol=1e-2)
    assert np.linalg.norm(states[0].mean[:2] - P0) < 8.0


@pytest.mark.parametrize("rule", ["gate", "student-t"])
def test_the_robust_filters_agree_with_the_plain_one_on_good_data(rule):
    more = {"gate_probability": 1.0 - 1e-12} if rule == "gate" else {"degrees_of_freedom": 1e9}
    bank, tdoa = Bank([Static(psd=1.0)]), TDOA(STATIONS, toa_sigma=SIGMA)
    z = (arrivals() + SIGMA * np.random.default_rng(0).normal(size=5))[1:] - arrivals()[0]
    imm, plain = IMM(bank, tdoa, robust=rule, **more), IMM(bank, tdoa)
    a = imm.step(imm.start(0.0, P0, np.eye(2)), 1.0, z)
    b = plain.step(plain.start(0.0, P0, np.eye(2)), 1.0, z)
    assert_allclose(a.mean, b.mean, rtol=1e-9)
    assert_allclose(a.covariance, b.covariance, rtol=1e-6)
    assert_allclose(a.log_likelihood, b.log_likelihood, atol=1e-6)


@pytest.mark.parametrize("z", [0.0, 1.0, 4.0, 30.0])
@pytest.mark.parametrize("dof", [2.0, 5.0, 30.0])
def test_the_log_likelihood_of_student_t_is_a_tight_lower_bound(z, dof):
    """Against the integral over the state of prior times Student's t."""
    P, R = 4.0, 1.0
    imm = IMM(
        Bank([Static(psd=0.0)]),
        Position(sigma=1.0, dims=1),
        robust="student-t",
        degrees_of_freedom=dof,
    )
    state = imm.step(imm.start(0.0, [0.0], [[P]]), 0.0, [z])
    exact, _ = quad(
        lambda x: norm.pdf(x, scale=np.sqrt(P)) * student.pdf(z - x, dof, scale=np.sqrt(R)),
        -60.0,
        60.0,
        points=[0.0, z],
        limit=200,
    )
    gap = np.log(exact) - float(state.log_likelihood)
    assert -1e-6 < gap < 0.35


@settings(deadline=None, max_examples=40)
@given(seed=seeds, rule=st.sampled_from(["gate", "student-t"]))
def test_distrusted_data_never_shrink_a_covariance_more_than_good_data(seed, rule):
    rng = np.random.default_rng(seed)
    imm = IMM(Bank([Static(psd=0.0)]), TDOA(STATIONS, toa_sigma=SIGMA), robust=rule)
    plain = IMM(imm.bank, imm.measurement)
    start = imm.start(0.0, P0, spd(rng, 2))
    z = (arrivals()[1:] - arrivals()[0]) * (1.0 + rng.normal(size=4))
    robust_P, plain_P = imm.step(start, 0.0, z).covariance, plain.step(start, 0.0, z).covariance
    top = np.linalg.eigvalsh(start.covariance).max()
    assert np.linalg.eigvalsh(start.covariance - robust_P).min() > -1e-9 * top
    assert np.linalg.eigvalsh(robust_P - plain_P).min() > -1e-3 * top


@pytest.mark.parametrize("rule", ["gate", "student-t"])
def test_a_row_of_nothing_but_outliers_leaves_the_gate_with_what_it_had(rule):
    imm = IMM(Bank([Static(psd=0.0)]), Position(sigma=1.0, dims=2), robust=rule)
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    state = imm.step(start, 0.0, [1e4, -1e4])
    assert state.trust.rejected == 1
    assert not state.trust.lost
    if rule == "gate":
        assert_array_equal(state.covariance, start.covariance)
        assert_array_equal(state.taken.row_weight, 0.0)
    else:
        assert_allclose(state.mean, 0.0, atol=1e-2)
        assert np.all(state.taken.row_weight < 1e-6)


@pytest.mark.parametrize("rule", ["gate", "student-t"])
def test_a_track_that_rejects_too_long_is_lost_and_opens_again(rule):
    """The emitter jumps; the track says that it is lost, widens, and finds it."""
    bank = Bank([Static(psd=0.01)], birth_std={"velocity": 50.0})
    imm = IMM(bank, Position(sigma=1.0, dims=2), robust=rule, reopen_after=4)
    times = np.arange(30.0)
    place = np.where(times[:, None] < 10.0, [0.0, 0.0], [400.0, 300.0])
    values = place + np.random.default_rng(1).normal(size=(30, 2))
    start = imm.start(-1.0, [0.0, 0.0], np.eye(2))
    track = imm.run(times, values, start=start)
    assert not track.lost[:13].any()
    assert track.lost[13]
    assert track.reopened[14]
    assert not track.reopened[:14].any()
    error = np.linalg.norm(track.position - place, axis=-1)
    assert np.all(error[20:] < 4.0)
    assert not track.lost[-5:].any()
    stubborn = attrs.evolve(imm, reopen_after=1000).run(times, values, start=start)
    assert np.linalg.norm(stubborn.position[-1] - place[-1]) > 100.0
    assert not stubborn.lost.any()


@pytest.mark.parametrize("wrong", [0, 2.5, -1])
def test_a_wrong_number_of_scans_is_refused(wrong):
    with pytest.raises(ValueError, match="reopen_after: expected a number of scans"):
        IMM(Bank([Static(psd=0.0)]), Position(sigma=1.0, dims=2), reopen_after=wrong)


@pytest.mark.parametrize("update", ["ekf", "iekf"])
@pytest.mark.parametrize("rule", ["gate", "student-t"])
@pytest.mark.parametrize("size", [100.0, 3333.0])
def test_a_lost_track_finds_the_emitter_again(size, rule, update):
    """30 scans of nothing but outliers, then 25 good ones: every run is back within 5 sigma."""
    rng = np.random.default_rng(6)
    runs, steps, sigma = 40, 60, 30e-9
    stations = Stations([[0.0, 0.0], [5e3, 500.0], [2e3, 5e3], [-4e3, 3e3], [-1e3, -4e3]])
    tdoa = TDOA(stations, toa_sigma=sigma)
    t = np.arange(steps, dtype=float)
    place = np.array([800.0, 600.0]) + t[:, None] * [12.0, -7.0]
    arrival = np.linalg.norm(place[:, None, :] - stations.positions, axis=-1) / C
    arrival = arrival + sigma * rng.normal(size=(runs, steps, 5))
    arrival[:, 5:35] += size * sigma * rng.choice([-1.0, 1.0], size=(runs, 30, 5))
    z = arrival[..., 1:] - arrival[..., :1]
    bank = Bank(
        [Static(psd=0.01), ConstantVelocity(psd=0.1)],
        mean_sojourn=60.0,
        birth_std={"velocity": 30.0},
    )
    track = IMM(bank, tdoa, robust=rule, update=update).run(t, z)
    error = np.linalg.norm(track.position[:, -1] - place[-1], axis=-1)
    assert np.count_nonzero(error > 60.0) <= 1
    assert not track.lost[:, -1].any()


def test_a_scan_without_information_restores_no_trust():
    """A lone arrival behind an unknown emission time says nothing, good or bad."""
    imm = IMM(Bank([Static(psd=0.0)]), TOA(STATIONS, sigma=SIGMA), robust="gate", reopen_after=3)
    state = imm.start(0.0, P0 + 4e3, np.eye(2))
    z = arrivals()
    for k in range(6):
        state = imm.step(
            state, float(k), z if k % 2 == 0 else np.where(np.arange(5) == 1, z, np.nan)
        )
    assert state.trust.rejected == 3
    assert state.trust.lost


@pytest.mark.parametrize("update", ["ekf", "iekf"])
def test_student_t_and_the_iteration_leave_the_targets_of_a_batch_alone(update):
    rng = np.random.default_rng(8)
    bank = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)])
    imm = IMM(bank, TOA(STATIONS, sigma=SIGMA), robust="student-t", update=update)
    z = arrivals() + SIGMA * rng.normal(size=(8, 20, 5)) * np.where(
        rng.random((8, 20, 5)) < 0.2, 50.0, 1.0
    )
    times = np.arange(20.0)
    begin = P0 + 30.0 * rng.normal(size=(8, 2))
    batch = imm.run(times, z, start=imm.start(-1.0, begin, 900.0 * np.eye(2)))
    for b in range(8):
        one = imm.run(times, z[b], start=imm.start(-1.0, begin[b], 900.0 * np.eye(2)))
        assert_allclose(batch.mean[b], one.mean, rtol=1e-9, atol=1e-7)


def test_errors_that_hide_each_other_are_not_let_in():
    """Two gross rows of three: no single one explains it; nothing is better than that."""
    tdoa = TDOA(STATIONS, tdoa_sigma=SIGMA, pairs=[[1, 0], [2, 0], [3, 0], [4, 0]])
    z = tdoa.predict(P0, np.zeros(2), 0.0) / C + np.array([8e-6, -7e-6, 9e-6, 0.0])
    imm = IMM(Bank([Static(psd=0.0)]), tdoa, robust="gate")
    start = imm.start(0.0, P0, 25.0 * np.eye(2))
    state = imm.step(start, 0.0, z)
    assert np.linalg.norm(state.mean - P0) < 10.0
    everything_out = robust.gate(against(tdoa, z, P0), np.zeros(1), SPREAD, 1e-6).price
    assert state.log_likelihood >= everything_out - 1e3


def test_pairs_of_each_targets_own_and_a_start_known_exactly():
    """What once raised: the iterated update with pairs per target, and with no uncertainty."""
    pairs = np.array([[[1, 0], [2, 0], [3, 0]], [[2, 1], [3, 1], [4, 1]], [[0, 4], [1, 4], [2, 4]]])
    each = np.broadcast_to(pairs[:, None], (3, 4, 3, 2))
    tdoa = TDOA(STATIONS, toa_sigma=SIGMA, pairs=pairs[0])
    z = TDOA(STATIONS, toa_sigma=SIGMA, pairs=pairs).predict(
        np.broadcast_to(P0, (3, 2)), np.zeros((3, 2)), 0.0
    )
    values = np.broadcast_to(z[:, None] / C, (3, 4, 3))
    for rule in (None, "gate", "student-t"):
        imm = IMM(Bank([Static(psd=0.0)]), tdoa, update="iekf", robust=rule)
        start = imm.start(-1.0, np.broadcast_to(P0 + 4e3, (3, 2)), 1e6 * np.eye(2))
        track = imm.run(np.arange(4.0), values, start=start, pairs=each)
        assert np.all(np.isfinite(track.mean))
    sure = imm.start(0.0, P0 + 3e3, np.zeros((2, 2)))
    assert_allclose(imm.step(sure, 0.0, values[0, 0], pairs=pairs[0]).mean, P0 + 3e3)
    with pytest.raises(ValueError, match="pairs"):
        imm.run(np.arange(4.0), values[0], pairs=each)
