"""Laws that every IMM obeys, whatever the bank, the geometry and the data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_cases import CORNERS, SIGMA, arrivals, bank_of, differences, irregular, seeds
from imm_oracles import C, correct, kalman, pair_covariance, polynomial, range_differences
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Static,
)

# --- special banks -------------------------------------------------------------------------------


@settings(deadline=None, max_examples=15)
@given(seed=seeds, order=st.sampled_from([0, 1, 2]))
def test_one_mode_is_the_plain_extended_filter(seed, order):
    rng = np.random.default_rng(seed)
    t = irregular(rng, 8)
    pairs = np.array([[1, 0], [2, 0], [3, 0], [4, 0]])
    values = differences(arrivals(rng, t), pairs)
    values[rng.uniform(size=values.shape) < 0.2] = np.nan
    imm = IMM(bank_of([order]), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    state = imm.start(0.0, [705.0, 890.0], np.diag([900.0, 400.0]))
    x, P, log_l, now = state.means[0], state.covariances[0], 0.0, 0.0
    R = pair_covariance([(C * SIGMA) ** 2] * 5, pairs)
    for when, z in zip(t, values, strict=True):
        F, Q = polynomial(order, when - now, (0.5, 2.0, 0.3)[order], 2)
        now = when
        x, P = F @ x, F @ P @ F.T + Q
        h, Hp = range_differences(x[:2], CORNERS, pairs)
        H = np.hstack([Hp, np.zeros((4, 2 * order))])
        keep = np.isfinite(z)
        x, P, more = correct(x, P, (C * z - h)[keep], H[keep], R[np.ix_(keep, keep)])
        log_l += more
        state = imm.step(state, when, z)
        assert_allclose(state.mean, x, rtol=1e-9, atol=1e-7)  # against sigmas of about 1
        assert_allclose(state.covariance, P, rtol=1e-7, atol=1e-7)
        assert_allclose(state.log_likelihood, log_l, rtol=1e-9, atol=1e-8)
        assert_array_equal(state.mode_probability, [1.0])


def test_one_mode_is_the_plain_linear_filter():
    rng = np.random.default_rng(2)
    imm = IMM(Bank([ConstantVelocity(psd=2.0)]), Position([1.0, 3.0]))
    x, P, log_l = np.array([0.0, 0.0, 1.0, -1.0]), np.diag([4.0, 9.0, 1.0, 1.0]), 0.0
    state = imm.start(0.0, x, P)
    for k in range(30):
        dt = float(rng.uniform(0.1, 4.0))
        z = rng.normal(size=2) * 5
        z[rng.uniform(size=2) < 0.2] = np.nan
        F, Q = polynomial(1, dt, 2.0, 2)
        x, P, more = kalman(x, P, F, Q, z, np.eye(2, 4), np.diag([1.0, 9.0]))
        log_l += more
        state = imm.step(state, float(state.time) + dt, z)
        assert_allclose(state.mean, x, rtol=1e-9, atol=1e-10, err_msg=str(k))
        assert_allclose(state.covariance, P, rtol=1e-9, atol=1e-10)
    assert_allclose(state.log_likelihood, log_l, rtol=1e-11)


@settings(deadline=None, max_examples=10)
@given(seed=seeds, r=st.integers(2, 4), order=st.sampled_from([0, 1, 2]), fixed=st.booleans())
def test_identical_modes_are_the_plain_filter_for_any_chain(seed, r, order, fixed):
    rng = np.random.default_rng(seed)
    t = irregular(rng, 8)
    tdoa = TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    values = differences(arrivals(rng, t), tdoa.pairs)
    values[rng.uniform(size=values.shape) < 0.2] = np.nan
    chain = (
        {"transition": rng.dirichlet(np.ones(r), size=r), "mean_sojourn": None}
        if fixed
        else {"mean_sojourn": rng.uniform(1.0, 50.0, r)}
    )
    many = IMM(bank_of([order] * r, prior=rng.dirichlet(np.ones(r)), **chain), tdoa)
    plain = IMM(bank_of([order]), tdoa)
    P = np.diag([900.0, 400.0])
    a = many.run(t, values, start=many.start(0.0, [705.0, 890.0], P))
    b = plain.run(t, values, start=plain.start(0.0, [705.0, 890.0], P))
    assert_allclose(a.mean, b.mean, rtol=1e-11, atol=1e-9)
    assert_allclose(a.covariance, b.covariance, rtol=1e-10, atol=1e-10)
    assert_allclose(a.log_likelihood, b.log_likelihood, rtol=1e-12, atol=1e-12)
    assert_allclose(a.nis, b.nis, rtol=1e-9)


@settings(deadline=None, max_examples=10)
@given(seed=seeds, order=st.permutations([0, 1, 2]), mixing=st.sampled_from(["birth", "zero"]))
def test_the_order_of_the_modes_does_not_matter(seed, order, mixing):
    rng = np.random.default_rng(seed)
    t = irregular(rng, 8)
    tdoa = TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    values = differences(arrivals(rng, t), tdoa.pairs)
    tau, prior = rng.uniform(2.0, 60.0, 3), rng.dirichlet(np.ones(3))
    p = np.array(order)
    a = IMM(bank_of(mean_sojourn=tau, prior=prior, mixing=mixing), tdoa)
    b = IMM(bank_of(p, mean_sojourn=tau[p], prior=prior[p], mixing=mixing), tdoa)
    P = np.diag([900.0, 400.0])
    a = a.run(t, values, start=a.start(0.0, [705.0, 890.0], P))
    b = b.run(t, values, start=b.start(0.0, [705.0, 890.0], P))
    assert a.components == b.components
    assert_allclose(b.mean, a.mean, rtol=1e-9, atol=1e-8)
    assert_allclose(b.covariance, a.covariance, rtol=1e-8, atol=1e-8)
    assert_allclose(b.mode_probability, a.mode_probability[:, p], rtol=1e-8, atol=1e-12)
    assert_allclose(b.log_likelihood, a.log_likelihood, rtol=1e-10)


@settings(deadline=None, max_examples=10)
@given(seed=seeds, endless=st.booleans())
def test_identity_chain_weighs_separate_filters(seed, endless):
    """Mode probabilities are posterior model probabilities, evidence is their mixture's."""
    rng = np.random.default_rng(seed)
    t = irregular(rng, 8)
    tdoa = TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    values = differences(arrivals(rng, t), tdoa.pairs)
    prior = rng.dirichlet(np.ones(3))
    P = np.diag([900.0, 400.0])
    chain = {"mean_sojourn": np.inf} if endless else {"transition": np.eye(3), "mean_sojourn": None}
    together = IMM(bank_of(prior=prior, **chain), tdoa)
    track = together.run(t, values, start=together.start(0.0, [705.0, 890.0], P))
    log_l = []
    for order in range(3):
        alone = IMM(bank_of([order]), tdoa)
        single = alone.run(t, values, start=alone.start(0.0, [705.0, 890.0], P))
        log_l.append(single.log_likelihood)
        assert_allclose(track.mode_means[order], single.mode_means[0], rtol=1e-12, atol=1e-10)
    joint = np.log(prior) + np.stack(log_l, axis=-1)
    evidence = np.logaddexp.reduce(joint, axis=-1)
    assert_allclose(track.log_likelihood, evidence, rtol=1e-11)
    assert_allclose(
        track.mode_probability, np.exp(joint - evidence[:, None]), rtol=1e-8, atol=1e-14
    )


