"""The IMM cycle: against a plain restatement, mixing by hand, faults to avoid, what is refused."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
from scipy.stats import chi2

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.contract import component_names
from imm_tdoa.mixing import mix
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Position,
    Static,
)

SIGMA = 10e-9  # s per arrival, 3 m
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
STATIONS = Stations(CORNERS)
BIRTH = {"velocity": 30.0, "acceleration": 3.0}
KINDS = [Static(psd=0.5), ConstantVelocity(psd=2.0), ConstantAcceleration(psd=0.3)]


def truth_values(rng, times, pairs, p=(700.0, 900.0), v=(12.0, -9.0)):
    path = np.array(p) + np.array(v) * np.asarray(times)[:, None]
    clean = np.stack([range_differences(q, CORNERS, pairs)[0] for q in path])
    R = pair_covariance([(C * SIGMA) ** 2] * len(CORNERS), pairs)
    return (clean + rng.multivariate_normal(np.zeros(len(R)), R, size=len(path))) / C


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


# --- mixing by hand ------------------------------------------------------------------------------


def state_1d(bank, means, covariances, probability):
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [0.0], [[1.0]])
    return attrs.evolve(
        state,
        means=tuple(np.array(m, float) for m in means),
        covariances=tuple(np.array(P, float) for P in covariances),
        log_mode_probability=np.log(probability),
    )


@pytest.mark.parametrize(
    ("mixing", "x", "P"),
    [
        # static N(1, 4), weight 1/4; CV N([3, 2], [[1, .5], [.5, 2]]), weight 3/4, into CV.
        # position: mean 2.5, variance (4 + 1.5²)/4 + 3(1 + .5²)/4 = 2.5, whatever the rule
        ("birth", [2.5, 1.5], [[2.5, 1.125], [1.125, 27.25]]),  # velocity from N(0, 10²)
        ("zero", [2.5, 1.5], [[2.5, 1.125], [1.125, 2.25]]),  # velocity 0
        ("unbiased", [2.5, 2.0], [[2.5, 0.375], [0.375, 2.0]]),  # velocity from N(2, 2)
    ],
)
def test_static_and_cv_mixed_by_hand(mixing, x, P):
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0)],
        transition=[[0.5, 0.5], [0.5, 0.5]],
        mixing=mixing,
        birth_std={"velocity": 10.0},
    )
    state = state_1d(bank, [[1.0], [3.0, 2.0]], [[[4.0]], [[1.0, 0.5], [0.5, 2.0]]], [0.25, 0.75])
    means, covariances, log_c = mix(state, bank.chain(1.0), mixing)
    assert_allclose(means[0], [2.5], rtol=1e-15)  # CV -> static keeps the position's marginal
    assert_allclose(covariances[0], [[2.5]], rtol=1e-15)
    assert_allclose(means[1], x, rtol=1e-15)
    assert_allclose(covariances[1], P, rtol=1e-15)
    assert_allclose(np.exp(log_c), [0.5, 0.5], rtol=1e-15)


def test_mixing_leaves_an_unreachable_mode_as_it_was():
    bank = Bank([ConstantVelocity(psd=0.0), Static(psd=0.0)], transition=[[1, 0], [1, 0]])
    state = state_1d(bank, [[3.0, 2.0], [7.0]], [np.eye(2), [[4.0]]], [0.5, 0.5])
    means, covariances, log_c = mix(state, bank.chain(1.0), "birth")
    assert_array_equal(means[1], [7.0])
    assert_array_equal(covariances[1], [[4.0]])
    assert_array_equal(np.exp(log_c), [1.0, 0.0])


@pytest.mark.parametrize("mixing", ["birth", "unbiased", "zero"])
def test_three_orders_mixed_by_brute_force(mixing):
    rng = np.random.default_rng(4)

    def spd(n):
        A = rng.normal(size=(n, n))
        return A @ A.T + np.eye(n)

    xs = [rng.normal(size=n) for n in (1, 2, 3)]
    Ps = [spd(n) for n in (1, 2, 3)]
    Pi = rng.dirichlet(np.ones(3), size=3)
    mu = np.array([0.2, 0.3, 0.5])
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
        transition=Pi,
        mixing=mixing,
        birth_std={"velocity": 3.0, "acceleration": 2.0},
    )
    means, covariances, log_c = mix(state_1d(bank, xs, Ps, mu), Pi, mixing)
    assert_allclose(np.exp(log_c), mu @ Pi, rtol=1e-14)
    birth = [0.0, 9.0, 4.0]
    for j in range(3):
        lifted = []
        for i in range(3):
            c, n = min(i, j) + 1, j + 1
            x, P = np.zeros(n), np.zeros((n, n))
            x[:c], P[:c, :c] = xs[i][:c], Ps[i][:c, :c]
            if mixing == "birth":
                P[range(c, n), range(c, n)] = birth[c:n]
            elif mixing == "unbiased":
                x[c:], P[c:, c:] = xs[j][c:], Ps[j][c:, c:]
            lifted.append((x, P))
        w = mu * Pi[:, j] / (mu @ Pi)[j]
        x, P = mixture_moments(list(w), [a for a, _ in lifted], [b for _, b in lifted])
        assert_allclose(means[j], x, rtol=1e-12)
        assert_allclose(covariances[j], P, rtol=1e-12)


def test_up_and_down_again_changes_nothing():
    """Static -> CA -> static: the position's marginal survives; static -> CA fills v and a."""
    bank = Bank([Static(psd=0.0), ConstantAcceleration(psd=0.0)], transition=[[0, 1], [1, 0]])
    start = state_1d(bank, [[5.0], [0.0] * 3], [[[2.0]], np.eye(3)], [1.0, 1e-300])
    means, covariances, log_c = mix(start, bank.chain(1.0), "birth")
    assert_allclose(means[1], [5.0, 0.0, 0.0], rtol=1e-15)
    assert_allclose(covariances[1], np.diag([2.0, 100.0**2, 10.0**2]), rtol=1e-15)
    up = attrs.evolve(start, means=means, covariances=covariances, log_mode_probability=log_c)
    means, covariances, log_c = mix(up, bank.chain(1.0), "birth")
    assert_allclose(means[0], [5.0], rtol=1e-15)
    assert_allclose(covariances[0], [[2.0]], rtol=1e-15)


