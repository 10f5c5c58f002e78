"""Laws that every smoothed track obeys, special cases, and what is refused."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from smoothing_cases import BIRTH, assert_proper

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import (
    TDOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Static,
)
from imm_tdoa.smoothing import smooth
from imm_tdoa.testing import exact_posterior

CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [2e3, 2e3], [0.0, 2e3], [1e3, -9e2]])
SIGMA, C = 20e-9, 299_792_458.0
seeds = st.integers(0, 2**31)

# --- laws -----------------------------------------------------------------------------------------


def any_bank(rng, mixing="birth", **settings):
    kinds = [
        Static(psd=rng.choice([0.0, 0.5])),
        ConstantVelocity(psd=rng.choice([0.0, 1.0])),
        ConstantVelocity(std=1.0),
        ConstantAcceleration(psd=0.01),
        CoordinatedTurn(psd=0.1, turn_rate_psd=1e-3),
    ]
    r = rng.integers(2, 5)
    chosen = [kinds[j] for j in rng.permutation(len(kinds))[:r]]
    settings.setdefault("mean_sojourn", rng.uniform(2.0, 60.0))
    return Bank(chosen, mixing=mixing, birth_std=BIRTH, **settings)


def any_track(rng, imm, T=12, batch=()):
    t = np.cumsum(rng.choice([0.0, 0.2, 1.0, 5.0], size=T))
    path = np.array([700.0, 900.0]) + 300.0 * np.stack([np.cos(t / 40), np.sin(t / 40)], axis=-1)
    toa = np.linalg.norm(path[:, None] - CORNERS, axis=-1) / C
    toa = toa + SIGMA * rng.normal(size=(*batch, T, 5))
    values = toa[..., 1:] - toa[..., :1]
    values[rng.uniform(size=values.shape) < 0.2] = np.nan
    values[..., 4, :] = np.nan
    start = imm.start(0.0, path[0] + rng.normal(size=(*batch, 2)), 100.0 * np.eye(2))
    return t, values, imm.run(t, values, start=start)


@settings(deadline=None, max_examples=25)
@given(
    seed=seeds,
    mixing=st.sampled_from(["birth", "unbiased", "zero"]),
    update=st.sampled_from(["ekf", "ukf", "iekf"]),
    method=st.sampled_from(["pairwise", "kim"]),
)
def test_any_bank_smooths_to_something_proper(seed, mixing, update, method):
    rng = np.random.default_rng(seed)
    imm = IMM(any_bank(rng, mixing), TDOA(Stations(CORNERS), toa_sigma=SIGMA), update=update)
    _, _, track = any_track(rng, imm)
    smoothed = smooth(track, method)
    assert_proper(smoothed)
    assert smoothed.smoothed
    assert not track.smoothed
    for name in ("mean", "covariance", "log_mode_probability"):
        last = getattr(track, name)[-1]
        assert_allclose(getattr(smoothed, name)[-1], last, rtol=1e-12, atol=1e-12)
    for name in ("times", "log_likelihood", "nis", "nis_dof", "mode_log_likelihood"):
        assert_array_equal(getattr(smoothed, name), getattr(track, name))


@settings(deadline=None, max_examples=10)
@given(seed=seeds, mixing=st.sampled_from(["birth", "unbiased", "zero"]))
def test_the_order_of_modes_is_nothing(seed, mixing):
    rng = np.random.default_rng(seed)
    r = 3
    models = [Static(psd=0.5), ConstantVelocity(psd=1.0), CoordinatedTurn(psd=0.1)]
    Pi, prior = rng.dirichlet(np.ones(r), size=r), rng.dirichlet(np.ones(r))
    order = rng.permutation(r)
    measurement = TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    shared = {"mixing": mixing, "birth_std": BIRTH}
    imm = IMM(Bank(models, transition=Pi, prior=prior, **shared), measurement)
    t, values, _ = any_track(rng, imm)
    other = IMM(
        Bank(
            [models[j] for j in order],
            transition=Pi[np.ix_(order, order)],
            prior=prior[order],
            **shared,
        ),
        measurement,
    )
    x0, P0 = np.array([1000.0, 900.0]), 100.0 * np.eye(2)
    a = smooth(imm.run(t, values, start=imm.start(0.0, x0, P0)))
    b = smooth(other.run(t, values, start=other.start(0.0, x0, P0)))
    assert_allclose(a.mode_probability[:, order], b.mode_probability, rtol=1e-6, atol=1e-9)
    assert_allclose(a.mean, b.mean, rtol=1e-6, atol=1e-6)
    assert_allclose(a.covariance, b.covariance, rtol=1e-5, atol=1e-6)


@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_identical_modes_are_one(seed):
    rng = np.random.default_rng(seed)
    model, measurement = ConstantVelocity(psd=1.0), TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    one = IMM(Bank([model]), measurement)
    three = IMM(Bank([model] * 3, transition=rng.dirichlet(np.ones(3), size=3)), measurement)
    t, values, _ = any_track(rng, one)
    start = [imm.start(0.0, [1000.0, 900.0], 100.0 * np.eye(2)) for imm in (one, three)]
    a, b = smooth(one.run(t, values, start=start[0])), smooth(three.run(t, values, start=start[1]))
    assert_allclose(b.mean, a.mean, rtol=1e-7, atol=1e-6)
    assert_allclose(b.covariance, a.covariance, rtol=1e-6, atol=1e-6)


@settings(deadline=None, max_examples=6)
@given(seed=seeds, update=st.sampled_from(["ekf", "ukf"]))
def test_a_batch_is_its_targets(seed, update):
    rng = np.random.default_rng(seed)
    bank, measurement = any_bank(rng), TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    imm = IMM(bank, measurement, update=update)
    t = np.cumsum(rng.choice([0.0, 1.0, 2.0], size=(2, 3, 9)), axis=-1)
    values = np.stack([any_track(rng, imm, T=9)[1] for _ in range(6)]).reshape(2, 3, 9, 4)
    mean = np.array([1000.0, 900.0]) + rng.normal(size=(2, 3, 2))
    batch = smooth(imm.run(t, values, start=imm.start(0.0, mean, 100.0 * np.eye(2))))
    for b in np.ndindex(2, 3):
        start = imm.start(0.0, mean[b], 100.0 * np.eye(2))
        one = smooth(imm.run(t[b], values[b], start=start))
        assert_allclose(batch.mean[b], one.mean, rtol=1e-7, atol=1e-6)
        assert_allclose(batch.mode_probability[b], one.mode_probability, rtol=1e-6, atol=1e-9)
        for P, Q in zip(batch.mode_covariances, one.mode_covariances, strict=True):
            assert_allclose(P[b], Q, rtol=1e-5, atol=1e-6)


def test_targets_that_start_later_stay_absent_until_then():
    rng = np.random.default_rng(8)
    imm = IMM(any_bank(rng), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    t, values, _ = any_track(rng, imm, batch=(3,))
    values[:, :3] = values[0, 5]
    values[1, :3] = np.nan
    track = imm.run(t, values)
    smoothed = smooth(track)
    absent = np.isnan(track.log_likelihood)
    assert absent.any()
    assert not absent.all()
    assert_array_equal(np.isnan(smoothed.mean).all(axis=-1), absent)
    assert_array_equal(np.isnan(smoothed.log_mode_probability).all(axis=-1), absent)
    alone = smooth(imm.run(t, values[1]))
    rows = np.flatnonzero(~absent[1])
    assert_allclose(smoothed.mean[1, rows], alone.mean, rtol=1e-9, atol=1e-8)
    assert_allclose(smoothed.covariance[1, rows], alone.covariance, rtol=1e-7, atol=1e-8)


@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_rows_of_one_instant_may_come_as_one_scan_or_several(seed):
    rng = np.random.default_rng(seed)
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)],
        mean_sojourn=5.0,
        birth_std=BIRTH,
    )
    imm = IMM(bank, Position([1.0, 2.0, 0.5], dims=3))
    t, z = np.cumsum(rng.choice([1.0, 3.0], size=8)), 4.0 * rng.normal(size=(8, 3))
    start = imm.start(0.0, np.zeros(3), 9.0 * np.eye(3))
    together = smooth(imm.run(t, z, start=start))
    apart = np.full((16, 3), np.nan)
    apart[::2, :2], apart[1::2, 2] = z[:, :2], z[:, 2]
    pieces = smooth(imm.run(np.repeat(t, 2), apart, start=start))
    for rows in (slice(0, None, 2), slice(1, None, 2)):
        assert_allclose(pieces.mean[rows], together.mean, rtol=1e-7, atol=1e-7)
        assert_allclose(pieces.covariance[rows], together.covariance, rtol=1e-6, atol=1e-7)
        got, want = pieces.mode_probability[rows], together.mode_probability
        assert_allclose(got, want, rtol=1e-6, atol=1e-9)


def test_rows_without_data_change_nothing_for_one_mode():
    rng = np.random.default_rng(9)
    imm = IMM(Bank([ConstantAcceleration(psd=0.1)]), Position(1.0))
    t, z = np.arange(1.0, 13.0), rng.normal(size=(12, 2))
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    plain = smooth(imm.run(t, z, start=start))
    more = np.full((24, 2), np.nan)
    more[1::2] = z
    times = np.sort(np.concatenate([t, t - 0.37]))
    pieces = smooth(imm.run(times, more, start=start))
    assert_allclose(pieces.mean[1::2], plain.mean, rtol=1e-9, atol=1e-9)
    assert_allclose(pieces.covariance[1::2], plain.covariance, rtol=1e-8, atol=1e-9)


# --- special cases --------------------------------------------------------------------------------


def test_nothing_flows_back_across_a_reopened_row():
    rng = np.random.default_rng(10)
    imm = IMM(any_bank(rng), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    t, values, _ = any_track(rng, imm, batch=(2,))
    start = imm.start(0.0, [[1000.0, 900.0]] * 2, 100.0 * np.eye(2))
    track = imm.run(t, values, start=start)
    reopened = np.array([np.arange(12) == 7, np.zeros(12, dtype=bool)])
    smoothed = smooth(attrs.evolve(track, reopened=reopened))
    before, whole = smooth(imm.run(t[:7], values[:, :7], start=start)), smooth(track)
    for name in ("mean", "covariance", "log_mode_probability"):
        got = getattr(smoothed, name)
        assert_allclose(got[0, :7], getattr(before, name)[0], rtol=1e-9, atol=1e-9)
        assert_array_equal(got[0, 6], getattr(track, name)[0, 6])
        assert_array_equal(got[0, 7:], getattr(whole, name)[0, 7:])
        assert_array_equal(got[1], getattr(whole, name)[1])


def test_modes_that_cannot_be_reached_stay_out():
    bank = Bank(
        [Static(psd=0.1), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)],
        transition=[[0.9, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        prior=[1.0, 0.0, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    start = imm.start(0.0, [0.0], [[1.0]])
    t, z = np.arange(1.0, 7.0), np.array([[0.0], [0.2], [3.0], [7.0], [11.0], [15.0]])
    smoothed = smooth(imm.run(t, z, start=start))
    assert_proper(smoothed)
    assert_array_equal(smoothed.mode_probability[:, 2], 0.0)
    exact = exact_posterior(bank, imm.measurement, start, t, z).smoothed
    assert_allclose(smoothed.mode_probability, exact.mode_probability, atol=0.05)
    assert_array_equal(np.diff(smoothed.mode_probability[:, 0]) <= 1e-12, True)


def test_models_in_parallel_keep_their_final_probability():
    """With no switching, which model it was is one question, answered by all scans."""
    rng = np.random.default_rng(11)
    models = [Static(psd=0.5), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)]
    bank, measurement = Bank(models, birth_std=BIRTH), TDOA(Stations(CORNERS), toa_sigma=SIGMA)
    imm = IMM(bank, measurement, merging="autonomous")
    t, values, _ = any_track(rng, imm)
    start = imm.start(0.0, [1000.0, 900.0], 400.0 * np.eye(2))
    smoothed = smooth(imm.run(t, values, start=start))
    last = np.broadcast_to(smoothed.mode_probability[-1], smoothed.mode_probability.shape)
    assert_allclose(smoothed.mode_probability, last, rtol=1e-9)
    for j, model in enumerate(models):
        alone = IMM(Bank([model], birth_std=BIRTH), measurement)
        own = smooth(
            alone.run(t, values, start=alone.start(0.0, [1000.0, 900.0], 400.0 * np.eye(2)))
        )
        assert_allclose(smoothed.mode_means[j], own.mean, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("method", ["pairwise", "kim"])
def test_predictions_without_variance(method):
    """Zero padding and no process noise: each mode predicts singularly, in its own directions."""
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
        mean_sojourn=5.0,
        mixing="zero",
        birth_std={"velocity": 0.0, "acceleration": 0.0},
    )
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [0.0], [[0.0]])
    z = np.array([[0.1], [-0.4], [0.8], [np.nan], [0.2]])
    smoothed = smooth(imm.run(np.arange(1.0, 6.0), z, start=state), method)
    assert_proper(smoothed)
    assert_allclose(smoothed.mean, 0.0, atol=1e-12)
    track = imm.run(np.arange(1.0, 6.0), z, start=imm.start(0.0, [0.0], [[4.0]]))
    assert_proper(smooth(track, method))


def test_refusals():
    imm = IMM(Bank([Static(psd=1.0)]), Position(1.0))
    track = imm.run([0.0, 1.0], [[0.0, 0.0], [1.0, 1.0]])
    with pytest.raises(ValueError, match="track: it is smoothed already"):
        smooth(smooth(track))
    with pytest.raises(ValueError, match="method: expected 'pairwise' or 'kim', got 'rts'"):
        smooth(track, "rts")
    with pytest.raises(ValueError, match="track: expected a Track"):
        smooth([1.0])
