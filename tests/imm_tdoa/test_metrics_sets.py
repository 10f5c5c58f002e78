"""OSPA and GOSPA: published and hand-worked values, the laws of a metric, brute force."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import metrics


@pytest.mark.parametrize(
    ("order", "first", "second"), [(1, 2.4, 2.16), (2, 4.49444, 4.47571), (np.inf, 10.0, 10.0)]
)
def test_ospa_published_by_stone_soup(order, first, second):
    """dstl/Stone-Soup, test_ospa_computemetric_cardinality_error: 4 tracks of 5 targets, c 10."""
    truth = np.arange(5.0)[:, None]
    tracks = np.arange(4.0)[:, None]
    assert_allclose(metrics.ospa(tracks + 0.5, truth, 10.0, order), first, rtol=2e-6)
    assert_allclose(metrics.ospa(tracks + 1.2, truth + 1.0, 10.0, order), second, rtol=2e-6)


@pytest.mark.parametrize("order", [1, 2, np.inf])
def test_ospa_published_by_stone_soup_equal_numbers(order):
    """dstl/Stone-Soup, test_ospametric_computemetric: 5 tracks off by 0.5, then by 0.2."""
    truth = np.arange(5.0)[:, None]
    assert_allclose(metrics.ospa(truth + 0.5, truth, 10.0, order), 0.5)
    assert_allclose(metrics.ospa(truth + 1.2, truth + 1.0, 10.0, order), 0.2)


def test_gospa_published_by_stone_soup():
    """dstl/Stone-Soup, GOSPA tests: 5 tracks off by 0.5 and 1; one track 97 off at c 2, p 2."""
    truth = np.arange(5.0)[:, None]
    assert_allclose(metrics.gospa(truth, truth + 0.5, 10.0, 1).distance / 5.0, 0.5)
    assert_allclose(metrics.gospa(truth, truth + 1.0, 10.0, 1).distance / 5.0, 1.0)
    one = metrics.gospa([[1.0], [2.0], [3.0]], [[2.0], [1.0], [100.0]], 2.0, 2)
    assert_allclose(one, [2.0, 0.0, 2.0, 2.0])  # there in metres missed 2, false 2 likewise


def test_gospa_at_the_positions_of_its_paper():
    """Rahmathullah et al. 2017: targets (-6,-6), (0,3), tracks (-6.7,-5.1), (-1.8,2.9).

    With c = 8: the tracks are off by sqrt(1.30) = 1.14018 and sqrt(3.25) = 1.80278 m; a missed or
    a false one costs 8/2 = 4 at p = 1, and 64/2 = 32 at p = 2.
    """
    targets = np.array([[-6.0, -6.0], [0.0, 3.0]])
    tracks = np.array([[-6.7, -5.1], [-1.8, 2.9]])
    far = np.array([[22.0, 18.0], [35.0, 42.0], [50.0, 35.0]])
    assert_allclose(
        metrics.gospa(targets, tracks, 8.0, 1), [2.942951, 2.942951, 0.0, 0.0], rtol=1e-6
    )
    assert_allclose(metrics.gospa(targets, tracks, 8.0, 2).distance, np.sqrt(4.55))
    got = metrics.gospa(targets, [*tracks[:1], *far], 8.0, 1)
    assert_allclose(got, [1.140175 + 16.0, 1.140175, 4.0, 12.0], rtol=1e-6)
    got = metrics.gospa(targets, far, 8.0, 2)
    assert_allclose(got, [np.sqrt(160.0), 0.0, 64.0, 96.0])
    # with alpha 1, and divided by the bigger number, GOSPA is OSPA, as the paper says
    for y in (tracks, tracks[:1], [*tracks, *far], far):
        for p in (1, 2):
            alike = metrics.gospa(targets, y, 8.0, p, alpha=1.0).distance
            n = max(len(y), 2)
            assert_allclose(metrics.ospa(targets, y, 8.0, p), alike / n ** (1 / p), rtol=1e-12)


def test_hand_worked():
    """Targets at 0 and 10, tracks at 1, 13 and 40; c = 5."""
    x, y = [[0.0], [10.0]], [[1.0], [13.0], [40.0]]
    assert_allclose(metrics.ospa(x, y, 5.0, 1), (1 + 3 + 5) / 3)
    assert_allclose(metrics.ospa(x, y, 5.0, 2), np.sqrt((1 + 9 + 25) / 3))
    assert_allclose(metrics.gospa(x, y, 5.0, 1), [6.5, 4.0, 0.0, 2.5])
    assert_allclose(metrics.gospa(x, y, 5.0, 2), [np.sqrt(22.5), 10.0, 0.0, 12.5])
    assert_allclose(metrics.gospa(x, y, 5.0, 2, alpha=1.0), [np.sqrt(35.0), 10.0, 0.0, 25.0])
    # with c = 2 the pair that is 3 apart is a missed target and a false track
    assert_allclose(metrics.gospa(x, y, 2.0, 1), [1 + 1 + 2, 1.0, 1.0, 2.0])
    assert_allclose(metrics.gospa(x, y, 2.0, 1, alpha=1.0), [1 + 2 + 2, 3.0, 0.0, 2.0])


def test_empty_sets():
    none = np.zeros((0, 2))
    one = np.ones((1, 2))
    assert metrics.ospa(none, none, 3.0) == 0.0
    assert metrics.ospa(none, one, 3.0) == 3.0
    assert metrics.gospa(none, none, 3.0) == (0.0, 0.0, 0.0, 0.0)
    assert_allclose(metrics.gospa(one, none, 4.0, 2), [np.sqrt(8.0), 0.0, 8.0, 0.0])
    assert_allclose(metrics.gospa(none, one, 4.0, 2), [np.sqrt(8.0), 0.0, 0.0, 8.0])
    gap = [[1.0, 1.0], [np.nan, 0.0]]
    assert metrics.ospa(gap, one, 3.0) == 0.0


def brute(x, y, c, p, cardinality):
    """Least sum over all ways to match the smaller set, surplus points at `cardinality`."""
    if len(x) > len(y):
        x, y = y, x
    D = np.minimum(np.linalg.norm(x[:, None] - y[None], axis=-1), c)
    ways = permutations(range(len(y)), len(x))
    least = min(sum(D[i, k] ** p for i, k in enumerate(way)) for way in ways)
    return least + cardinality * (len(y) - len(x))


points = st.integers(0, 4).flatmap(lambda n: arrays(float, (n, 2), elements=st.floats(-10.0, 10.0)))
cutoffs, orders = st.floats(0.5, 30.0), st.sampled_from([1.0, 1.5, 2.0, 3.0])


@settings(deadline=None, max_examples=80)
@given(points, points, cutoffs, orders, st.sampled_from([0.5, 1.0, 2.0]))
def test_equal_brute_force(x, y, c, p, alpha):
    n = max(len(x), len(y), 1)
    want = (brute(x, y, c, p, c**p) / n) ** (1 / p)
    assert_allclose(metrics.ospa(x, y, c, p), want, rtol=1e-9, atol=1e-9)
    want = brute(x, y, c, p, c**p / alpha) ** (1 / p)
    got = metrics.gospa(x, y, c, p, alpha)
    assert_allclose(got.distance, want, rtol=1e-9, atol=1e-9)
    assert_allclose(got.localisation + got.missed + got.false, want**p, rtol=1e-9, atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(points, points, cutoffs, orders)
def test_gospa_is_the_best_of_all_partial_matchings(x, y, c, p):
    """Its prop. 1: alpha 2 as a choice of pairs, half of c^p for every point left."""
    D = np.linalg.norm(x[:, None] - y[None], axis=-1)
    slots = [*range(len(y)), *[-1] * len(x)]
    best = np.inf
    for way in set(permutations(slots, len(x))):
        pairs = [(i, k) for i, k in enumerate(way) if k >= 0]
        left = len(x) + len(y) - 2 * len(pairs)
        best = min(best, sum(D[i, k] ** p for i, k in pairs) + left * c**p / 2)
    got = metrics.gospa(x, y, c, p)
    assert_allclose(got.distance**p, best, rtol=1e-9, atol=1e-9)
    half = c**p / 2
    assert_allclose(got.missed / half, round(got.missed / half), atol=1e-9)
    assert_allclose((got.missed - got.false) / half, len(x) - len(y), atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(points, points, st.floats(0.5, 30.0))
def test_infinite_order_is_the_largest_error_of_the_best_matching(x, y, c):
    got = metrics.ospa(x, y, c, np.inf)
    if len(x) != len(y):
        assert got == c
    elif len(x):
        D = np.minimum(np.linalg.norm(x[:, None] - y[None], axis=-1), c)
        ways = permutations(range(len(y)))
        assert got == min(max(D[i, k] for i, k in enumerate(way)) for way in ways)


@settings(deadline=None, max_examples=80)
@given(points, points, points, cutoffs, orders)
def test_laws_of_a_metric(x, y, z, c, p):
    for d in (
        lambda a, b: metrics.ospa(a, b, c, p),
        lambda a, b: metrics.gospa(a, b, c, p).distance,
    ):
        assert d(x, x[::-1]) <= 1e-9
        assert_allclose(d(x, y), d(y, x), rtol=1e-9, atol=1e-9)
        assert d(x, z) <= d(x, y) + d(y, z) + 1e-9
        same = len(x) == len(y) and set(map(tuple, x + 0.0)) == set(map(tuple, y + 0.0))
        if len(x) != len(y):
            assert d(x, y) > 0.0
        elif len(set(map(tuple, x + 0.0))) == len(x) and not same:
            apart = np.linalg.norm(x[:, None] - y[None], axis=-1)
            assert d(x, y) > 0.0 or apart.min(axis=1).max() < 1e-100  # the power underflows
    straight, swapped = metrics.gospa(x, y, c, p), metrics.gospa(y, x, c, p)
    assert_allclose(straight.missed, swapped.false, rtol=1e-9)
    assert metrics.ospa(x, y, c, p) <= c * (1 + 1e-12)


def test_curves_are_the_metrics_of_each_scan():
    rng = np.random.default_rng(0)
    truth, tracks = rng.normal(size=(3, 6, 2)), rng.normal(size=(4, 6, 2))
    truth[0, :2], tracks[2, 3:], tracks[:, 5] = np.nan, np.nan, np.nan
    got = metrics.ospa_curve(truth, tracks, 2.0, 1)
    parts = metrics.gospa_curve(truth, tracks, 2.0, 1)
    for k in range(6):
        there = [a[np.isfinite(a[:, k]).all(axis=-1), k] for a in (truth, tracks)]
        assert_allclose(got[k], metrics.ospa(*there, 2.0, 1))
        assert_allclose([part[k] for part in parts], metrics.gospa(*there, 2.0, 1))
    assert_allclose(parts.missed[5], 3.0)
    assert_array_equal(metrics.ospa_curve(truth[:, :0], tracks[:, :0], 2.0), np.zeros(0))
    assert metrics.gospa_curve(truth[:, :0], tracks[:, :0], 2.0).distance.shape == (0,)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.ospa([1.0], [[1.0]], 1.0), "x: expected shape"),
        (lambda: metrics.ospa([[1.0]], [[1.0, 2.0]], 1.0), "y: expected points of 1 components"),
        (lambda: metrics.ospa([[np.inf]], [[1.0]], 1.0), "x: infinite"),
        (lambda: metrics.ospa([[1.0]], [[1.0]], 0.0), "cutoff: expected a number above 0"),
        (lambda: metrics.ospa([[1.0]], [[1.0]], 1.0, 0.5), "order: expected .* at least 1"),
        (lambda: metrics.gospa([[1.0]], [[1.0]], 1.0, np.inf), "order: expected a finite"),
        (lambda: metrics.gospa([[1.0]], [[1.0]], 1.0, 1, 2.5), "alpha: .*at most 2"),
        (lambda: metrics.gospa([[1.0]], [[1.0]], 1.0, 1, 0.0), "alpha: expected a number above"),
        (lambda: metrics.ospa_curve(np.ones((1, 2, 2)), np.ones((1, 3, 2)), 1.0), "2 scans"),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
