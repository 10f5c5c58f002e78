"""Ranges, range rates, and differences between stations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import pair_covariance
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import geometry

seeds = st.integers(0, 2**32 - 1)


def central(f, x, h):
    """Derivative of f (m,) at x (d,) by central differences, (m, d)."""
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(len(x))], axis=-1)


@settings(deadline=None, max_examples=40)
@given(seed=seeds, d=st.integers(1, 3))
def test_ranges_and_directions(seed, d):
    rng = np.random.default_rng(seed)
    p, s = 1e3 * rng.normal(size=d), 1e3 * rng.normal(size=(4, d))
    r, u = geometry.ranges(p, s)
    assert_allclose(r, [np.linalg.norm(p - a) for a in s], rtol=1e-14)
    assert_allclose(s + r[:, None] * u, np.tile(p, (4, 1)), rtol=1e-10, atol=1e-9)
    # the second derivative, of order 1/r, bounds the error of the difference
    assert_allclose(u, central(lambda q: geometry.ranges(q, s)[0], p, 1e-4 * r.min()), atol=1e-6)


@settings(deadline=None, max_examples=40)
@given(seed=seeds, d=st.integers(2, 3))
def test_range_rates_and_their_gradients(seed, d):
    rng = np.random.default_rng(seed)
    p, v = 1e3 * rng.normal(size=d), 30 * rng.normal(size=d)
    s, vs = 1e3 * rng.normal(size=(4, d)), 20 * rng.normal(size=(4, d))
    rate, b, u = geometry.range_rates(p, v, s, vs)
    r, _ = geometry.ranges(p, s)
    h = 1e-4 * r.min()
    along = central(lambda t: geometry.ranges(p + v * t, s + vs * t)[0], np.zeros(1), 1e-3)[:, 0]
    assert_allclose(rate, along, rtol=1e-5, atol=1e-4)
    by_p = central(lambda q: geometry.range_rates(q, v, s, vs)[0], p, h)
    by_v = central(lambda w: geometry.range_rates(p, w, s, vs)[0], v, 1.0)
    assert_allclose(b, by_p, rtol=1e-5, atol=1e-6 * np.abs(b).max())
    assert_allclose(u, by_v, rtol=1e-8, atol=1e-10)


def test_at_a_station_the_direction_is_zero_not_nan():
    r, u = geometry.ranges(np.array([1.0, 2.0]), np.array([[1.0, 2.0], [4.0, 6.0]]))
    assert_array_equal(r, [0.0, 5.0])
    assert_array_equal(u[0], [0.0, 0.0])
    _, b, _ = geometry.range_rates(np.zeros(2), np.ones(2), np.zeros((1, 2)), np.zeros((1, 2)))
    assert np.isfinite(b).all()


@pytest.mark.parametrize("axis", [-1, -2])
@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_differences_of_fixed_and_of_changing_pairs(axis, batch):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(*batch, 5)) if axis == -1 else rng.normal(size=(*batch, 5, 2))
    pairs = np.array([[1, 0], [4, 2], [3, 0]])
    want = np.stack(
        [np.take(rows, i, axis=axis) - np.take(rows, j, axis=axis) for i, j in pairs], axis=axis
    )
    assert_array_equal(geometry.difference(rows, pairs, axis), want)
    many = np.broadcast_to(pairs, (*batch, 3, 2)) if batch else pairs[None]
    got = geometry.difference(rows, many, axis)
    assert_array_equal(got, want if batch else want[None])


def test_pairs_that_differ_along_the_batch():
    rows = np.arange(10.0).reshape(2, 5) ** 2
    pairs = np.array([[[1, 0]], [[4, 3]]])
    assert_array_equal(geometry.difference(rows, pairs), [[1.0], [81.0 - 64.0]])
    one = geometry.difference(rows[0], pairs)
    assert_array_equal(one, [[1.0], [16.0 - 9.0]])


@settings(deadline=None, max_examples=40)
@given(seed=seeds)
def test_covariance_of_differences_entry_by_entry(seed):
    rng = np.random.default_rng(seed)
    variance = rng.uniform(0.1, 4.0, 5)
    pairs = np.array([rng.choice(5, 2, replace=False) for _ in range(6)])
    R = geometry.difference_covariance(variance, pairs)
    assert_allclose(R, pair_covariance(variance, pairs), rtol=1e-14, atol=1e-14)
    both = geometry.difference_covariance(np.stack([variance, 2 * variance]), pairs)
    assert_allclose(both[1], 2 * R, rtol=1e-14)


def test_equal_arrivals_give_the_textbook_covariances():
    """sigma² (I + 11') for one reference, tridiag(-1, 2, -1) for adjacent pairs (§1.1)."""
    reference = np.array([[1, 0], [2, 0], [3, 0]])
    adjacent = np.array([[0, 1], [1, 2], [2, 3]])
    one = np.ones(4)
    assert_array_equal(geometry.difference_covariance(one, reference), np.eye(3) + 1.0)
    want = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    assert_array_equal(geometry.difference_covariance(one, adjacent), want)
    assert_array_equal(
        geometry.incidence(reference, 4), [[-1, 1, 0, 0], [-1, 0, 1, 0], [-1, 0, 0, 1]]
    )
