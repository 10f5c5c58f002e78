"""Gross errors: which sources of error are left out or trusted less, and what that costs."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from imm_oracles import log_normal, mixture_moments
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from imm_tdoa import IMM, Bank, Stations, gaussian, robust
from imm_tdoa.models import TDOA, TOA, ConstantVelocity, Position, Static
from imm_tdoa.observation import Observation, observe, with_sources, without_offsets

C = 299_792_458.0
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
STATIONS = Stations(CORNERS)
P0 = np.array([700.0, 900.0])
SIGMA = 1e-8
HERE, NONE = np.arange(2), np.arange(0)
SPREAD = [25.0 * np.eye(2)]
GROUPS = st.lists(st.sampled_from([-1, 0, 1]), min_size=2, max_size=6)
seeds = st.integers(0, 2**32 - 1)


def spd(rng, n):
    A = rng.normal(size=(n, n + 2))
    return A @ A.T


def judged(nu, S, present, group, directions=None):
    """An innovation of one mode as the gate sees it."""
    m = len(group)
    D = np.eye(m) if directions is None else directions
    H = np.zeros((*nu.shape, 1))
    variance = np.ones(D.shape[-1])
    return Observation((nu,), (H,), (S,), present, np.asarray(group), D, variance)


def read(nu, S, present, group, threshold, directions=None):
    seen = judged(nu, S, present, group, directions)
    return robust.gate(seen, np.zeros(1), [np.zeros((1, 1))], threshold)


def kept_rows(nu, S, present, group, threshold):
    return read(nu, S, present, group, threshold).row_weight == 1.0


@pytest.fixture
def decided(monkeypatch):
    """No source is let go because it might be the bad one."""
    monkeypatch.setattr(robust, "AMBIGUOUS", 1e-9)


def projected_precision(S, present, group):
    """Inverse of S over the present rows, what shared offsets could explain projected out."""
    keep = np.flatnonzero(present)
    W = np.zeros_like(S)
    if len(keep) == 0:
        return W
    inverse = np.linalg.inv(S[np.ix_(keep, keep)])
    A = np.stack([group[keep] == g for g in (0, 1) if np.any(group[keep] == g)] or [[]], axis=-1)
    A = np.asarray(A, dtype=float).reshape(len(keep), -1)
    if A.size:
        inverse = inverse - inverse @ A @ np.linalg.inv(A.T @ inverse @ A) @ A.T @ inverse
    W[np.ix_(keep, keep)] = inverse
    return W


def against(measurement, values, place=(702.0, 899.0)):
    x, z = np.array(place), np.asarray(values)
    seen = observe(measurement, [x], [HERE], [NONE], 0.0, z)
    return with_sources(seen, measurement, x, HERE, NONE, 0.0, z)


def arrivals(**gross):
    z = np.linalg.norm(P0 - CORNERS, axis=1) / C
    for station, error in gross.items():
        z[int(station[1:])] += error
    return z


@settings(
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=seeds, group=GROUPS, data=st.data())
@pytest.mark.usefixtures("decided")
def test_snooping_is_leave_one_out(seed, group, data):
    """The statistic of a row is the drop of the NIS without it, offsets free; worst row first."""
    m = len(group)
    present = np.array(data.draw(st.lists(st.booleans(), min_size=m, max_size=m)))
    group = np.array(group)
    rng = np.random.default_rng(seed)
    S, nu = spd(rng, m), rng.normal(size=m)
    nu = np.where(present, nu * 10.0 ** rng.uniform(0, 1.5, m), 0.0)
    threshold = 6.0
    kept = present.copy()

    def nis(rows):
        return float(nu @ projected_precision(S, rows, group) @ nu)

    while True:
        drop = np.full(m, -np.inf)
        for i in np.flatnonzero(kept):
            without = kept.copy()
            without[i] = False
            drop[i] = nis(kept) - nis(without)
        if not kept.any() or drop.max() <= threshold * (1 + 1e-9):
            break
        rivals = np.flatnonzero(drop > drop.max() * (1 - 1e-9))
        kept[rivals[0]] = False
    got = kept_rows(nu, S, present, group, threshold)
    assert_array_equal(without_lone_rows(got, group), without_lone_rows(kept, group))


def without_lone_rows(rows, group):
    """Of two rows with a shared offset either may go: the other says nothing any more."""
    lone = [g for g in (0, 1) if np.count_nonzero(rows & (group == g)) == 1]
    return rows & ~np.isin(group, lone)


def test_snooping_leaves_a_lone_row_of_a_group_in_peace():
    S, group = np.diag([1.0, 1.0, 1.0]), np.array([0, 0, -1])
    present = np.array([True, False, True])
    assert_array_equal(kept_rows(np.array([1e6, 0.0, 0.5]), S, present, group, 10.0), present)


def test_snooping_judges_each_element_of_a_batch_by_itself():
    rng = np.random.default_rng(3)
    S = spd(rng, 4)
    nu = np.linalg.cholesky(S) @ rng.normal(size=(4, 50))
    nu[2, :25] += 30.0 * np.sqrt(S[2, 2])
    group, present = np.full(4, -1), np.ones((50, 4), dtype=bool)
    whole = kept_rows(nu.T, np.broadcast_to(S, (50, 4, 4)), present, group, 10.8)
    for b in range(50):
        assert_array_equal(whole[b], kept_rows(nu[:, b], S, present[b], group, 10.8))
    assert not whole[:25, 2].any()


@pytest.mark.parametrize("m", [3, 4, 6])
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.usefixtures("decided")
def test_a_source_left_out_is_as_if_nothing_were_known_of_its_error(seed, m):
    """Eliminating an error along d gives what a huge variance along d gives."""
    rng = np.random.default_rng(seed)
    S, nu = spd(rng, m), rng.normal(size=m)
    directions = rng.normal(size=(m, 1))
    nu = nu + 1e3 * directions[:, 0]
    present, group = np.ones(m, dtype=bool), np.full(m, -1)
    reading = read(nu, S, present, group, 1e3, directions)
    assert np.count_nonzero(reading.present) == m - 1
    assert not np.any(reading.row_weight == 1.0)
    left, T = reading.present, reading.combine
    reduced = T[left] @ nu
    want = np.linalg.inv(S)
    for d in directions.T:
        Wd = want @ d
        want = want - np.outer(Wd, Wd) / (d @ Wd)
    R = T[left] @ S @ T[left].T
    assert_allclose(reduced @ np.linalg.solve(R, reduced), nu @ want @ nu, rtol=1e-6, atol=1e-6)
    assert_allclose(np.linalg.det(T), 1.0, rtol=1e-9)


def test_several_modes_decide_by_the_evidence_of_them_all():
    """Gain by brute force: the mixture's likelihood without each row, and the row on the gate."""
    rng = np.random.default_rng(4)
    threshold, weight = 8.0, np.array([0.9, 0.1])
    for _ in range(30):
        S = [spd(rng, 3), 40.0 * spd(rng, 3)]
        nu = [20.0 ** rng.uniform(-1, 1) * rng.normal(size=3) for _ in range(2)]
        m, C = mixture_moments(weight, nu, S)

        def log_l(keep, nu=nu, S=S):
            parts = [log_normal(n[keep], s[np.ix_(keep, keep)]) for n, s in zip(nu, S, strict=True)]
            return np.logaddexp.reduce(np.log(weight) + np.array(parts))

        def gate_price(i, C=C):
            conditional = 1.0 / np.linalg.inv(C)[i, i]
            return -0.5 * (threshold + np.log(2 * np.pi * conditional))

        every = np.arange(3)
        want = [log_l(np.delete(every, i)) + gate_price(i) - log_l(every) for i in every]
        group, D, H = np.full(3, -1), np.eye(3), np.zeros((3, 1))
        parts = [*zip(nu, S, strict=True), (m, C)]
        present = np.ones(3, dtype=bool)
        got = robust._gain(
            [robust._judge(n, s, present, D) for n, s in parts], np.log(weight), threshold
        )
        assert_allclose(got, want, rtol=1e-8, atol=1e-8)
        seen = Observation(tuple(nu), (H, H), tuple(S), present, group, D, np.ones(3))
        kept = robust.gate(seen, np.log(weight), [np.zeros((1, 1))] * 2, threshold).row_weight
        assert np.all(kept == 1.0) == (np.max(want) <= 0.0)