# --- time ----------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=15)
@given(
    seed=seeds,
    order=st.sampled_from([0, 1, 2]),
    dt=st.floats(0.1, 10.0),
    share=st.floats(0.05, 0.95),
)
def test_an_empty_scan_in_between_changes_nothing_for_one_mode(seed, order, dt, share):
    rng = np.random.default_rng(seed)
    imm = IMM(bank_of([order]), Position([1.0, 2.0]))
    A = rng.normal(size=(2 * order + 2,) * 2)
    start = imm.start(0.0, rng.normal(size=len(A)), A @ A.T)
    z = rng.normal(size=2)
    whole = imm.step(start, dt, z)
    halves = imm.step(imm.step(start, share * dt, [np.nan] * 2), dt, z)
    assert_allclose(halves.mean, whole.mean, rtol=1e-9, atol=1e-9)
    assert_allclose(halves.covariance, whole.covariance, rtol=1e-9, atol=1e-9)
    assert_allclose(halves.log_likelihood, whole.log_likelihood, rtol=1e-9)


def test_an_empty_scan_in_between_leaves_the_mode_probabilities_of_a_generator_chain():
    imm = IMM(bank_of(mean_sojourn=[3.0, 10.0, 40.0]), Position(1.0))
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    whole = imm.step(start, 7.0, [np.nan] * 2)
    pieces = imm.run([1.0, 1.5, 4.0, 7.0], np.full((4, 2), np.nan), start=start)
    assert_allclose(pieces.mode_probability[-1], whole.mode_probability, rtol=1e-13)


@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_rows_of_one_instant_may_come_as_one_scan_or_several(seed):
    """At dt = 0 nothing mixes and no mode switches, so linear rows may come one by one."""
    rng = np.random.default_rng(seed)
    imm = IMM(bank_of(mean_sojourn=1.0), Position([1.0, 2.0, 0.5], dims=3))
    state = imm.step(imm.start(0.0, np.zeros(3), 9.0 * np.eye(3)), 2.0, rng.normal(size=3))
    z = 3.0 * rng.normal(size=3)
    together = imm.step(state, 5.0, z)
    apart = state
    for row in rng.permutation(3):
        one = np.full(3, np.nan)
        one[row] = z[row]
        apart = imm.step(apart, 5.0, one)
    assert_allclose(apart.mean, together.mean, rtol=1e-9, atol=1e-9)
    assert_allclose(apart.covariance, together.covariance, rtol=1e-8, atol=1e-9)
    assert_allclose(apart.mode_probability, together.mode_probability, rtol=1e-9)
    assert_allclose(apart.log_likelihood, together.log_likelihood, rtol=1e-10)


