"""The gate of the IMM: what it drops, at which price, how often, and by whose prediction."""

from __future__ import annotations

import numpy as np
import pytest
from imm_cases import BIRTH, CORNERS, KINDS, SIGMA, STATIONS, truth_values
from imm_oracles import C, mixture_moments, pair_covariance, range_differences
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from imm_tdoa import IMM, Bank
from imm_tdoa.models import TDOA, TOA, ConstantVelocity, Position, Static


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
