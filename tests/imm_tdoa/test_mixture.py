"""Weighted Gaussians: normalisation in logs, moment matching, merging and pruning."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import mixture_moments
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import logsumexp

from imm_tdoa import mixture
from imm_tdoa.mixture import Mixture


@settings(deadline=None, max_examples=50)
@given(
    st.lists(
        st.floats(-50.0, 50.0) | st.just(-np.inf) | st.floats(-1e6, -1e5), min_size=1, max_size=5
    )
)
def test_normalised_weights_sum_to_one(log_weight):
    w = np.array(log_weight)
    log_p, total = mixture.normalise(w)
    if np.all(np.isneginf(w)):
        assert np.isneginf(total)
        assert np.all(np.isneginf(log_p))
        return
    assert_allclose(total, logsumexp(w), rtol=1e-14, atol=1e-14)
    assert_allclose(np.exp(log_p).sum(), 1.0, rtol=1e-13)
    assert_array_equal(np.isneginf(log_p), np.isneginf(w))


def test_weights_far_below_the_range_of_floats_keep_their_ratios():
    log_p, total = mixture.normalise(np.array([-1e5, -1e5 + np.log(3.0), -2e5]))
    assert_allclose(np.exp(log_p), [0.25, 0.75, 0.0], rtol=1e-10)
    assert_allclose(total, -1e5 + np.log(4.0), rtol=1e-15)
    assert log_p[2] < -9e4


def test_each_element_of_a_batch_is_normalised_by_itself():
    w = np.array([[0.0, -np.inf], [-np.inf, -np.inf], [-1e6, -1e6]])
    log_p, total = mixture.normalise(w)
    assert_array_equal(log_p[0], [0.0, -np.inf])
    assert_allclose(log_p[2], np.log([0.5, 0.5]), atol=1e-9)
    assert_array_equal(np.isneginf(total), [False, True, False])


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), N=st.integers(1, 4), n=st.integers(1, 4))
def test_moments_are_those_of_the_mixture(seed, N, n):
    rng = np.random.default_rng(seed)
    w = rng.dirichlet(np.ones(N))
    x, A = rng.normal(size=(N, n)), rng.normal(size=(N, n, n))
    P = A @ np.swapaxes(A, -1, -2)
    m, C = mixture.moments(w, x, P)
    want_m, want_C = mixture_moments(list(w), list(x), list(P))
    assert_allclose(m, want_m, rtol=1e-12, atol=1e-12)
    assert_allclose(C, want_C, rtol=1e-10, atol=1e-10)
    assert_array_equal(C, C.T)


def test_moments_do_not_cancel_far_from_the_origin():
    """The spread is formed about the mean, not as a difference of squares."""
    x = np.array([[1e9], [1e9 + 2e-3]])
    _, C = mixture.moments(np.array([0.5, 0.5]), x, np.zeros((2, 1, 1)))
    assert_allclose(C, [[1e-6]], rtol=1e-3)


def test_one_component_is_returned_unchanged():
    x, P = np.array([[0.1, 0.3]]), np.array([[[0.7, 0.1], [0.1, 0.9]]])
    m, C = mixture.moments(np.ones(1), x, P)
    assert_array_equal(m, x[0])
    assert_array_equal(C, P[0])


def random_mixture(rng, batch=(), N=6, n=2, spread=2.0):
    """Components about `spread` apart, one slot in four empty but never all."""
    w = np.log(rng.dirichlet(np.ones(N), size=batch))
    w = np.where((rng.random(w.shape) < 0.25) & (np.arange(N) > 0), -np.inf, w)
    A = rng.normal(size=(*batch, N, n, n))
    return Mixture(
        mixture.normalise(w)[0],
        spread * rng.normal(size=(*batch, N, n)),
        A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(n),
    )


def alone(mix):
    """The components that are there, as a list of (weight, mean, covariance)."""
    return [
        (np.exp(w), x, P)
        for w, x, P in zip(mix.log_weight, mix.x, mix.P, strict=True)
        if np.isfinite(w)
    ]


def distance(a, b, by):
    """The two distances of §7.1-6, for one pair."""
    d = a[1] - b[1]
    if by == "euclidean":
        return float(np.sqrt(d @ d))
    if a[0] < b[0]:
        a, b = b, a
    return float(np.sqrt(a[0] * b[0] / (a[0] + b[0]) * (d @ np.linalg.inv(a[2]) @ d)))


def merged_by_hand(parts, within, by):
    """Merge the closest pair until none is closer, with plain loops."""
    parts = list(parts)
    while len(parts) > 1:
        pairs = [(i, j) for i in range(len(parts)) for j in range(i)]
        i, j = min(pairs, key=lambda ij: distance(parts[ij[0]], parts[ij[1]], by))
        if distance(parts[i], parts[j], by) >= within:
            break
        a, b = parts[i], parts[j]
        w = a[0] + b[0]
        m = (a[0] * a[1] + b[0] * b[1]) / w
        P = sum(c[0] / w * (c[2] + np.outer(c[1] - m, c[1] - m)) for c in (a, b))
        parts = [p for k, p in enumerate(parts) if k not in (i, j)] + [(w, m, P)]
    return parts


def assert_same(found, wanted):
    """The same components in any order."""
    assert len(found) == len(wanted)
    for f, w in zip(*(sorted(c, key=lambda p: tuple(p[1])) for c in (found, wanted)), strict=True):
        for a, b in zip(f, w, strict=True):
            assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("by", "within"), [("euclidean", 2.0), ("mahalanobis", 0.6)])
def test_merging_is_what_plain_loops_do_and_keeps_the_moments(by, within):
    rng = np.random.default_rng(11)
    mix = random_mixture(rng, (40,))
    out = mixture.merge(mix, within, by)
    counts = []
    for k in range(40):
        before, after = (alone(Mixture(*(a[k] for a in m))) for m in (mix, out))
        assert_same(after, merged_by_hand(before, within, by))
        counts.append((len(before), len(after)))
        for a, b in zip(
            mixture_moments(*map(list, zip(*after, strict=True))),
            mixture_moments(*map(list, zip(*before, strict=True))),
            strict=True,
        ):
            assert_allclose(a, b, rtol=1e-10, atol=1e-12)
    assert {b - a for b, a in counts} >= {0, 1, 2}  # some merge and some do not


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    by=st.sampled_from(["euclidean", "mahalanobis"]),
    within=st.floats(0.1, 5.0),
)
def test_merging_again_or_in_another_order_changes_nothing(seed, by, within):
    rng = np.random.default_rng(seed)
    mix = random_mixture(rng)
    once = mixture.merge(mix, within, by)
    again = mixture.merge(once, within, by)
    for a, b in zip(once, again, strict=True):
        assert_array_equal(a, b)
    order = rng.permutation(6)
    other = mixture.merge(Mixture(*(a[order] for a in mix)), within, by)
    assert_same(alone(other), alone(once))
    assert_allclose(np.exp(once.log_weight).sum(), 1.0, rtol=1e-12)


def test_merging_does_not_depend_on_the_total_weight():
    mix = random_mixture(np.random.default_rng(2))
    heavy = mix._replace(log_weight=mix.log_weight - 900.0)
    for by in ("euclidean", "mahalanobis"):
        a, b = mixture.merge(mix, 1.0, by), mixture.merge(heavy, 1.0, by)
        assert_allclose(b.x, a.x)
        assert_allclose(b.log_weight + 900.0, a.log_weight)


def test_the_heavier_s_slot_is_kept_and_distance_is_over_chosen_components():
    x = np.array([[0.0, 0.0], [1.0, 500.0], [50.0, 0.0]])
    mix = Mixture(np.log([0.2, 0.5, 0.3]), x, np.tile(np.eye(2), (3, 1, 1)))
    out = mixture.merge(mix, 3.0, components=np.array([0]))
    assert_allclose(np.exp(out.log_weight), [0.0, 0.7, 0.3])
    assert_allclose(out.x[1], (0.2 * x[0] + 0.5 * x[1]) / 0.7)
    apart = mixture.merge(mix, 3.0)
    assert_array_equal(np.isneginf(apart.log_weight), False)


def test_two_equal_components_are_one():
    one = np.zeros((2, 3)), np.tile(np.diag([1.0, 2.0, 3.0]), (2, 1, 1))
    for by in ("euclidean", "mahalanobis"):
        w, x, P = mixture.merge(Mixture(np.log([0.5, 0.5]), *one), 1e-9, by)
        assert_array_equal(np.isneginf(w), [False, True])
        assert_allclose(w[0], 0.0, atol=1e-15)
        assert_allclose(P[0], one[1][0])
        assert_array_equal(x[0], 0.0)


def test_pruning_drops_light_ones_and_never_all():
    w = np.array([[*np.log([0.5, 0.499, 1e-3]), -np.inf], np.log([0.25] * 4)])
    out = mixture.prune(w, 0.01)
    assert_allclose(np.exp(out[0]), [0.5 / 0.999, 0.499 / 0.999, 0.0, 0.0])
    assert_allclose(out[1], w[1])
    assert_allclose(np.exp(mixture.prune(w, 0.9)), [[1.0, 0, 0, 0], [0.25] * 4])
    assert_array_equal(mixture.prune(w, 0.0), mixture.normalise(w)[0])
    assert_array_equal(mixture.prune(out, 0.01), out)
    assert_allclose(mixture.prune(w - 1e4, 0.01), out, atol=1e-11)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: mixture.merge(m, 0.0), "within: expected a number above 0"),
        (lambda m: mixture.merge(m, 1.0, "manhattan"), "by: expected one of 'euclidean'"),
        (lambda m: mixture.prune(m.log_weight, 1.0), "below: expected a share"),
        (lambda m: mixture.prune(m.log_weight, -0.1), "below: expected a number of at least 0"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        call(random_mixture(np.random.default_rng(0)))