def test_no_time_and_no_data_is_no_step():
    imm = IMM(bank_of(mean_sojourn=1e-3), Position(1.0))
    state = imm.step(imm.start(0.0, [0.0, 0.0], np.eye(2)), 2.0, [1.0, 1.0])
    again = imm.step(state, 2.0, [np.nan, np.nan])
    for x, y in zip(again.means, state.means, strict=True):
        assert_array_equal(x, y)
    for x, y in zip(again.covariances, state.covariances, strict=True):
        assert_array_equal(x, y)
    assert_allclose(again.log_mode_probability, state.log_mode_probability, rtol=1e-14, atol=1e-15)


# --- missing rows --------------------------------------------------------------------------------


@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_missing_rows_are_rows_that_were_never_there(seed):
    rng = np.random.default_rng(seed)
    stations = Stations(CORNERS)
    t = irregular(rng, 7)
    toa = arrivals(rng, t)
    full = IMM(bank_of(), TDOA(stations, toa_sigma=SIGMA))
    values = differences(toa, full.measurement.pairs)
    values[rng.uniform(size=values.shape) < 0.4] = np.nan
    values[2] = np.nan
    state = full.start(0.0, [705.0, 890.0], np.diag([900.0, 400.0]))
    track = full.run(t, values, start=state)
    for k, z in enumerate(values):
        keep = np.isfinite(z)
        if keep.any():
            cut = TDOA(stations, toa_sigma=SIGMA, pairs=full.measurement.pairs[keep])
            state = full.step(state, t[k], z[keep], measurement=cut)
        else:
            before = state
            state = full.step(state, t[k], z)
            assert_array_equal(state.log_likelihood, before.log_likelihood)
            c = np.exp(before.log_mode_probability) @ full.bank.chain(t[k] - before.time)
            assert_allclose(state.mode_probability, c, rtol=1e-12)
        assert_allclose(track.mean[k], state.mean, rtol=1e-10, atol=1e-9)
        assert_allclose(track.covariance[k], state.covariance, rtol=1e-9, atol=1e-9)
        assert_allclose(track.log_likelihood[k], state.log_likelihood, rtol=1e-10, atol=1e-12)
        assert track.nis_dof[k] == np.count_nonzero(keep)


# --- health over a long time ---------------------------------------------------------------------


@pytest.mark.parametrize(("mixing", "T"), [("birth", 2000), ("unbiased", 400), ("zero", 400)])
def test_covariances_stay_proper_for_thousands_of_steps(mixing, T):
    """Random steps with dt = 0 among them, missing rows, four kinds of state, noise-free modes."""
    rng = np.random.default_rng(12)
    dt = rng.choice([0.0, 0.1, 1.0, 20.0], p=[0.2, 0.3, 0.45, 0.05], size=T)
    t = np.cumsum(dt)
    path = np.stack([700 + 300 * np.cos(t / 60), 900 + 300 * np.sin(t / 60)], axis=1)
    toa = np.linalg.norm(path[:, None] - CORNERS, axis=-1) / C + SIGMA * rng.normal(size=(T, 5))
    bank = Bank(
        [
            Static(psd=0.0),
            ConstantVelocity(psd=0.0),
            ConstantVelocity(std=1.0),
            ConstantAcceleration(psd=0.01),
            CoordinatedTurn(psd=0.1),
        ],
        mean_sojourn=30.0,
        mixing=mixing,
        birth_std={"velocity": 20.0, "acceleration": 2.0, "turn_rate": 0.1},
    )
    imm = IMM(bank, TOA(Stations(CORNERS), sigma=SIGMA))
    toa[rng.uniform(size=toa.shape) < 0.3] = np.nan
    toa[200:220] = np.nan
    track = imm.run(t, toa, start=imm.start(0.0, path[0], 100.0 * np.eye(2)))
    assert_allclose(track.mode_probability.sum(axis=-1), 1.0, atol=1e-12)
    for P in (*track.mode_covariances, track.covariance):
        assert np.all(np.isfinite(P))
        assert_array_equal(P, np.swapaxes(P, -1, -2))
        sd = np.sqrt(np.maximum(np.einsum("...ii->...i", P), 1e-300))
        correlation = P / (sd[..., :, None] * sd[..., None, :])
        assert np.linalg.eigvalsh(correlation).min() > -1e-9
    heard = np.isfinite(track.nis)
    error = np.linalg.norm(track.position - path, axis=-1)[heard]
    assert np.median(error) < 10.0