def test_an_unreachable_mode_keeps_its_state_and_weighs_nothing():
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantVelocity(psd=1.0)],
        transition=[[0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [1.0, 0.0, 0.0]],
        prior=[0.5, 0.5, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [3.0], [[4.0]])
    for k in range(5):
        state = imm.step(state, k + 1.0, [3.0 + 0.1 * k])
        assert state.mode_probability[2] == 0.0
        assert np.isneginf(state.log_mode_probability[2])
        assert all(np.isfinite(x).all() for x in state.means)
        assert np.isfinite(state.mean).all()
    without = IMM(Bank(bank.models[:2], transition=[[0.5, 0.5], [0.5, 0.5]]), Position(1.0, dims=1))
    other = without.start(0.0, [3.0], [[4.0]])
    for k in range(5):
        other = without.step(other, k + 1.0, [3.0 + 0.1 * k])
    assert_allclose(state.mean, other.mean, rtol=1e-14)
    assert_allclose(state.log_likelihood, other.log_likelihood, rtol=1e-14)


def test_a_mode_that_becomes_reachable_comes_back_from_the_others():
    bank = Bank(
        [ConstantVelocity(psd=0.0), ConstantVelocity(psd=5.0)],
        transition=[[0.9, 0.1], [0.2, 0.8]],
        prior=[1.0, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [0.0, 1.0], np.eye(2))
    assert_array_equal(state.mode_probability, [1.0, 0.0])
    assert_allclose(imm.step(state, 1.0, [np.nan]).mode_probability, [0.9, 0.1], rtol=1e-14)


# --- faults known from elsewhere (DESIGN §6) ------------------------------------------------------


def test_unequal_dimensions_leave_proper_covariances_where_overwriting_would_not():
    """Writing the small mode's block into the big mode's covariance makes it indefinite."""
    P_big = np.array([[100.0, 99.0], [99.0, 100.0]])
    overwritten = P_big.copy()
    overwritten[0, 0] = 1.0
    assert np.linalg.eigvalsh(overwritten)[0] < -30.0
    for mixing in ("birth", "unbiased", "zero"):
        bank = Bank(
            [Static(psd=0.0), ConstantVelocity(psd=0.0)],
            transition=[[0.1, 0.9], [0.5, 0.5]],
            mixing=mixing,
        )
        state = state_1d(bank, [[0.0], [0.0, 0.0]], [[[1.0]], P_big], [0.999, 0.001])
        _, covariances, _ = mix(state, bank.chain(1.0), mixing)
        for P in covariances:
            assert np.linalg.eigvalsh(P)[0] >= -1e-12 * np.trace(P)


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


# --- the gate ------------------------------------------------------------------------------------


def gated(measurement, **more):
    bank = Bank(KINDS, birth_std=BIRTH)
    return IMM(bank, measurement, robust="gate", **more), IMM(bank, measurement)


def test_a_scan_gated_away_changes_nothing_but_the_time():
    """In particular the covariance: nothing was measured, so nothing shrinks."""
    gate, plain = gated(Position(1.0, dims=2))
    start = gate.start(0.0, [0.0, 0.0], np.eye(2))
    missed, outlier = plain.step(start, 1.0, [np.nan] * 2), gate.step(start, 1.0, [1e5, -1e5])
    for j in range(3):
        assert_array_equal(outlier.means[j], missed.means[j])
        assert_array_equal(outlier.covariances[j], missed.covariances[j])
    assert_allclose(outlier.covariance, missed.covariance, rtol=1e-14)
    assert_allclose(outlier.mode_probability, missed.mode_probability, rtol=1e-14)
    assert outlier.log_likelihood < 0.0
    assert np.isnan(outlier.nis)
    assert outlier.nis_dof == 0


@pytest.mark.parametrize("corrupted", [[0], [2], [3], [1, 3]])
@pytest.mark.parametrize("form", ["tdoa", "toa"])
def test_the_gate_drops_just_the_corrupted_rows(form, corrupted):
    """Rows with an error of 3 µs leave; the rest is used as if they had been missing."""
    rng = np.random.default_rng(11)
    t = np.arange(1.0, 9.0)
    if form == "tdoa":
        measurement = TDOA(STATIONS, toa_sigma=SIGMA)
        values = truth_values(rng, t, measurement.pairs)
    else:
        measurement = TOA(STATIONS, sigma=SIGMA)
        path = np.array([700.0, 900.0]) + np.array([12.0, -9.0]) * t[:, None]
        arrival = np.linalg.norm(path[:, None] - CORNERS, axis=-1) / C
        values = arrival + SIGMA * rng.normal(size=arrival.shape) + rng.uniform(0, 1e3, (8, 1))
    bad, cut = values.copy(), values.copy()
    bad[5, corrupted] += 3e-6 * np.linspace(1.0, 2.0, len(corrupted))
    cut[5, corrupted] = np.nan
    gate, plain = gated(measurement, gate_probability=1.0 - 1e-9)
    start = gate.start(0.0, [700.0, 900.0], 900.0 * np.eye(2))
    got, want = gate.run(t, bad, start=start), plain.run(t, cut, start=start)
    assert_array_equal(got.nis_dof, want.nis_dof)
    assert_allclose(got.mean, want.mean, rtol=1e-9, atol=1e-9)
    assert_allclose(got.covariance, want.covariance, rtol=1e-9, atol=1e-9)
    assert_allclose(got.mode_probability, want.mode_probability, rtol=1e-9, atol=1e-12)
    price = got.log_likelihood - want.log_likelihood
    assert_allclose(price[:5], 0.0, atol=1e-9)
    assert_allclose(price[5:], price[5], rtol=1e-9)
    assert price[5] < -0.5 * len(corrupted) * chi2.ppf(1.0 - 1e-9, 1)


@pytest.mark.parametrize("corrupted", [[0], [2], [1, 3], [0, 1, 2, 3]])
@pytest.mark.parametrize("form", ["tdoa", "toa"])
def test_a_dropped_row_is_charged_as_if_it_lay_on_the_gate(form, corrupted):
    """Its density given the rows kept, at the gate: -(threshold + log(2 pi C)) / 2, jointly.

    The oracle is the Schur complement of the mixture innovation's covariance; arrivals are taken
    as differences against one that was kept.
    """
    p = np.array([703.0, 898.0])
    P = np.array([[30.0, 5.0], [5.0, 20.0]])
    bank = Bank(
        [Static(psd=3.0), ConstantVelocity(psd=1.0)], transition=np.eye(2), prior=[0.3, 0.7]
    )
    arrival = np.linalg.norm([700.0, 900.0] - CORNERS, axis=1) / C
    pairs = np.array([[1, 0], [2, 0], [3, 0], [4, 0]])
    if form == "tdoa":
        measurement, values = TDOA(STATIONS, toa_sigma=SIGMA), arrival[1:] - arrival[0]
    else:
        measurement, values = TOA(STATIONS, sigma=SIGMA), arrival + 0.25
        pairs = np.array([[0, 4], [1, 4], [2, 4], [3, 4]])
    values[corrupted] += 1e-5 * np.array([1.0, -2.0, 3.0, -4.0])[: len(corrupted)]
    gate = IMM(bank, measurement, robust="gate")
    start = gate.start(0.0, p, P)
    got = gate.step(start, 2.0, values)
    cut = values.copy()
    cut[corrupted] = np.nan
    plain = IMM(bank, measurement)
    want, missed = plain.step(start, 2.0, cut), plain.step(start, 2.0, np.full_like(values, np.nan))
    assert got.nis_dof == want.nis_dof
    R = pair_covariance([(C * SIGMA) ** 2] * 5, pairs)
    nus, Ss = [], []
    for x, P_ in zip(missed.means, missed.covariances, strict=True):
        h, H = range_differences(x[:2], CORNERS, pairs)
        nus.append(h)
        Ss.append(H @ P_[:2, :2] @ H.T + R)
    _, S = mixture_moments([0.3, 0.7], nus, Ss)
    out = np.isin(np.arange(4), corrupted)
    S_out = S[np.ix_(out, out)]
    if not out.all():
        cross = S[np.ix_(out, ~out)]
        S_out = S_out - cross @ np.linalg.inv(S[np.ix_(~out, ~out)]) @ cross.T
    k, threshold = len(corrupted), chi2.ppf(0.999, 1)
    price = -0.5 * (k * (threshold + np.log(2 * np.pi)) + np.linalg.slogdet(S_out)[1])
    assert_allclose(got.log_likelihood - want.log_likelihood, price, rtol=1e-8)


@pytest.mark.parametrize("probability", [0.9, 0.99])
@pytest.mark.parametrize("form", ["tdoa", "toa", "position"])
def test_the_gate_keeps_good_rows_as_often_as_it_says(form, probability):
    """Single rows are tested at the stated level; several rows at the Bonferroni bound.

    The largest of m statistics exceeds the threshold with a probability between that of one row
    and m times it; on clean data from the model itself both bounds hold up to binomial noise.
    """
    n, rng = 4000, np.random.default_rng(8)
    p0, P0 = np.array([700.0, 900.0]), np.array([[25.0, 5.0], [5.0, 9.0]])
    p = rng.multivariate_normal(p0, P0, size=n)
    if form == "position":
        measurement = Position([2.0, 3.0], dims=2)
        values = p + rng.normal(size=p.shape) * [2.0, 3.0]
    else:
        arrival = np.linalg.norm(p[:, None] - CORNERS, axis=-1) / C
        arrival += SIGMA * rng.normal(size=arrival.shape)
        measurement = TOA(STATIONS, sigma=SIGMA)
        values = arrival
        if form == "tdoa":
            measurement = TDOA(STATIONS, toa_sigma=SIGMA)
            values = arrival[:, 1:] - arrival[:, :1]
    bank = Bank([Static(psd=0.0)])
    imm = IMM(bank, measurement, robust="gate", gate_probability=probability)
    state = imm.step(imm.start(0.0, p0, P0), 0.0, values)
    full = IMM(bank, measurement)
    dof = full.step(full.start(0.0, p0, P0), 0.0, values).nis_dof
    touched = np.count_nonzero(state.nis_dof < dof)
    m, miss = measurement.size, 1.0 - probability
    noise = 4.0 * np.sqrt(n * miss)
    assert n * miss - noise < touched < n * m * miss + noise * np.sqrt(m)
    alone = np.full_like(values, np.nan)
    alone[:, :1] = values[:, :1]
    if form != "toa":
        lone = imm.step(imm.start(0.0, p0, P0), 0.0, alone)
        rejected = np.count_nonzero(lone.nis_dof == 0)
        assert abs(rejected - n * miss) < 4.0 * np.sqrt(n * miss * (1 - miss))


def test_the_gate_judges_the_mixture_not_a_single_mode():
    """What one probable enough mode expects is no outlier."""
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0)],
        transition=[[0.9, 0.1], [0.1, 0.9]],
        birth_std={"velocity": 100.0},
    )
    imm = IMM(bank, Position(1.0, dims=1), robust="gate")
    start = imm.start(0.0, [0.0], [[1.0]])
    for z, used in ((200.0, 1), (400.0, 0)):
        S = 0.5 * 2.0 + 0.5 * (1e4 + 2.0)
        assert (z**2 / S < chi2.ppf(0.999, 1)) == used
        assert imm.step(start, 1.0, [z]).nis_dof == used


