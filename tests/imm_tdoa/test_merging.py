"""How hypotheses are merged: GPB1, GPB2, IMM and nothing at all (ALGORITHMS §9.4, §14.1)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import Mode, exact
from numpy.testing import assert_allclose

from imm_tdoa import IMM, Bank
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Position, Static

Z = [0.5, 1.1, 1.8, 2.4]
PI = np.array([[0.95, 0.05], [0.1, 0.9]])
COLUMNS = {
    "gpb2": [
        (0.7866390984, -2.18038616),
        (0.8265765989, -3.79151223),
        (0.8477726556, -5.38598605),
        (0.8683568844, -6.87632440),
    ],
    "gpb1": [
        (0.7866390984, -2.18038616),
        (0.7871649391, -3.83532114),
        (0.7871021815, -5.50576775),
        (0.7896769775, -7.10183454),
    ],
}
MERGING = ("imm", "gpb1", "gpb2", "autonomous")
seeds = st.integers(0, 2**32 - 1)


def two_modes(merging: str) -> IMM:
    bank = Bank(
        [ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)], transition=PI, prior=[0.8, 0.2]
    )
    return IMM(bank, Position(1.0, dims=1), merging=merging)


def golden(merging: str):
    imm = two_modes(merging)
    start = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    return imm.run(np.arange(1.0, 5.0), np.array(Z)[:, None], start=start)


@pytest.mark.parametrize("merging", COLUMNS)
def test_golden_columns(merging):
    track = golden(merging)
    mu, log_l = np.array(COLUMNS[merging]).T
    assert_allclose(track.mode_probability[:, 0], mu, atol=1e-10)
    assert_allclose(track.log_likelihood, log_l, atol=1e-8)


def test_the_autonomous_bank_is_its_models_in_parallel():
    """Probabilities are prior times evidence; every model is as it would be alone."""
    together = golden("autonomous")
    evidence = []
    for j, model in enumerate(two_modes("imm").bank.models):
        imm = IMM(Bank([model]), Position(1.0, dims=1))
        alone = imm.run(
            np.arange(1.0, 5.0),
            np.array(Z)[:, None],
            start=imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0])),
        )
        assert_allclose(together.mode_means[j], alone.mode_means[0], rtol=1e-13)
        assert_allclose(together.mode_covariances[j], alone.mode_covariances[0], rtol=1e-13)
        assert_allclose(np.cumsum(together.mode_log_likelihood[:, j]), alone.log_likelihood)
        assert_allclose(together.mode_nis[:, j], alone.nis, rtol=1e-12)
        evidence.append(alone.log_likelihood)
    log_joint = np.log([0.8, 0.2]) + np.stack(evidence, axis=-1)
    total = np.logaddexp.reduce(log_joint, axis=-1)
    assert_allclose(together.log_mode_probability, log_joint - total[:, None], atol=1e-12)
    assert_allclose(together.log_likelihood, total, rtol=1e-12)


def test_the_identity_chain_is_the_autonomous_bank():
    bank = two_modes("imm").bank
    imm = IMM(Bank(bank.models, transition=np.eye(2), prior=bank.prior), Position(1.0, dims=1))
    start = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    track = imm.run(np.arange(1.0, 5.0), np.array(Z)[:, None], start=start)
    want = golden("autonomous")
    assert_allclose(track.mean, want.mean, rtol=1e-12)
    assert_allclose(track.log_likelihood, want.log_likelihood, rtol=1e-12)


@settings(deadline=None, max_examples=25)
@given(seed=seeds, merging=st.sampled_from(MERGING))
def test_one_mode_is_the_plain_filter_however_merged(seed, merging):
    rng = np.random.default_rng(seed)
    z, times = rng.normal(size=(8, 2)), np.cumsum(rng.uniform(0.0, 2.0, 8))
    tracks = []
    for how in ("imm", merging):
        imm = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(1.0, dims=2), merging=how)
        start = imm.start(0.0, [0.0, 0.0], np.eye(2))
        tracks.append(imm.run(times, z, start=start, engine="numpy"))
    assert np.array_equal(tracks[0].mean, tracks[1].mean)
    assert np.array_equal(tracks[0].covariance, tracks[1].covariance)


@settings(deadline=None, max_examples=25)
@given(seed=seeds, merging=st.sampled_from(MERGING))
def test_identical_modes_are_the_plain_filter_however_merged(seed, merging):
    rng = np.random.default_rng(seed)
    z, times = rng.normal(size=(8, 2)), np.cumsum(rng.uniform(0.0, 2.0, 8))
    plain = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(1.0, dims=2))
    three = IMM(
        Bank([ConstantVelocity(psd=1.0)] * 3, prior=[0.5, 0.3, 0.2], mean_sojourn=[3.0, 9.0, 1.0]),
        Position(1.0, dims=2),
        merging=merging,
    )
    x, P = np.zeros(4), np.diag([1.0, 1.0, 9.0, 9.0])
    one = plain.run(times, z, start=plain.start(0.0, x, P))
    many = three.run(times, z, start=three.start(0.0, x, P))
    assert_allclose(many.mean, one.mean, atol=1e-11)
    assert_allclose(many.covariance, one.covariance, atol=1e-11)
    assert_allclose(many.log_likelihood, one.log_likelihood, atol=1e-10)


@settings(deadline=None, max_examples=25)
@given(seed=seeds, merging=st.sampled_from(MERGING))
def test_a_second_scan_at_the_same_instant_merges_nothing(seed, merging):
    """Two sensors at one time: as one stacked scan; a step of no length changes nothing."""
    rng = np.random.default_rng(seed)
    bank = Bank([Static(psd=0.1), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=1.0)])
    imm = IMM(bank, Position(1.0, dims=2), merging=merging)
    state = imm.step(imm.start(0.0, [0.0, 0.0], np.eye(2)), 1.0, rng.normal(size=2))
    still = imm.step(state, 1.0, [np.nan, np.nan])
    assert_allclose(still.mean, state.mean, atol=1e-13)
    assert_allclose(still.covariance, state.covariance, atol=1e-11)
    assert_allclose(still.mode_probability, state.mode_probability, atol=1e-14)
    z = rng.normal(size=2)
    rows = imm.step(imm.step(state, 1.0, [z[0], np.nan]), 1.0, [np.nan, z[1]])
    both = imm.step(state, 1.0, z)
    assert_allclose(rows.mean, both.mean, atol=1e-10)
    assert_allclose(rows.mode_probability, both.mode_probability, atol=1e-11)
    assert_allclose(rows.log_likelihood, both.log_likelihood, atol=1e-10)


@pytest.mark.parametrize("merging", MERGING)
def test_unreachable_modes_do_no_harm(merging):
    """A mode of probability zero that no mode leads to keeps its own state, weight zero."""
    bank = Bank(
        [ConstantVelocity(psd=1.0), ConstantAcceleration(psd=1.0), Static(psd=1.0)],
        transition=[[0.9, 0.1, 0.0], [0.1, 0.9, 0.0], [0.0, 0.0, 1.0]],
        prior=[1.0, 0.0, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=2), merging=merging)
    track = imm.run(
        np.arange(1.0, 9.0), np.ones((8, 2)), start=imm.start(0.0, [0.0, 0.0], np.eye(2))
    )
    assert np.all(np.isfinite(track.mean))
    assert np.all(track.mode_probability[:, 2] == 0.0)
    assert_allclose(track.mode_probability.sum(axis=-1), 1.0, rtol=1e-12)
    assert all(np.all(np.isfinite(x)) for x in track.mode_means)


def test_the_order_of_the_approximations():
    """Mode probabilities against exact enumeration: GPB2 beats IMM beats GPB1, on average."""
    g, F = np.array([0.5, 1.0]), np.array([[1.0, 1.0], [0.0, 1.0]])
    modes = [
        Mode(("x", "vx"), lambda dt: F, lambda dt, q=q: q * np.outer(g, g)) for q in (0.01, 4.0)
    ]
    rng, runs, steps = np.random.default_rng(5), 40, 6
    m = np.zeros((runs, steps), dtype=int)
    x, z = np.zeros((runs, 2)), np.zeros((runs, steps))
    x += rng.normal(size=(runs, 2)) * np.sqrt([10.0, 1.0])
    now = (rng.random(runs) > 0.8).astype(int)
    for k in range(steps):
        now = (rng.random(runs) > PI[now, 0]).astype(int)
        x = x @ F.T + np.where(now, 2.0, 0.1)[:, None] * rng.normal(size=(runs, 1)) * g
        m[:, k], z[:, k] = now, x[:, 0] + rng.normal(size=runs)
    H, P0 = np.array([[1.0, 0.0]]), np.diag([10.0, 1.0])
    want = np.array(
        [exact(modes, [0.8, 0.2], PI, np.zeros(2), P0, row, H, np.eye(1))[0] for row in z]
    )
    error = {}
    for merging in ("gpb1", "imm", "gpb2"):
        imm = two_modes(merging)
        start = imm.start(0.0, np.zeros((runs, 2)), P0)
        track = imm.run(np.arange(1.0, steps + 1), z[..., None], start=start)
        error[merging] = np.abs(track.mode_probability - want).mean()
    assert error["gpb2"] < 0.6 * error["imm"]
    assert error["imm"] < 0.6 * error["gpb1"]
