"""Laws that every IMM obeys, whatever the bank, the geometry and the data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import C, correct, kalman, pair_covariance, polynomial, range_differences
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Stack,
    Static,
)

SIGMA = 10e-9
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
BIRTH = {"velocity": 30.0, "acceleration": 3.0}
seeds = st.integers(0, 2**32 - 1)


def bank_of(orders=(0, 1, 2), **more):
    kinds = [Static(psd=0.5), ConstantVelocity(psd=2.0), ConstantAcceleration(psd=0.3)]
    return Bank([kinds[o] for o in orders], birth_std=BIRTH, **{"mean_sojourn": 20.0, **more})


def arrivals(rng, times, p=(700.0, 900.0), v=(12.0, -9.0), stations=CORNERS, sigma=SIGMA):
    """Noisy arrival times (T, S), s, each scan with an unknown emission time."""
    path = np.array(p) + np.array(v) * np.asarray(times)[:, None]
    clean = np.linalg.norm(path[:, None] - stations, axis=-1) / C
    return clean + sigma * rng.normal(size=clean.shape)


def irregular(rng, count):
    return np.cumsum(rng.choice([0.0, 0.4, 1.0, 3.0], size=count))


def differences(toa, pairs):
    return toa[..., pairs[:, 0]] - toa[..., pairs[:, 1]]


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


# --- nothing depends on the bookkeeping ----------------------------------------------------------

FORMS = {
    "station 2": lambda s: TDOA(s, toa_sigma=SIGMA, pairs=[[i, 2] for i in (0, 1, 3, 4)]),
    "adjacent": lambda s: TDOA(s, toa_sigma=SIGMA, pairs="adjacent"),
    "all pairs": lambda s: TDOA(
        s, toa_sigma=SIGMA, pairs=[[i, j] for j in range(5) for i in range(5) if i != j]
    ),
    "arrivals": lambda s: TOA(s, sigma=SIGMA),
}


@pytest.mark.parametrize(
    ("form", "seed"),
    # a silent station breaks a chain of adjacent pairs, so that one only where all are heard
    [(form, seed) for form in FORMS for seed in range(4) if form != "adjacent" or seed < 2],
)
def test_the_reference_station_does_not_matter(form, seed):
    """Estimate, covariance, mode probability and log-likelihood, to 1e-9 (ALGORITHMS §1.1)."""
    rng = np.random.default_rng(seed)
    t = irregular(rng, 10)
    toa = arrivals(rng, t)
    if seed >= 2:  # one station silent for a while, not the reference of either form
        toa[3:6, 4] = np.nan
    stations = Stations(CORNERS)
    bank = bank_of()
    tracks = []
    for measurement in (TDOA(stations, toa_sigma=SIGMA), FORMS[form](stations)):
        imm = IMM(bank, measurement)
        if form == "arrivals" and isinstance(measurement, TOA):
            values = toa + rng.uniform(0.0, 1e-3, (10, 1))  # any emission time
        else:
            values = differences(toa, measurement.pairs)
        start = imm.start(0.0, [705.0, 890.0], np.diag([900.0, 400.0]))
        tracks.append(imm.run(t, values, start=start))
    a, b = tracks
    assert_allclose(b.mean, a.mean, rtol=1e-9, atol=1e-8)
    assert_allclose(b.covariance, a.covariance, rtol=1e-9, atol=1e-8)
    assert_allclose(b.mode_probability, a.mode_probability, rtol=1e-9, atol=1e-12)
    assert_allclose(b.log_likelihood, a.log_likelihood, rtol=1e-9)
    assert_allclose(b.nis, a.nis, rtol=1e-8)
    assert_array_equal(b.nis_dof, a.nis_dof)


def test_unequal_arrival_errors_keep_the_reference_irrelevant():
    rng = np.random.default_rng(9)
    sigma = np.array([5e-9, 40e-9, 10e-9, 20e-9, 8e-9])
    t = irregular(rng, 10)
    toa = arrivals(rng, t, sigma=sigma)
    stations, tracks = Stations(CORNERS), []
    for measurement in (
        TDOA(stations, toa_sigma=sigma),
        TDOA(stations, toa_sigma=sigma, pairs=[[i, 3] for i in (0, 1, 2, 4)]),
        TOA(stations, sigma=sigma),
    ):
        imm = IMM(bank_of(), measurement)
        values = toa if isinstance(measurement, TOA) else differences(toa, measurement.pairs)
        start = imm.start(0.0, [705.0, 890.0], np.diag([900.0, 400.0]))
        tracks.append(imm.run(t, values, start=start))
    for other in tracks[1:]:
        assert_allclose(other.mean, tracks[0].mean, rtol=1e-9, atol=1e-8)
        assert_allclose(other.covariance, tracks[0].covariance, rtol=1e-9, atol=1e-8)
        assert_allclose(other.mode_probability, tracks[0].mode_probability, rtol=1e-9, atol=1e-12)
        assert_allclose(other.log_likelihood, tracks[0].log_likelihood, rtol=1e-9)


def kilometre_bank(u):
    """The same bank where lengths are given in units of u metres."""
    return Bank(
        [
            Static(psd=0.5 / u**2),
            ConstantVelocity(psd=2.0 / u**2),
            ConstantAcceleration(psd=0.3 / u**2),
        ],
        mean_sojourn=20.0,
        birth_std={kind: std / u for kind, std in BIRTH.items()},
    )


@pytest.mark.parametrize("length", [1.0, 1e3, 0.3048])
@pytest.mark.parametrize("second", [1.0, 1e-9])
def test_units_change_nothing_but_the_units(length, second):
    """Metres or kilometres; differences in seconds or nanoseconds, with speed= to match."""
    rng = np.random.default_rng(6)
    t = irregular(rng, 10)
    toa = arrivals(rng, t)
    base = IMM(kilometre_bank(1.0), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    other = IMM(
        kilometre_bank(length),
        TDOA(Stations(CORNERS / length), toa_sigma=SIGMA / second, speed=C * second / length),
    )
    z = differences(toa, base.measurement.pairs)
    mean, P = np.array([705.0, 890.0]), np.diag([900.0, 400.0])
    a = base.run(t, z, start=base.start(0.0, mean, P))
    b = other.run(t, z / second, start=other.start(0.0, mean / length, P / length**2))
    assert_allclose(b.mean * length, a.mean, rtol=1e-9, atol=1e-8)
    assert_allclose(b.covariance * length**2, a.covariance, rtol=1e-9, atol=1e-8)
    assert_allclose(b.mode_probability, a.mode_probability, rtol=1e-9, atol=1e-13)
    assert_allclose(b.nis, a.nis, rtol=1e-9)
    rows = np.cumsum(a.nis_dof)  # a density per unit length: each row brings log(length)
    assert_allclose(b.log_likelihood - rows * np.log(length), a.log_likelihood, rtol=1e-9)


@settings(deadline=None, max_examples=8)
@given(seed=seeds, angle=st.floats(-np.pi, np.pi), mirror=st.booleans())
def test_translation_and_rotation_move_the_answer_along(seed, angle, mirror):
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-5e4, 5e4, 2)
    A = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if mirror:
        A = A @ np.diag([1.0, -1.0])
    t = irregular(rng, 8)
    toa = arrivals(rng, t)
    a = IMM(bank_of(), TOA(Stations(CORNERS), sigma=SIGMA))
    b = IMM(bank_of(), TOA(Stations(CORNERS @ A.T + shift), sigma=SIGMA))
    mean, P = np.array([705.0, 890.0]), np.array([[900.0, 200.0], [200.0, 400.0]])
    a = a.run(t, toa, start=a.start(0.0, mean, P))
    b = b.run(t, toa, start=b.start(0.0, A @ mean + shift, A @ P @ A.T))
    full = np.kron(np.eye(3), A)
    want = a.mean @ full.T
    want[:, :2] += shift
    assert_allclose(b.mean, want, rtol=1e-9, atol=1e-6)
    assert_allclose(b.covariance, full @ a.covariance @ full.T, rtol=1e-7, atol=1e-6)
    assert_allclose(b.mode_probability, a.mode_probability, rtol=1e-7, atol=1e-12)
    assert_allclose(b.log_likelihood, a.log_likelihood, rtol=1e-8, atol=1e-8)


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


# --- many targets at once ------------------------------------------------------------------------


def many_targets(B, T, seed=0):
    rng = np.random.default_rng(seed)
    p, v = rng.uniform(300.0, 1700.0, (B, 2)), rng.normal(0.0, 15.0, (B, 2))
    t = np.cumsum(rng.choice([0.5, 1.0, 2.0], size=T))
    path = p[:, None] + v[:, None] * t[:, None]
    toa = np.linalg.norm(path[:, :, None] - CORNERS, axis=-1) / C
    toa += SIGMA * rng.normal(size=toa.shape)
    values = toa[..., 1:] - toa[..., :1]
    values[rng.uniform(size=values.shape) < 0.15] = np.nan
    values[np.arange(B) % 7 == 0, 0] = np.nan  # these start later than the others
    values[np.arange(B) % 11 == 0, 3:5] = np.nan
    return t, values, p


FIELDS = ("mean", "covariance", "mode_probability", "log_likelihood", "nis")


def assert_target(batch, b, one):
    """Target b of the batch is the track `one`, up to its NaN rows before the start."""
    rows = slice(batch.mean.shape[-2] - len(one.times), None)
    for name in FIELDS:
        got, want = getattr(batch, name)[b], getattr(one, name)
        assert np.isnan(got[: rows.start]).all(), name
        assert_allclose(got[rows], want, rtol=1e-10, atol=1e-10, err_msg=f"{name}, target {b}")
    assert_array_equal(batch.nis_dof[b][rows], one.nis_dof)


def test_a_thousand_targets_at_once_are_a_thousand_alone():
    """Every target against another, shuffled grouping; every 25th against a run of its own."""
    B, T = 1000, 12
    t, values, p = many_targets(B, T)
    imm = IMM(bank_of(), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    P = 400.0 * np.eye(2)
    batch = imm.run(t, values, start=imm.start(0.0, p, P))
    assert batch.mean.shape == (B, T, 6)
    for group in np.array_split(np.random.default_rng(0).permutation(B), 25):
        part = imm.run(t, values[group], start=imm.start(0.0, p[group], P))
        for name in FIELDS:
            got, want = getattr(batch, name)[group], getattr(part, name)
            assert_allclose(got, want, rtol=1e-10, atol=1e-10, err_msg=name)
    for b in range(0, B, 25):
        assert_target(batch, b, imm.run(t, values[b], start=imm.start(0.0, p[b], P)))


def test_targets_that_start_by_themselves_at_different_scans():
    B, T = 33, 12
    t, values, _ = many_targets(B, T, seed=1)
    imm = IMM(bank_of(), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    batch = imm.run(t, values)
    starts = set()
    for b in range(B):
        one = imm.run(t, values[b])
        starts.add(T - len(one.times))
        assert_target(batch, b, one)
    assert len(starts) > 1


def test_a_batch_with_the_gate_and_several_kinds_of_rows():
    rng = np.random.default_rng(3)
    B, T = 12, 8
    t, values, p = many_targets(B, T, seed=2)
    stations = Stations(CORNERS, velocities=rng.normal(0, 20.0, CORNERS.shape))
    stack = Stack(TDOA(stations, toa_sigma=SIGMA), FDOA(stations, range_rate_sigma=0.5))
    imm = IMM(bank_of(), stack, robust="gate")
    rates = np.empty((B, T, 4))
    for index in np.ndindex(B, T):
        rates[index] = FDOA(stations, range_rate_sigma=0.5).predict(p[index[0]], np.zeros(2), 0.0)
    rates += 0.7 * rng.normal(size=rates.shape)
    values = np.concatenate([values, rates], axis=-1)
    values[::3, 4, 1] += 1e-6
    start = imm.start(0.0, p, 400.0 * np.eye(2))
    batch = imm.run(t, values, start=start)
    for b in range(B):
        alone = imm.start(0.0, p[b], 400.0 * np.eye(2))
        assert_target(batch, b, imm.run(t, values[b], start=alone))


def test_times_and_pairs_may_differ_from_target_to_target():
    rng = np.random.default_rng(5)
    B, T = 6, 9
    t = np.cumsum(rng.uniform(0.0, 2.0, (B, T)), axis=1)
    toa = np.stack([arrivals(rng, t[b]) for b in range(B)])
    pairs = np.stack([rng.permuted(np.tile(np.arange(5), (T, 1)), axis=1) for _ in range(B)])
    pairs = np.stack([pairs[..., [0, 1]], pairs[..., [2, 3]]], axis=-2)
    values = np.take_along_axis(toa, pairs[..., 0], -1) - np.take_along_axis(toa, pairs[..., 1], -1)
    imm = IMM(bank_of(), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    start = imm.start(0.0, [700.0, 900.0], 400.0 * np.eye(2))
    batch = imm.run(t, values, start=start, pairs=pairs)
    for b in range(B):
        assert_target(batch, b, imm.run(t[b], values[b], start=start, pairs=pairs[b]))


def test_start_of_a_batch_is_the_batch_of_starts():
    imm = IMM(bank_of(), Position(1.0))
    state = imm.start(np.array([0.0, 5.0]), np.zeros((2, 2)), np.eye(2))
    assert state.log_mode_probability.shape == (2, 3)
    later = imm.step(state, 6.0, np.ones((2, 2)))
    for b in range(2):
        one = imm.step(imm.start([0.0, 5.0][b], [0.0, 0.0], np.eye(2)), 6.0, [1.0, 1.0])
        assert_allclose(later.mean[b], one.mean, rtol=1e-13)
        assert_allclose(later.log_likelihood[b], one.log_likelihood, rtol=1e-13)