# --- the surface ---------------------------------------------------------------------------------


def imm_2d(**more):
    return IMM(Bank(KINDS, birth_std=BIRTH), TDOA(STATIONS, toa_sigma=SIGMA), **more)


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
    track = imm.run(t, z, start=state)
    assert track.mean.shape == (5, 6)
    assert track.modes == imm.bank.names
    for k in range(5):
        state = imm.step(state, t[k], z[k])
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
    fix = imm.step(start, 1.0, [700.0, 900.0], measurement=Position(5.0))
    direct = IMM(imm.bank, Position(5.0)).step(start, 1.0, [700.0, 900.0])
    assert_array_equal(fix.mean, direct.mean)
    one = np.array([[3, 1]])
    z = range_differences(np.array([710.0, 890.0]), CORNERS, one)[0] / C
    by_pair = imm.step(start, 1.0, z, pairs=one)
    other = IMM(imm.bank, TDOA(STATIONS, toa_sigma=SIGMA, pairs=one)).step(start, 1.0, z)
    assert_array_equal(by_pair.mean, other.mean)
    assert by_pair.nis_dof == 1


def test_pairs_that_change_from_scan_to_scan():
    imm = imm_2d()
    t = np.arange(1.0, 7.0)
    pairs = np.array([[[1, 0]], [[2, 1]], [[3, 4]], [[4, 0]], [[3, 1]], [[2, 0]]])
    z = np.concatenate([truth_values(np.random.default_rng(k), [t[k]], pairs[k]) for k in range(6)])
    start = imm.start(0.0, [700.0, 900.0], 100.0 * np.eye(2))
    track = imm.run(t, z, start=start, pairs=pairs)
    state = start
    for k in range(6):
        state = imm.step(state, t[k], z[k], pairs=pairs[k])
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


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bank": [Static(psd=0.0)]}, "bank: expected a Bank"),
        ({"measurement": TDOA}, "measurement: no measurement model"),
        ({"measurement": Static(psd=1.0)}, "measurement: no measurement model"),
        ({"update": "kf"}, "update: expected"),
        ({"robust": "huber"}, "robust: expected"),
        ({"gate_probability": 1.0}, "gate_probability: expected a probability"),
        ({"gate_probability": 0.0}, "gate_probability: expected a number above 0"),
        ({"gate_probability": np.nan}, "gate_probability: expected a finite number"),
        ({"gate_probability": "high"}, "gate_probability: expected one number"),
    ],
)
def test_bad_estimators(arguments, message):
    good = {"bank": Bank(KINDS), "measurement": TDOA(STATIONS, toa_sigma=SIGMA)}
    with pytest.raises(ValueError, match=message):
        IMM(**{**good, **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mean": [1.0, 2.0, 3.0]}, r"mean: expected 2 components \(position\) or 6 \(x, y, vx"),
        ({"mean": 1.0}, r"mean: expected shape \(\.\.\., n,\)"),
        ({"mean": [np.nan, 0.0]}, "mean: expected finite numbers"),
        ({"mean": ["a", "b"]}, "mean: expected numbers"),
        ({"covariance": np.eye(3)}, r"covariance: expected shape \(\.\.\., 2, 2\)"),
        ({"covariance": [[1.0, 0.5], [0.2, 1.0]]}, "covariance: expected a symmetric"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance: expected a positive semi-def"),
        ({"covariance": -np.eye(2)}, "covariance: a variance on its diagonal is negative"),
        ({"covariance": np.full((2, 2), np.inf)}, "covariance: expected finite"),
        ({"time": np.nan}, "time: expected finite"),
        ({"components": ["x", "vx"]}, "components: expected 2 of"),
        ({"components": ["x", "y", "vx"]}, "components: expected 2 of"),
        ({"components": ["x", "omega"]}, "components: expected 2 of"),
        ({"components": ["x", "x"]}, "components: expected 2 of"),
        (
            {"components": ["x", "y", "vx", "vx"], "mean": [0.0] * 4, "covariance": np.eye(4)},
            "components: expected 4 of",
        ),
        (
            {"mean": np.zeros((3, 2)), "covariance": np.tile(np.eye(2), (4, 1, 1))},
            r"batch axes do not fit together: mean \(3,\), covariance \(4,\), time \(\)",
        ),
    ],
)
def test_bad_starts(arguments, message):
    good = {"time": 0.0, "mean": [0.0, 0.0], "covariance": np.eye(2)}
    with pytest.raises(ValueError, match=message):
        imm_2d().start(**{**good, **arguments})


@pytest.mark.parametrize(
    ("time", "values", "message"),
    [
        (4.0, np.zeros(4), "time: expected a time at or after the state's, 5 s, got 4 s"),
        (np.nan, np.zeros(4), "time: expected finite"),
        (6.0, np.zeros(3), r"values: expected shape \(\.\.\., 4,\), got \(3,\)"),
        (6.0, 0.0, r"values: expected shape \(\.\.\., 4,\)"),
        (6.0, [0.0, np.inf, 0.0, 0.0], "values: infinite values are refused .* index 1"),
        (6.0, ["a"] * 4, "values: expected numbers"),
    ],
)
def test_bad_steps(time, values, message):
    imm = imm_2d()
    with pytest.raises(ValueError, match=message):
        imm.step(imm.start(5.0, [0.0, 0.0], np.eye(2)), time, values)


def test_a_state_of_another_bank_is_refused():
    other = IMM(Bank([Static(psd=0.0)]), Position(1.0)).start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="state: expected a state of this bank's modes"):
        imm_2d().step(other, 1.0, np.zeros(4))
    with pytest.raises(ValueError, match="start: expected a state of this bank's modes"):
        imm_2d().run([1.0], np.zeros((1, 4)), start=other)


def test_pairs_for_what_measures_no_pairs_are_refused():
    imm = IMM(Bank([Static(psd=0.0)]), Position(1.0))
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="pairs: Position does not measure station pairs"):
        imm.step(start, 0.0, [0.0, 0.0], pairs=[[1, 0], [2, 0]])