def test_where_one_of_several_is_bad_and_none_can_be_told_all_go():
    """Three differences and nothing known of the position: one spare, any of them could be it."""
    tdoa = TDOA(STATIONS, tdoa_sigma=SIGMA, pairs=[[1, 0], [2, 0], [3, 0]])
    z = tdoa.predict(P0, np.zeros(2), 0.0) / C
    z[1] += 1e-6
    wide = robust.gate(against(tdoa, z), np.zeros(1), [1e8 * np.eye(2)], 10.83)
    assert_array_equal(wide.row_weight, 0.0)
    assert wide.rejected
    narrow = robust.gate(against(tdoa, z), np.zeros(1), SPREAD, 10.83)
    assert_array_equal(narrow.row_weight, [1.0, 0.0, 1.0])


@pytest.mark.parametrize("corrupted", range(5))
def test_the_gate_finds_one_bad_arrival_behind_an_unknown_emission_time(corrupted):
    """Its error spreads over all residuals; snooping still names the station."""
    z = arrivals(**{f"s{corrupted}": 2e-6}) + 4.56
    reading = robust.gate(against(TOA(STATIONS, sigma=SIGMA), z), np.zeros(1), SPREAD, 10.83)
    assert_array_equal(reading.row_weight, (np.arange(5) != corrupted).astype(float))
    assert not reading.rejected


def test_the_gate_finds_one_bad_difference_among_correlated_ones():
    """Rows that share station 0 are correlated by half; the others stay."""
    tdoa = TDOA(STATIONS, toa_sigma=SIGMA)
    clean = tdoa.predict(P0, np.zeros(2), 0.0) / C
    for row in range(4):
        z = clean.copy()
        z[row] += 1e-6
        kept = robust.gate(against(tdoa, z), np.zeros(1), SPREAD, 10.83).present
        assert_array_equal(kept, np.arange(4) != row)


def test_the_gates_statistic_is_the_loss_of_nis():
    """Leave each station out of a TOA scan: the row whose absence helps most is dropped."""
    rng = np.random.default_rng(2)
    toa = TOA(STATIONS, sigma=SIGMA)
    P = np.array([[30.0, 5.0], [5.0, 20.0]])
    for _ in range(20):
        z = arrivals() + 2e-8 * rng.normal(size=5)

        def nis(rows, z=z):
            seen = without_offsets(against(toa, np.where(rows, z, np.nan), P0))
            nu, H, R = gaussian.mask_rows(seen.nu[0], seen.H[0], seen.R[0], seen.present)
            return float(nu @ np.linalg.solve(H @ P @ H.T + R, nu))

        every = np.ones(5, dtype=bool)
        loss = np.array([nis(every) - nis(np.arange(5) != i) for i in range(5)])
        for threshold in (0.999 * loss.max(), 1.001 * loss.max()):
            reading = robust.gate(against(toa, z, P0), np.zeros(1), [P], threshold)
            kept = reading.row_weight == 1.0
            assert kept[np.argmax(loss)] == (threshold > loss.max())


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
