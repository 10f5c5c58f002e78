"""Marginal association probabilities against a list of all joint events."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa.tracking import marginals
from imm_tdoa.tracking.joint import log_exact, log_propagated


def joint_events(N, L):
    """All ways to give N targets a candidate (or L: none), no candidate twice."""
    for event in product(range(L + 1), repeat=N):
        used = [k for k in event if k < L]
        if len(set(used)) == len(used):
            yield event


def enumerate_all(detect, miss):
    """Marginals (N, L + 1), and total weights with and without each target."""
    N, L = detect.shape
    factor = np.concatenate([detect, miss[:, None]], axis=1)
    beta, total, without = np.zeros((N, L + 1)), 0.0, np.zeros(N)
    for event in joint_events(N, L):
        weight = np.prod([factor[n, k] for n, k in enumerate(event)])
        total += weight
        for n, k in enumerate(event):
            beta[n, k] += weight
            if k == L:
                without[n] += weight / miss[n]
    return beta / total, total, without


@st.composite
def factors(draw, most=4):
    N, L = draw(st.integers(1, most)), draw(st.integers(1, most))
    number = st.floats(1e-6, 1e6) | st.sampled_from([0.0, 1.0])
    detect = draw(arrays(float, (N, L), elements=number))
    return detect, draw(arrays(float, N, elements=st.floats(1e-6, 1.0)))


def of(detect, miss, **options):
    with np.errstate(divide="ignore"):
        return marginals(np.log(detect), np.log(miss), **options)


@settings(deadline=None, max_examples=150)
@given(factors())
def test_weights_equal_exhaustive_enumeration(case):
    detect, miss = case
    got = of(detect, miss)
    beta, total, without = enumerate_all(detect, miss)
    assert_allclose(got.beta, beta, rtol=1e-9, atol=1e-13)
    assert_allclose(got.log_ratio, np.log(total / without), rtol=1e-9, atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(factors(), st.randoms(use_true_random=False))
def test_order_does_not_matter(case, random):
    detect, miss = case
    n, k = list(range(detect.shape[0])), list(range(detect.shape[1]))
    random.shuffle(n)
    random.shuffle(k)
    straight, mixed = of(detect, miss), of(detect[np.ix_(n, k)], miss[n])
    assert_allclose(mixed.beta, straight.beta[np.ix_(n, [*k, len(k)])], rtol=1e-9, atol=1e-13)
    assert_allclose(mixed.log_ratio, straight.log_ratio[n], rtol=1e-9, atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(factors())
def test_best_permutations_equal_enumeration_of_what_is_kept(case):
    """JPDA*: of the events with the same targets and candidates the likeliest."""
    detect, miss = case
    N, L = detect.shape
    factor = np.concatenate([detect, miss[:, None]], axis=1)
    kept = {}
    for event in joint_events(N, L):
        weight = np.prod([factor[n, k] for n, k in enumerate(event)])
        key = (tuple(k < L for k in event), frozenset(k for k in event if k < L))
        kept[key] = max(kept.get(key, (0.0, event)), (weight, event))
    weights = {key: weight for key, (weight, _) in kept.items()}
    beta, without = np.zeros((N, L + 1)), np.zeros(N)
    for weight, event in kept.values():
        beta[np.arange(N), event] += weight
        without += np.where(np.array(event) == L, weight / miss, 0.0)
    total = sum(weights.values())
    got = of(detect, miss, permutations="best")
    rivals = {}
    for event in joint_events(N, L):
        key = (tuple(k < L for k in event), frozenset(k for k in event if k < L))
        weight = np.prod([factor[n, k] for n, k in enumerate(event)])
        rivals.setdefault(key, []).append(weight)
    tied = any(
        len(w) > 1 and np.isclose(*sorted(w)[-2:], rtol=1e-9) and max(w) > 0.0
        for w in rivals.values()
    )
    assert_allclose(got.beta.sum(axis=1), 1.0)
    assert_allclose(got.log_ratio, np.log(total / without), rtol=1e-8, atol=1e-8)
    if not tied:  # between equally likely events the choice is free
        assert_allclose(got.beta, beta / total, rtol=1e-8, atol=1e-12)


def test_best_permutations_tell_close_targets_apart():
    """Two targets, two values between them: JPDA gives both nearly half of each."""
    nis = np.array([[0.2, 0.4], [0.4, 0.2]])
    plain = marginals(5.0 - nis, np.full(2, np.log(0.01)))
    best = marginals(5.0 - nis, np.full(2, np.log(0.01)), permutations="best")
    assert plain.beta[0, 1] > 0.35
    assert best.beta[0, 1] < 0.001
    assert best.beta[0, 0] > 0.99


def test_both_ways_of_summing_agree_on_bigger_clusters():
    rng = np.random.default_rng(0)
    odds = rng.normal(1.0, 3.0, size=(7, 9))
    odds[rng.random(odds.shape) < 0.3] = -np.inf
    tall = np.concatenate([odds, np.full((3, 9), -np.inf)])  # more targets than candidates
    assert_allclose(log_exact(tall)[:7], log_exact(odds), rtol=1e-10, atol=1e-10)


def test_published_number_of_feasible_joint_events():
    """MathWorks, jpdaEvents: a validation matrix of five values and six tracks has 574 events."""
    valid = np.array(
        [
            [1, 1, 1, 1, 0, 1],
            [0, 1, 1, 0, 0, 0],
            [0, 0, 0, 1, 1, 0],
            [1, 1, 1, 0, 0, 0],
            [1, 1, 1, 1, 1, 1],
        ],
        dtype=float,
    ).T
    one = np.ones(len(valid))
    got = of(valid, one)
    # the weight of all events is the product of what each target adds to those before it
    count = np.prod([np.exp(of(valid[: n + 1], one[: n + 1]).log_ratio[n]) for n in range(6)])
    assert_allclose(count, 574.0, rtol=1e-12)
    beta, total, _ = enumerate_all(valid, one)
    assert total == 574
    assert_allclose(got.beta, beta, rtol=1e-12)


def test_published_probabilities_of_joint_events():
    """MathWorks, jpdaEvents: the three likeliest of four values and two tracks, 3 : 2 : 2.

    Rows are values, the first none; columns tracks, the first none. The events are value 3 of
    track 1 with value 4 of track 2; value 3 of track 1 with value 1 of track 2; value 2 of track
    1 with value 4 of track 2.
    """
    likelihood = np.array(
        [[0.1, 0.1, 0.1], [0.1, 0.3, 0.2], [0.1, 0.4, 0.1], [0.1, 0.6, 0.1], [0.1, 0.5, 0.3]]
    )
    detect, miss = (likelihood[1:, 1:] / likelihood[1:, :1]).T, likelihood[0, 1:]
    factor = np.concatenate([detect, miss[:, None]], axis=1)
    weight = {e: factor[0, e[0]] * factor[1, e[1]] for e in joint_events(2, 4)}
    likeliest = sorted(weight, key=weight.__getitem__, reverse=True)[:3]
    assert set(likeliest) == {(2, 3), (2, 0), (1, 3)}
    share = np.array([weight[e] for e in likeliest])
    assert_allclose(share / share.sum(), [0.4286, 0.2857, 0.2857], atol=5e-5)
    beta = np.zeros((2, 5))
    for event, w in weight.items():
        beta[[0, 1], event] += w / sum(weight.values())
    assert_allclose(of(detect, miss).beta, beta, rtol=1e-12)


def test_targets_that_share_no_candidate_do_not_know_of_each_other():
    rng = np.random.default_rng(1)
    detect = np.zeros((4, 6))
    detect[:2, :3], detect[2:, 3:] = rng.gamma(1.0, 5.0, (2, 3)), rng.gamma(1.0, 5.0, (2, 3))
    miss = rng.uniform(0.05, 0.5, 4)
    both = of(detect, miss)
    first, second = of(detect[:2, :3], miss[:2]), of(detect[2:, 3:], miss[2:])
    assert_allclose(both.beta[:2, [0, 1, 2, 6]], first.beta, rtol=1e-12)
    assert_allclose(both.beta[2:, 3:], second.beta, rtol=1e-12)
    assert_allclose(both.log_ratio, [*first.log_ratio, *second.log_ratio], rtol=1e-12)
    assert np.all(np.isneginf(both.log_extrinsic[:2, 3:6]))


def test_no_candidates_and_no_targets():
    got = of(np.zeros((2, 0)), np.array([0.1, 0.2]))
    assert_array_equal(got.beta, [[1.0], [1.0]])
    assert_allclose(got.log_ratio, np.log([0.1, 0.2]))
    assert marginals(np.zeros((0, 3)), np.zeros(0)).beta.shape == (0, 4)


@pytest.mark.parametrize("N", [3, 12])
def test_extreme_odds_neither_overflow_nor_vanish(N):
    """N targets, one candidate that surely is somebody's: a fair share for each."""
    got = marginals(np.full((N, 1), 1000.0), np.zeros(N))
    assert_allclose(got.beta, np.tile([1.0 / N, 1.0 - 1.0 / N], (N, 1)), rtol=1e-9)
    mixed = marginals(np.array([[1000.0, 990.0], [-1000.0, 5.0]]), np.zeros(2))
    assert np.all(np.isfinite(mixed.beta))
    assert_allclose(mixed.beta.sum(axis=1), 1.0)


