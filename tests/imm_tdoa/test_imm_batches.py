"""Many targets at once are those targets alone."""

from __future__ import annotations

import numpy as np
from imm_cases import CORNERS, SIGMA, arrivals, bank_of
from imm_oracles import C
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Stations
from imm_tdoa.models import FDOA, TDOA, Position, Stack


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
