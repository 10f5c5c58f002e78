"""JPDA against enumeration, against the textbook's one-target filter, and in its limits."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2, multivariate_normal, norm

from imm_tdoa import gaussian
from imm_tdoa.tracking import Jpda, Nearest, Prediction, Unlabelled, soft_update

PD, PG = 0.9, 0.999
GATE = chi2.ppf(PG, 1)


def spd(rng, *shape):
    A = rng.normal(size=shape)
    return A @ np.swapaxes(A, -1, -2) + np.eye(shape[-1])


@st.composite
def one_station(draw):
    """Up to 4 targets and 4 values at one station, two modes."""
    N, L = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    number = st.floats(-6.0, 6.0)
    mean = draw(arrays(float, (N, 2, 1), elements=number))
    S = draw(arrays(float, (N, 2, 1, 1), elements=st.floats(0.5, 9.0)))
    first = draw(arrays(float, N, elements=st.floats(0.05, 0.95)))
    w = np.stack([first, 1.0 - first], axis=-1)
    values = draw(arrays(float, L, elements=number))
    return mean, S, w, values, draw(st.floats(1e-3, 1.0))


@settings(deadline=None, max_examples=80)
@given(one_station())
def test_one_station_equals_exhaustive_enumeration(case):
    """Shares, mode likelihood ratios and moments from the list of all events and modes."""
    mean, S, w, values, clutter = case
    N, L = len(mean), len(values)
    prediction = Prediction(mean, S, log_weight=np.log(w))
    got = Jpda(PD, clutter, gate_probability=PG)(
        prediction, Unlabelled(values, np.zeros(L, dtype=int))
    )
    middle, whole = prediction.bank()
    gated = (values - middle) ** 2 / whole[:, 0] <= GATE
    factor = np.full((N, 2, L + 1), 1.0 - PD * PG)
    density = norm.pdf(values, mean, np.sqrt(S[..., 0]))
    factor[..., :L] = PD * density * gated[:, None] / clutter
    beta, ratio = np.zeros((N, 2, L + 1)), np.zeros((N, 2))
    world = np.zeros(N)
    for event in product(range(L + 1), repeat=N):
        used = [k for k in event if k < L]
        if len(set(used)) < len(used):
            continue
        bank = np.einsum("nj,nj->n", w, factor[np.arange(N), :, event])
        for n, k in enumerate(event):
            others = np.prod(np.delete(bank, n))
            beta[n, :, k] += factor[n, :, k] * others
            if k == L:
                world[n] += others
    ratio = beta.sum(axis=-1)
    assert_allclose(got.log_likelihood_ratio, np.log(ratio / world[:, None]), atol=1e-8)
    share = np.einsum("nj,njk->nk", w, beta)
    share /= share.sum(axis=-1, keepdims=True)
    assert_allclose(got.weight, share[:, :L], rtol=1e-8, atol=1e-12)
    assert_allclose(got.missed[:, 0], share[:, L], rtol=1e-8, atol=1e-9)
    beta /= ratio[..., None]
    nu = values - mean
    combined = np.sum(beta[..., :L] * nu, axis=-1)
    spread = np.sum(beta[..., :L] * nu**2, axis=-1) - combined**2
    assert_allclose(got.innovation[..., 0], combined, atol=1e-9)
    assert_allclose(
        got.covariance[..., 0, 0], beta[..., L] * S[..., 0, 0] + spread, atol=1e-8, rtol=1e-9
    )


def test_one_target_is_the_textbook_filter():
    """PDA (Bar-Shalom & Tse 1975): combined innovation, spread term, and covariance by hand."""
    rng = np.random.default_rng(0)
    x, P, H, R = rng.normal(size=4), spd(rng, 4, 4), rng.normal(size=(1, 4)), np.array([[0.7]])
    S = H @ P @ H.T + R
    z = H @ x + np.sqrt(S[0, 0]) * np.array([0.5, -1.1, 2.0])
    clutter = 0.05
    got = Jpda(PD, clutter, gate_probability=PG)(
        Prediction((H @ x)[None], S[None]), Unlabelled(z, [0, 0, 0])
    )
    nu = z - H @ x
    e = np.exp(-0.5 * nu**2 / S[0, 0])
    b = clutter * np.sqrt(2 * np.pi * S[0, 0]) * (1 - PD * PG) / PD
    beta, none = e / (b + e.sum()), b / (b + e.sum())
    assert_allclose(got.weight[0], beta, rtol=1e-12)
    K = P @ H.T / S
    combined = beta @ nu
    P_c = P - K @ S @ K.T
    spread = K @ K.T * (beta @ nu**2 - combined**2)
    x_after, P_after = soft_update(x, P, H, R, got.innovation[0, 0], got.covariance[0, 0])
    assert_allclose(x_after, x + K[:, 0] * combined, rtol=1e-10)
    assert_allclose(P_after, none * P + (1 - none) * P_c + spread, rtol=1e-9, atol=1e-12)


def test_known_rows_and_unknown_rows_are_the_kalman_update_and_none():
    rng = np.random.default_rng(1)
    x, P, H, R = rng.normal(size=4), spd(rng, 4, 4), rng.normal(size=(3, 4)), spd(rng, 3, 3)
    S, nu = H @ P @ H.T + R, rng.normal(size=3)
    got = soft_update(x, P, H, R, nu, np.zeros((3, 3)))
    want = gaussian.update(x, P, nu, H, R, np.ones(3, dtype=bool))
    assert_allclose(got[0], want.x, rtol=1e-10)
    assert_allclose(got[1], want.P, rtol=1e-9, atol=1e-12)
    x_same, P_same = soft_update(x, P, H, R, np.zeros(3), S)
    assert_allclose(x_same, x)
    assert_allclose(P_same, P, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("emission", [None, np.zeros(3, dtype=int)])
def test_a_sure_association_is_the_kalman_update_correlated_rows_and_all(emission):
    """Rows that share a reference station, one value each, hardly any clutter."""
    rng = np.random.default_rng(2)
    x, P, H = rng.normal(size=4), spd(rng, 4, 4), rng.normal(size=(3, 4))
    R = 0.5 * (np.eye(3) + np.ones((3, 3)))
    S = H @ P @ H.T + R
    nu = np.linalg.cholesky(S) @ np.array([0.3, -0.8, 0.5])
    scan = Unlabelled((H @ x + nu)[[2, 0, 1]], [2, 0, 1], emission=emission)
    got = Jpda(PD, 1e-30)(Prediction((H @ x)[None], S[None]), scan)
    assert_allclose(got.weight, 1.0, atol=1e-12)
    assert_allclose(got.innovation[0, 0], nu, rtol=1e-9)
    want = gaussian.update(x, P, nu, H, R, np.ones(3, dtype=bool))
    x_after, P_after = soft_update(x, P, H, R, got.innovation[0, 0], got.covariance[0, 0])
    assert_allclose(x_after, want.x, rtol=1e-8)
    assert_allclose(P_after, want.P, rtol=1e-8, atol=1e-10)
    sure = np.log(PD) * (3 if emission is None else 1) - 3 * np.log(1e-30)
    assert_allclose(got.log_likelihood_ratio[0, 0] - sure, want.log_likelihood, rtol=1e-9)


def test_stations_one_after_another_match_the_moments_of_all_combinations():
    """Two stations, one target: the belief against the mixture over all pairs of values.

    The mixture's moments are matched after the first station, so the second's shares are those
    of a Gaussian; the first's must agree to rounding, the moments to what matching costs.
    """
    S = 9.0 * np.array([[1.0, 0.6], [0.6, 1.0]])
    first, second = np.array([1.0]), np.array([2.0, -4.5])
    clutter = 0.02
    got = Jpda(PD, clutter, gate_probability=PG)(
        Prediction(np.zeros((1, 2)), S[None]), Unlabelled([1.0, 2.0, -4.5], [0, 1, 1])
    )
    events, weights, means, left = [], [], [], []
    for a, b in product([*first, None], [*second, None]):
        rows = [i for i, z in enumerate((a, b)) if z is not None]
        z = np.array([v for v in (a, b) if v is not None])
        part = S[np.ix_(rows, rows)]
        w = (1 - PD * PG) ** (2 - len(rows)) * (PD / clutter) ** len(rows)
        if rows:
            w *= multivariate_normal.pdf(z, np.zeros(len(rows)), part)
            gain = S[:, rows] @ np.linalg.inv(part)
            means.append(gain @ z)
            left.append(S - gain @ S[rows])
        else:
            means.append(np.zeros(2))
            left.append(S)
        events.append((a, b))
        weights.append(w)
    w = np.array(weights) / sum(weights)
    mean = w @ np.array(means)
    d = np.array(means) - mean
    cov = np.einsum("e,eab->ab", w, np.array(left) + d[:, :, None] * d[:, None, :])
    share = [sum(p for p, e in zip(w, events, strict=True) if e[1] == z) for z in second]
    assert_allclose(got.weight[0, 1:], share, atol=0.02)
    assert_allclose(got.innovation[0, 0], mean, atol=0.1)
    assert_allclose(got.covariance[0, 0], cov, atol=0.35)
    assert_allclose(got.log_likelihood_ratio[0, 0], np.log(sum(weights)), atol=0.05)


def test_without_clutter_a_target_surely_detected_has_its_nearest_value():
    rng = np.random.default_rng(3)
    for _ in range(20):
        one = Prediction([[0.0]], [[[0.01]]])
        z = rng.uniform(-0.35, 0.35, 1)
        z = np.concatenate([z, 1.0 + rng.uniform(0.0, 5.0, 3)])
        got = Jpda(1.0, 1e-12, gate_probability=1.0 - 1e-12)(one, Unlabelled(z, [0] * 4))
        assert_array_equal(np.round(got.weight, 9), [[1, 0, 0, 0]])
        nearest = Nearest(gamma=7.0)(one, Unlabelled(z, [0] * 4))
        assert_array_equal(np.round(got.weight, 9), nearest.weight)
        assert_allclose(got.innovation[0, 0, 0], nearest.values[0, 0], rtol=1e-6)


def test_shares_order_values_by_distance():
    got = Jpda(PD, 0.1)(Prediction([[0.0]], [[[4.0]]]), Unlabelled([1.0, -3.0, 2.0], [0, 0, 0]))
    assert np.argsort(-got.weight[0]).tolist() == [0, 2, 1]


def test_targets_far_apart_decouple():
    rng = np.random.default_rng(4)
    S = spd(rng, 2, 2, 2)
    mean = np.array([[0.0, 0.0], [1e4, -1e4]])
    near = np.array([0.5, -0.5, 1.0])
    values = np.concatenate([near, 1e4 * np.array([1.0, -1.0, 1.0]) + near])
    row = np.array([0, 1, 1, 0, 1, 0])
    associate = Jpda(PD, 0.05)
    both = associate(Prediction(mean, S), Unlabelled(values, row))
    for n, own in enumerate((slice(0, 3), slice(3, 6))):
        alone = associate(Prediction(mean[[n]], S[[n]]), Unlabelled(values[own], row[own]))
        assert_allclose(both.weight[n, own], alone.weight[0], rtol=1e-9)
        assert_allclose(both.innovation[n], alone.innovation[0], rtol=1e-9, atol=1e-9)
        assert_allclose(both.log_likelihood_ratio[n], alone.log_likelihood_ratio[0], rtol=1e-9)
    assert_array_equal(both.weight[0, 3:], 0.0)


def test_order_of_targets_values_and_modes_does_not_matter():
    rng = np.random.default_rng(5)
    N, r, m, K = 3, 2, 3, 10
    mean, S = rng.normal(size=(N, r, m)), spd(rng, N, r, m, m)
    log_w = np.log(rng.dirichlet(np.ones(r), N))
    values, row = rng.normal(size=K) * 2, rng.integers(0, m, K)
    associate = Jpda(PD, 0.1)
    a = associate(Prediction(mean, S, log_weight=log_w), Unlabelled(values, row))
    n, k, j = rng.permutation(N), rng.permutation(K), rng.permutation(r)
    b = associate(
        Prediction(mean[n][:, j], S[n][:, j], log_weight=log_w[n][:, j]),
        Unlabelled(values[k], row[k]),
    )
    assert_allclose(b.weight, a.weight[n][:, k], rtol=1e-9, atol=1e-13)
    assert_allclose(b.innovation, a.innovation[n][:, j], rtol=1e-9, atol=1e-12)
    assert_allclose(b.covariance, a.covariance[n][:, j], rtol=1e-9, atol=1e-11)
    assert_allclose(b.log_likelihood_ratio, a.log_likelihood_ratio[n][:, j], rtol=1e-9)


def test_one_mode_split_in_two_equal_ones_changes_nothing():
    rng = np.random.default_rng(6)
    mean, S = rng.normal(size=(2, 1, 3)), spd(rng, 2, 1, 3, 3)
    scan = Unlabelled(rng.normal(size=8) * 2, rng.integers(0, 3, 8))
    one = Jpda(PD, 0.1)(Prediction(mean, S, log_weight=np.zeros((2, 1))), scan)
    two = Jpda(PD, 0.1)(
        Prediction(mean.repeat(2, 1), S.repeat(2, 1), log_weight=np.log([[0.3, 0.7]] * 2)), scan
    )
    assert_allclose(two.weight, one.weight, rtol=1e-12)
    assert_allclose(two.covariance, one.covariance.repeat(2, 1), rtol=1e-12)
    assert_allclose(two.log_likelihood_ratio, one.log_likelihood_ratio.repeat(2, 1))


def test_the_mode_that_foresaw_the_values_is_the_likelier():
    prediction = Prediction(
        [[[0.0], [8.0]]], np.ones((1, 2, 1, 1)) * 4.0, log_weight=np.log([[0.5, 0.5]])
    )
    got = Jpda(PD, 0.01)(prediction, Unlabelled([7.5], [0]))
    still, moved = got.log_likelihood_ratio[0]
    assert moved > still + 3.0
    # "none" keeps the poorer mode alive: its ratio is bounded below by 1 - P_D P_G
    assert still >= np.log(1.0 - PD * 0.9999)


def test_a_value_outside_the_gate_counts_for_nothing():
    one = Prediction([[0.0]], [[[1.0]]])
    edge = float(np.sqrt(chi2.ppf(PG, 1)))
    jpda = Jpda(PD, 1e-6, gate_probability=PG)
    assert jpda(one, Unlabelled([edge - 1e-9], [0])).weight[0, 0] > 0.9
    outside = jpda(one, Unlabelled([edge + 1e-9], [0]))
    assert outside.weight[0, 0] == 0.0
    assert_allclose(outside.log_likelihood_ratio, np.log(1.0 - PD * PG))
    assert_array_equal(outside.innovation, 0.0)
    assert_array_equal(outside.covariance, 1.0)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_covariances_stay_covariances(seed, emissions):
    rng = np.random.default_rng(seed)
    N, r, m, K = rng.integers(1, 4), rng.integers(1, 4), rng.integers(1, 5), rng.integers(0, 12)
    mean, S = 3 * rng.normal(size=(N, r, m)), spd(rng, N, r, m, m)
    log_w = np.log(rng.dirichlet(np.ones(r), N))
    values, row = 3 * rng.normal(size=K), rng.integers(0, m, K)
    scan = Unlabelled(values, row)
    if emissions:  # the how-manieth value of its row
        scan = Unlabelled(values, row, emission=[int(np.sum(row[:k] == row[k])) for k in range(K)])
    got = Jpda(PD, 10.0 ** rng.uniform(-9, 0))(Prediction(mean, S, log_weight=log_w), scan)
    assert np.all(np.isfinite(got.innovation))
    assert np.all(np.linalg.eigvalsh(got.covariance) > -1e-9)
    assert np.all((got.weight >= 0.0) & (got.weight <= 1.0))
    assert np.all(got.weight.sum(axis=0) <= 1.0 + 1e-9)
    for i in range(m):
        per_row = got.weight[:, row == i].sum(axis=1) + got.missed[:, i]
        assert_allclose(per_row, 1.0, atol=1e-9)


def test_emissions_share_whole():
    """One emission fits target 0 at both stations, the other at none: no mixing of halves."""
    prediction = Prediction(np.zeros((1, 2)), np.array([[[1.0, 0.9], [0.9, 1.0]]]))
    values, row = [1.0, 1.1, -0.2, 2.6], [0, 1, 0, 1]
    got = Jpda(PD, 0.05)(prediction, Unlabelled(values, row, emission=[0, 0, 1, 1]))
    assert_array_equal(got.weight[0, 0], got.weight[0, 1])
    assert_array_equal(got.weight[0, 2], got.weight[0, 3])
    assert got.weight[0, 0] > 0.99
    assert_allclose(got.innovation[0, 0], [1.0, 1.1], atol=0.02)
