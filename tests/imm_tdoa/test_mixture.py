"""Weighted Gaussians: normalisation in logs and moment matching."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import mixture_moments
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import logsumexp

from imm_tdoa import mixture


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
