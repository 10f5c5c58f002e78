"""The IMM: its cycle against a plain restatement, faults known from elsewhere, its surface."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_cases import BIRTH, CORNERS, KINDS, SIGMA, STATIONS, imm_2d, truth_values
from imm_oracles import (
    C,
    Mode,
    Posterior,
    imm_step,
    kalman,
    mixture_moments,
    pair_covariance,
    polynomial,
    range_differences,
)
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank
from imm_tdoa.contract import component_names
from imm_tdoa.models import TDOA, ConstantVelocity, Position, Static

# --- the whole cycle against a restatement ------------------------------------------------------


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    orders=st.permutations([0, 1, 2]).flatmap(
        lambda p: st.integers(1, 3).map(lambda r: tuple(p[:r]))
    ),
    mixing=st.sampled_from(["birth", "unbiased", "zero"]),
    fixed=st.booleans(),
)
def test_the_cycle_is_the_textbooks(seed, orders, mixing, fixed):
    """Static, CV and CA in any order on TDOAs with missing rows, irregular and repeated times."""
    rng = np.random.default_rng(seed)
    r = len(orders)
    Pi = rng.dirichlet(np.ones(r), size=r)
    if r == 3:
        Pi[0] = [0.0, 1.0, 0.0]  # some switches are impossible
    chain = {"transition": Pi} if fixed else {"mean_sojourn": rng.uniform(3.0, 50.0, r)}
    prior = rng.dirichlet(np.ones(r))
    bank = Bank([KINDS[o] for o in orders], prior=prior, mixing=mixing, birth_std=BIRTH, **chain)
    pairs = np.array([[1, 0], [2, 0], [3, 0], [4, 0]])
    imm = IMM(bank, TDOA(STATIONS, toa_sigma=SIGMA))
    R = pair_covariance([(C * SIGMA) ** 2] * 5, pairs)

    def mode(order):
        psd = KINDS[order].psd
        return Mode(
            component_names(2, order),
            lambda dt: polynomial(order, dt, psd, 2)[0],
            lambda dt: polynomial(order, dt, psd, 2)[1],
        )

    def birth(name):
        return {"v": 30.0, "a": 3.0}[name[0]] ** 2 if len(name) == 2 else 0.0

    modes = [mode(o) for o in orders]
    times = np.cumsum(rng.choice([0.0, 0.3, 1.0, 4.0], size=8))
    values = truth_values(rng, times, pairs)
    values[rng.uniform(size=values.shape) < 0.2] = np.nan
    mean = np.array([705.0, 890.0])
    P = np.array([[900.0, 100.0], [100.0, 400.0]])
    state = imm.start(0.0, mean, P)
    before = Posterior(
        [np.concatenate([mean, np.zeros(2 * o)]) for o in orders],
        [np.diag([0.0, 0.0] + [birth(n) for n in m.names[2:]]) for m in modes],
        prior,
        0.0,
    )
    for C_ in before.P:
        C_[:2, :2] = P
    now = 0.0
    for t, z in zip(times, values, strict=True):
        dt, now = t - now, t
        keep = np.isfinite(z)

        def innovation(j, x, z=z, keep=keep):
            h, Hp = range_differences(x[:2], CORNERS, pairs)
            H = np.zeros((4, len(x)))
            H[:, :2] = Hp
            return (C * z - h)[keep], H[keep], R[np.ix_(keep, keep)]

        before = imm_step(modes, before, bank.chain(dt), dt, innovation, mixing, birth)
        state = imm.step(state, t, z)
        for j in range(r):
            if before.mu[j] == 0.0:
                continue
            scale = np.sqrt(np.maximum(np.diag(before.P[j]), 1e-12))
            assert_allclose(state.means[j], before.x[j], rtol=1e-9, atol=1e-8 * scale.max())
            assert_allclose(
                state.covariances[j] / np.outer(scale, scale),
                before.P[j] / np.outer(scale, scale),
                atol=1e-6,
            )
        assert_allclose(state.mode_probability, before.mu, rtol=1e-7, atol=1e-9)
        assert_allclose(state.log_likelihood, before.log_likelihood, rtol=1e-9, atol=1e-7)
        x, P_ = mixture_moments(
            list(before.mu),
            [np.concatenate([x, np.zeros(6 - len(x))]) for x in before.x],
            [np.pad(P, (0, 6 - len(P))) for P in before.P],
        )
        n = len(state.components)
        assert_allclose(state.mean, x[:n], rtol=1e-7, atol=1e-6)
        assert_allclose(state.covariance, P_[:n, :n], rtol=1e-5, atol=1e-4)


# --- faults known from elsewhere (DESIGN §6) ------------------------------------------------------


def test_differences_that_share_a_station_are_correlated():
    """One scan from a flat prior leaves the inverse of the reference-free information (§1.1)."""
    p = np.array([700.0, 900.0])
    imm = IMM(Bank([Static(psd=0.0)]), TDOA(STATIONS, toa_sigma=SIGMA))
    z = range_differences(p, CORNERS, np.array([[1, 0], [2, 0], [3, 0], [4, 0]]))[0] / C
    state = imm.step(imm.start(0.0, p, 1e12 * np.eye(2)), 0.0, z)
    U = (p - CORNERS) / np.linalg.norm(p - CORNERS, axis=1)[:, None]
    U = U - U.mean(axis=0)
    information = U.T @ U / (C * SIGMA) ** 2
    assert_allclose(state.covariance, np.linalg.inv(information), rtol=1e-6)
    diagonal = IMM(Bank([Static(psd=0.0)]), TDOA(STATIONS, tdoa_sigma=SIGMA * np.sqrt(2)))
    wrong = diagonal.step(diagonal.start(0.0, p, 1e12 * np.eye(2)), 0.0, z)
    assert not np.allclose(wrong.covariance, state.covariance, rtol=0.05)


def test_all_pairs_count_the_data_once():
    rng = np.random.default_rng(1)
    reference = np.array([[1, 0], [2, 0], [3, 0], [4, 0]])
    every = np.array([[i, j] for i in range(5) for j in range(i)])
    bank = Bank(KINDS, birth_std=BIRTH)
    t = np.arange(1.0, 7.0)
    arrivals = np.linalg.norm((700.0 + 10 * t[:, None, None]) * [1, 1.2] - CORNERS, axis=-1) / C
    arrivals = arrivals + SIGMA * rng.normal(size=arrivals.shape)

    def run(pairs):
        imm = IMM(bank, TDOA(STATIONS, toa_sigma=SIGMA, pairs=pairs))
        values = arrivals[:, pairs[:, 0]] - arrivals[:, pairs[:, 1]]
        return imm.run(t, values, start=imm.start(0.0, [700.0, 840.0], 1e4 * np.eye(2)))

    once, often = run(reference), run(every)
    assert_allclose(often.mean, once.mean, rtol=1e-9, atol=1e-9)
    assert_allclose(often.covariance, once.covariance, rtol=1e-8, atol=1e-9)
    assert_allclose(often.log_likelihood, once.log_likelihood, rtol=1e-10)
    assert_allclose(often.nis, once.nis, rtol=1e-8)
    assert_array_equal(often.nis_dof, 4)


def test_likelihoods_far_below_the_range_of_floats_do_not_underflow():
    """A scan 450 sigmas away from every mode: log-likelihoods near -1e5, odds still exact."""
    models = [ConstantVelocity(psd=1e-6), ConstantVelocity(psd=2e-6)]
    imm = IMM(Bank(models, transition=[[0.9, 0.1], [0.1, 0.9]]), Position(1.0, dims=1))
    state = imm.step(imm.start(0.0, [0.0, 0.0], 1e-9 * np.eye(2)), 1.0, [450.0])
    log_l = []
    for psd in (1e-6, 2e-6):
        F, Q = polynomial(1, 1.0, psd, 1)
        *_, value = kalman(
            np.zeros(2), 1e-9 * np.eye(2), F, Q, np.array([450.0]), np.eye(1, 2), np.eye(1)
        )
        log_l.append(value)
    assert max(log_l) < -1e5
    assert_allclose(np.diff(state.log_mode_probability), np.diff(log_l), rtol=1e-8)
    assert_allclose(state.log_likelihood, np.logaddexp(*log_l) + np.log(0.5), rtol=1e-14)
    assert 0.0 < state.mode_probability[0] < 1.0


@settings(deadline=None, max_examples=20)
@given(st.lists(st.floats(0.0, 30.0), min_size=1, max_size=6))
def test_process_noise_follows_the_step(steps):
    imm = IMM(Bank([ConstantVelocity(psd=3.0)]), Position(1.0, dims=1))
    P = np.diag([4.0, 1.0])
    state = imm.start(0.0, [0.0, 0.0], P)
    for dt in steps:
        F, Q = polynomial(1, dt, 3.0, 1)
        P = F @ P @ F.T + Q
        state = imm.step(state, float(state.time) + dt, [np.nan])
    assert_allclose(state.covariance, P, rtol=1e-9)


# --- the surface ---------------------------------------------------------------------------------


def test_start_from_a_position_takes_the_rest_from_the_birth_law():
    state = imm_2d().start(5.0, [1.0, 2.0], np.diag([3.0, 4.0]))
    assert state.components == ("x", "y", "vx", "vy", "ax", "ay")
    assert state.modes == ("static", "constant-velocity", "constant-acceleration")
    assert state.time == 5.0
    assert_array_equal(state.means[2], [1.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    assert_array_equal(np.diag(state.covariances[2]), [3.0, 4.0, 900.0, 900.0, 9.0, 9.0])
    assert_array_equal(state.mode_probability, [1 / 3] * 3)
    assert (state.log_likelihood, state.nis_dof) == (0.0, 0)
    assert np.isnan(state.nis)


def test_start_from_all_components_or_named_ones():
    imm = imm_2d()
    full = imm.start(0.0, np.arange(6.0), np.diag(np.arange(1.0, 7.0)))
    assert_array_equal(full.means[0], [0.0, 1.0])
    assert_array_equal(full.means[1], [0.0, 1.0, 2.0, 3.0])
    named = imm.start(
        0.0, [7.0, 8.0, 1.0, 2.0], np.diag([1.0, 2.0, 3.0, 4.0]), ["vx", "vy", "x", "y"]
    )
    assert_array_equal(named.means[1], [1.0, 2.0, 7.0, 8.0])
    assert_array_equal(np.diag(named.covariances[2]), [3.0, 4.0, 1.0, 2.0, 9.0, 9.0])


def test_the_combined_estimate_lifts_with_zeros():
    """A static emitter has no velocity: it is zero, not unknown."""
    state = imm_2d().start(0.0, [1.0, 2.0], np.diag([3.0, 4.0]))
    assert_allclose(np.diag(state.covariance), [3.0, 4.0, 600.0, 600.0, 3.0, 3.0], rtol=1e-14)


def test_a_step_leaves_the_state_it_came_from_alone():
    imm = imm_2d()
    state = imm.start(0.0, [700.0, 900.0], 100.0 * np.eye(2))
    copies = [x.copy() for x in state.means], [P.copy() for P in state.covariances]
    z = truth_values(np.random.default_rng(0), [1.0], imm.measurement.pairs)[0]
    imm.step(state, 1.0, z)
    for x, y in zip((*state.means, *state.covariances), (*copies[0], *copies[1]), strict=True):
        assert_array_equal(x, y)
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        state.time = 3.0


def test_run_is_the_steps():
    imm = imm_2d()
    t = np.array([0.0, 1.0, 1.0, 2.5, 7.0])
    z = truth_values(np.random.default_rng(0), t, imm.measurement.pairs)
    z[1, 2:], z[2, :2], z[3] = np.nan, np.nan, np.nan
    state = imm.start(0.0, [700.0, 900.0], 100.0 * np.eye(2))
    track = imm.run(t, z, start=state, engine="numpy")
    assert track.mean.shape == (5, 6)
    assert track.modes == imm.bank.names
    for k in range(5):
        state = imm.step(state, t[k], z[k], engine="numpy")
        assert_allclose(track.mean[k], state.mean, rtol=1e-14)
        assert_allclose(track.covariance[k], state.covariance, rtol=1e-13)
        assert_allclose(track.mode_probability[k], state.mode_probability, rtol=1e-14)
        assert_allclose(track.log_likelihood[k], state.log_likelihood, rtol=1e-14)
        assert_allclose(track.nis[k], state.nis, rtol=1e-12)
        assert_allclose(track.mode_means[1][k], state.means[1], rtol=1e-14)
    assert_array_equal(track.nis_dof, [4, 2, 2, 0, 4])
    assert_array_equal(np.isnan(track.nis), [False, False, False, True, False])
    assert_array_equal(track.position, track.mean[:, :2])
    assert_array_equal(track.velocity, track.mean[:, 2:4])
    assert_array_equal(track.position_covariance, track.covariance[:, :2, :2])


def test_velocity_of_a_bank_without_one_is_zero():
    imm = IMM(Bank([Static(psd=1.0)]), Position(1.0))
    track = imm.run([0.0, 1.0], np.ones((2, 2)), start=imm.start(0.0, [3.0, 3.0], np.eye(2)))
    assert track.position.min() > 0.5
    assert_array_equal(track.velocity, np.zeros((2, 2)))


def test_nis_of_one_mode_is_its_own():
    imm = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(2.0, dims=1))
    state = imm.step(imm.start(0.0, [0.0, 1.0], np.diag([3.0, 2.0])), 2.0, [5.0])
    F, Q = polynomial(1, 2.0, 1.0, 1)
    S = (F @ np.diag([3.0, 2.0]) @ F.T + Q)[0, 0] + 4.0
    assert_allclose(state.nis, (5.0 - 2.0) ** 2 / S, rtol=1e-13)


def test_nis_judges_the_prediction_of_the_whole_bank():
    """Mean and spread of the modes' innovations under the predicted probabilities."""
    bank = Bank(
        [ConstantVelocity(psd=1.0), Static(psd=3.0)],
        transition=[[0.7, 0.3], [0.2, 0.8]],
        prior=[0.4, 0.6],
    )
    imm = IMM(bank, Position(2.0, dims=1))
    start = imm.start(0.0, [0.0, 3.0], np.diag([3.0, 2.0]))
    missed, state = imm.step(start, 2.0, [np.nan]), imm.step(start, 2.0, [9.0])
    c = missed.mode_probability
    assert_allclose(c, [0.4, 0.6], rtol=1e-14)
    nu, S = mixture_moments(
        list(c),
        [9.0 - x[:1] for x in missed.means],
        [P[:1, :1] + 4.0 for P in missed.covariances],
    )
    assert_allclose(state.nis, nu[0] ** 2 / S[0, 0], rtol=1e-12)
    assert state.nis_dof == 1