def test_unknown_stations_in_pairs_are_refused():
    imm = imm_2d()
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="pairs: station 7 does not exist"):
        imm.step(start, 1.0, [0.0], pairs=[[7, 0]])
    with pytest.raises(ValueError, match="pairs: station 7 does not exist"):
        imm.run([1.0, 2.0], np.zeros((2, 1)), start=start, pairs=[[[1, 0]], [[7, 0]]])


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([1.0, 0.5], np.zeros((2, 4)), r"times: .*times\[1\] = 0.5 s follows 1 s"),
        ([-1.0, 0.5], np.zeros((2, 4)), "times: expected a time at or after the start's, 0 s"),
        ([1.0, 2.0, 3.0], np.zeros((2, 4)), r"values: expected shape \(\.\.\., 3, 4\)"),
        ([1.0, 2.0], np.zeros((2, 5)), r"values: expected shape \(\.\.\., 2, 4\)"),
        ([], np.zeros((0, 4)), "times: expected at least one scan"),
    ],
)
def test_bad_runs(times, values, message):
    imm = imm_2d()
    with pytest.raises(ValueError, match=message):
        imm.run(times, values, start=imm.start(0.0, [0.0, 0.0], np.eye(2)))


def test_batches_that_do_not_fit_are_refused():
    imm = imm_2d()
    start = imm.start(0.0, np.zeros((3, 2)), np.eye(2))
    with pytest.raises(ValueError, match=r"batch axes .*: state \(3,\), time \(\), values \(5,\)"):
        imm.step(start, 1.0, np.zeros((5, 4)))
    with pytest.raises(ValueError, match=r"batch axes .*: start \(3,\), times and values \(5,\)"):
        imm.run([1.0], np.zeros((5, 1, 4)), start=start)
    with pytest.raises(ValueError, match="measurement: expected one in 2 dimensions, got 3"):
        imm.step(start, 1.0, np.zeros(3), measurement=Position(1.0, dims=3))


def test_an_unknown_engine_is_refused():
    imm = imm_2d()
    with pytest.raises(ValueError, match="engine: expected"):
        imm.run([1.0], np.zeros((1, 4)), start=imm.start(0, [0, 0], np.eye(2)), engine="steam")


def test_a_measurement_beyond_all_numbers_is_refused():
    imm = IMM(Bank([Static(psd=0.0)]), Position(1.0, dims=1))
    with pytest.raises(ValueError, match="at time 3 s no mode can explain the measurement"):
        imm.step(imm.start(3.0, [0.0], [[1.0]]), 3.0, [1e200])