def test_propagation_is_exact_without_loops_and_close_with():
    rng = np.random.default_rng(2)
    chain = np.full((3, 4), -np.inf)
    for n in range(3):
        chain[n, n : n + 2] = rng.normal(2.0, 1.0, 2)
    chain = np.where(np.isfinite(chain), chain, -1e9)
    used = chain > -1e8
    assert_allclose(log_propagated(chain)[used], log_exact(chain)[used], atol=1e-9)
    worst = []
    for _ in range(20):
        # 5 targets 2 standard deviations apart among 10 candidates
        place = 2.0 * np.arange(5.0)[:, None]
        seen = np.concatenate([place[:, 0] + rng.normal(size=5), rng.uniform(-4.0, 12.0, 5)])
        log_detect = -0.5 * (seen - place) ** 2 + np.log(0.9 / np.sqrt(2 * np.pi) / 0.3)
        log_miss = np.full(5, np.log(0.1))
        exact = marginals(log_detect, log_miss).beta
        near = marginals(log_detect, log_miss, exact_up_to=1).beta
        assert_allclose(near.sum(axis=1), 1.0, rtol=1e-12)
        worst.append(np.abs(near - exact).max())
    assert max(worst) < 0.15
    assert np.mean(worst) < 0.05


def test_a_big_cluster_is_propagated():
    rng = np.random.default_rng(3)
    log_detect = rng.normal(0.0, 2.0, (40, 60))
    got = marginals(log_detect, np.full(40, np.log(0.1)))
    assert_allclose(got.beta.sum(axis=1), 1.0, rtol=1e-9)
    assert np.all(got.beta[:, :-1].sum(axis=0) <= 1.0 + 1e-6)  # no candidate more than once


@pytest.mark.parametrize(
    ("detect", "miss", "message"),
    [
        ([1.0], [0.0], "log_detect: expected shape"),
        ([[np.nan]], [0.0], "log_detect: expected numbers"),
        ([[np.inf]], [0.0], "log_detect: expected numbers"),
        ([[0.0]], [-np.inf], "log_miss: expected 1 finite"),
        ([[0.0]], [0.0, 0.0], "log_miss: expected 1 finite"),
    ],
)
def test_refused(detect, miss, message):
    with pytest.raises(ValueError, match=message):
        marginals(np.array(detect), np.array(miss))