def test_another_measurement_or_other_pairs_for_one_scan():
    imm = imm_2d()
    start = imm.start(0.0, [700.0, 900.0], 100.0 * np.eye(2))
    fix = imm.step(start, 1.0, [700.0, 900.0], measurement=Position(5.0), engine="numpy")
    direct = IMM(imm.bank, Position(5.0)).step(start, 1.0, [700.0, 900.0], engine="numpy")
    assert_array_equal(fix.mean, direct.mean)
    one = np.array([[3, 1]])
    z = range_differences(np.array([710.0, 890.0]), CORNERS, one)[0] / C
    by_pair = imm.step(start, 1.0, z, pairs=one, engine="numpy")
    other = IMM(imm.bank, TDOA(STATIONS, toa_sigma=SIGMA, pairs=one)).step(
        start, 1.0, z, engine="numpy"
    )
    assert_array_equal(by_pair.mean, other.mean)
    assert by_pair.nis_dof == 1


def test_pairs_that_change_from_scan_to_scan():
    imm = imm_2d()
    t = np.arange(1.0, 7.0)
    pairs = np.array([[[1, 0]], [[2, 1]], [[3, 4]], [[4, 0]], [[3, 1]], [[2, 0]]])
    z = np.concatenate([truth_values(np.random.default_rng(k), [t[k]], pairs[k]) for k in range(6)])
    start = imm.start(0.0, [700.0, 900.0], 100.0 * np.eye(2))
    track = imm.run(t, z, start=start, pairs=pairs, engine="numpy")
    state = start
    for k in range(6):
        state = imm.step(state, t[k], z[k], pairs=pairs[k], engine="numpy")
    assert_allclose(track.mean[-1], state.mean, rtol=1e-13)
    assert_allclose(track.log_likelihood[-1], state.log_likelihood, rtol=1e-13)


def test_one_start_for_a_batch_of_values_and_times():
    imm = imm_2d()
    t = np.stack([np.arange(1.0, 5.0), np.arange(1.0, 5.0) * 1.7])
    z = np.stack(
        [truth_values(np.random.default_rng(b), t[b], imm.measurement.pairs) for b in (0, 1)]
    )
    start = imm.start(0.0, [700.0, 900.0], 100.0 * np.eye(2))
    both = imm.run(t, z, start=start)
    silent = imm.run(t[0], np.full_like(z, np.nan), start=start)
    assert both.mean.shape == silent.mean.shape == (2, 4, 6)
    for b in range(2):
        one = imm.run(t[b], z[b], start=start)
        assert_allclose(both.mean[b], one.mean, rtol=1e-12, atol=1e-10)
        assert_allclose(both.log_likelihood[b], one.log_likelihood, rtol=1e-12)
    assert_array_equal(silent.log_likelihood, np.zeros((2, 4)))
    batch = imm.step(start, np.array([1.0, 2.0]), np.full(4, np.nan))
    assert batch.log_likelihood.shape == batch.nis.shape == (2,)
