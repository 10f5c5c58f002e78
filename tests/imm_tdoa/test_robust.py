"""Gross errors in one scan: which sources of error are left out, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from imm_oracles import log_normal, mixture_moments
from numpy.testing import assert_allclose, assert_array_equal
from robust_cases import P0, SIGMA, SPREAD, STATIONS, C, against, arrivals, seeds, spd

from imm_tdoa import gaussian, robust
from imm_tdoa.models import TDOA, TOA
from imm_tdoa.observation import Observation, without_offsets

GROUPS = st.lists(st.sampled_from([-1, 0, 1]), min_size=2, max_size=6)


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
