"""Moments of chunks, merged, against numpy and scipy on all runs at once."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from imm_tdoa.study.results.moments import Joint, Moments


@given(st.lists(st.integers(0, 9), min_size=1, max_size=6), st.integers(0, 2**20), st.booleans())
@settings(deadline=None, max_examples=60)
def test_chunks_add_up_to_the_whole(sizes: list[int], seed: int, holes: bool) -> None:
    rng = np.random.default_rng(seed)
    x = 1e3 + rng.gamma(1.0, 5.0, (2, sum(sizes)))
    y = x + rng.normal(0.0, 1.0, x.shape)
    if holes:
        x[rng.random(x.shape) < 0.3] = np.nan
    cuts = np.cumsum(sizes)[:-1]
    one: Moments | None = None
    two: Joint | None = None
    for u, v in zip(np.split(x, cuts, axis=1), np.split(y, cuts, axis=1), strict=True):
        m, j = Moments.of(u), Joint.of(u, v)
        one, two = (m, j) if one is None or two is None else (one.merged(m), two.merged(j))
    assert one is not None
    assert two is not None
    for row in range(2):
        known = x[row][~np.isnan(x[row])]
        pair = y[row][~np.isnan(x[row])]
        assert one.count[row] == two.count[row] == len(known)
        if len(known) == 0:
            assert np.isnan(one.average[row])
            continue
        np.testing.assert_allclose(one.average[row], known.mean())
        np.testing.assert_allclose(one.effective[row], known.sum() ** 2 / (known**2).sum())
        if len(known) < 2:
            assert np.isnan(one.variance[row])
            continue
        np.testing.assert_allclose(one.variance[row], known.var(ddof=1), rtol=1e-7)
        C = np.cov(known, pair)
        np.testing.assert_allclose(two.covariance[row], C[0, 1], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose([v[row] for v in two.variance], np.diag(C), rtol=1e-7)
        np.testing.assert_allclose(
            two.difference_variance[row], np.var(known - pair, ddof=1), rtol=1e-6, atol=1e-8
        )
        if len(known) > 2:
            skewness = stats.skew(known, bias=False)
            np.testing.assert_allclose(one.skewness[row], skewness, rtol=1e-5, atol=1e-6)


def test_pairs_leave_out_only_the_runs_that_one_of_the_two_lacks() -> None:
    x = np.array([[1.0, 2.0, 3.0, 6.0], [2.0, np.nan, 3.0, 4.0], [5.0, 5.0, 5.0, 5.0]])
    found = Joint.pairs(x)
    np.testing.assert_array_equal(found.count, [[4, 3, 4], [3, 3, 3], [4, 3, 4]])
    np.testing.assert_allclose(found.mean[0][0], [3.0, 10.0 / 3.0, 3.0])
    np.testing.assert_allclose(found.mean[1][0], [3.0, 3.0, 5.0])
    np.testing.assert_allclose(found.covariance[0, 1], np.cov([1, 3, 6], [2, 3, 4])[0, 1])


def test_a_few_large_runs_count_as_few() -> None:
    x = np.ones(1000)
    x[:3] = 1e6
    assert 2.9 < float(Moments.of(x).effective) < 3.1
    np.testing.assert_allclose(Moments.of(np.ones(50)).effective, 50.0)
