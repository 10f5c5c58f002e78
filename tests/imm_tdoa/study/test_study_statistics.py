"""Intervals and tests against scipy, closed forms and the coverage they promise."""

from __future__ import annotations

import string
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from imm_tdoa.study.results import statistics

Law = Callable[[np.random.Generator, tuple[int, int]], Any]


def test_a_mean_has_students_interval() -> None:
    x = np.random.default_rng(0).normal(3.0, 2.0, (4, 15))
    found = statistics.mean_interval(x.mean(1), x.var(1, ddof=1), 15, 0.9)
    low, high = stats.t.interval(0.9, 14, x.mean(1), stats.sem(x, axis=1))
    np.testing.assert_allclose(found.low, low)
    np.testing.assert_allclose(found.high, high)
    alone = statistics.mean_interval([3.0], [np.nan], [1])
    assert alone.value == 3.0
    assert np.isnan([alone.low, alone.high]).all()


@pytest.mark.parametrize(("hits", "count"), [(0, 10), (3, 10), (10, 10), (17, 1000), (1, 1)])
def test_a_share_has_wilsons_interval(hits: int, count: int) -> None:
    found = statistics.share_interval(hits, count, 0.95)
    exact = stats.binomtest(hits, count).proportion_ci(0.95, method="wilson")
    np.testing.assert_allclose(found, (hits / count, exact.low, exact.high), atol=1e-15)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0


def test_nothing_seen_gives_no_share() -> None:
    assert np.isnan(statistics.share_interval(0, 0)).all()


def test_the_standard_error_of_a_share_is_never_zero() -> None:
    error = statistics.share_error([0.0, 50.0, 100.0], 100.0)
    np.testing.assert_allclose(error[1], np.sqrt(0.25 / 104.0))
    np.testing.assert_allclose(error[0], np.sqrt(2 / 104 * 102 / 104 / 104))
    np.testing.assert_allclose(error[0], error[2])


def test_the_region_of_an_average_nees() -> None:
    """50 runs of 2 components: [1.48, 2.59] (Bar-Shalom, Li & Kirubarajan; ALGORITHMS 11)."""
    low, high = statistics.chi_square_region(100.0)
    np.testing.assert_allclose([2.0 * low, 2.0 * high], [1.48, 2.59], atol=0.006)
    np.testing.assert_allclose([low, high], np.array(stats.chi2.interval(0.95, 100)) / 100)
    assert np.isnan(statistics.chi_square_region(0)).all()


def test_holm_on_paper() -> None:
    """Four p-values by hand: 4 x .005, 3 x .01, 2 x .03, and no smaller than the one before."""
    np.testing.assert_allclose(statistics.holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(
        statistics.holm([[0.5, np.nan, 0.01], [0.9, 0.8, np.nan]]),
        [[0.5, np.nan, 0.02], [1.0, 1.0, np.nan]],
    )


@given(st.integers(0, 6).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, 2**15 - 1))))
@settings(deadline=None, max_examples=150)
def test_letters_say_exactly_which_pairs_differ(case: tuple[int, int]) -> None:
    size, bits = case
    pairs = [(i, j) for i in range(size) for j in range(i)]
    different = np.zeros((size, size), dtype=bool)
    for k, (i, j) in enumerate(pairs):
        different[i, j] = different[j, i] = bool(bits >> k & 1)
    names = statistics.letters(different)
    assert len(names) == size
    for i, j in pairs:
        assert bool(set(names[i]) & set(names[j])) == (not different[i, j])
    used = sorted(set("".join(names)))
    assert used == list(string.ascii_lowercase[: len(used)])
    assert not size or "a" in names[0]


def test_letters_of_a_chain() -> None:
    """First and last differ, neighbours do not: the one between belongs to both."""
    different = np.zeros((3, 3), dtype=bool)
    different[0, 2] = different[2, 0] = True
    assert statistics.letters(different) == ("a", "ab", "b")


def _paired(n: int, seed: int = 3) -> tuple[Any, Any]:
    rng = np.random.default_rng(seed)
    common = rng.chisquare(3, n)
    return common + rng.chisquare(2, n), common + rng.chisquare(2, n) * 1.1


def _cov(a: Any, b: Any) -> Any:
    return (np.mean(a), np.mean(b)), (np.var(a, ddof=1), np.var(b, ddof=1)), np.cov(a, b)[0, 1]


def test_two_banks_are_compared_by_the_paired_t_test() -> None:
    a, b = _paired(40)
    found = statistics.ratio_interval(*_cov(a, b), 40, 0.9)
    np.testing.assert_allclose(statistics.ratio_p(*_cov(a, b), 40), stats.ttest_rel(a, b).pvalue)
    np.testing.assert_allclose(found.value, a.mean() / b.mean())
    for end in (found.low, found.high):  # where the same test of a against r b turns
        np.testing.assert_allclose(stats.ttest_rel(a, end * b).pvalue, 0.1)
    assert found.low < found.value < found.high


def test_the_same_runs_are_never_told_apart_and_certain_ones_are() -> None:
    a, _ = _paired(30)
    assert statistics.ratio_p(*_cov(a, a), 30) == 1.0
    np.testing.assert_allclose(statistics.ratio_interval(*_cov(a, a), 30), 1.0)
    assert statistics.ratio_p((2.0, 1.0), (0.0, 0.0), 0.0, 30) < 1e-200
    assert np.isnan(statistics.ratio_p((2.0, 1.0), (np.nan, np.nan), np.nan, 1))
    assert np.isnan(statistics.ratio_interval((2.0, 1.0), (np.nan, np.nan), np.nan, 1).low)
    lost = statistics.ratio_interval((2.0, 0.1), (0.0, 9.0), 0.0, 10)
    assert (lost.low, lost.high) == (0.0, np.inf)


def test_halls_transformation_ends_where_its_polynomial_says() -> None:
    mean, variance, n, skewness = 4.0, 9.0, 25, 2.3
    found = statistics.mean_square_interval(mean, variance, n, 0.95, skewness)
    for end, sign in ((found.low, 1.0), (found.high, -1.0)):
        T = (mean - end) / np.sqrt(variance / n)
        a = skewness / np.sqrt(n)
        g = T + a * T**2 / 3.0 + a**2 * T**3 / 27.0 + a / 6.0
        np.testing.assert_allclose(g, sign * stats.t.ppf(0.975, n - 1))
    assert found.high - mean > mean - found.low > 0.0
    gamma = statistics.mean_square_interval(mean, variance, n)  # 2 x 3 / 4 = 1.5
    np.testing.assert_allclose(gamma, statistics.mean_square_interval(mean, variance, n, 0.95, 1.5))


def test_squares_that_do_not_vary_are_certain() -> None:
    np.testing.assert_allclose(statistics.mean_square_interval(4.0, 0.0, 10), 4.0)
    np.testing.assert_allclose(statistics.mean_square_interval(0.0, 0.0, 10), 0.0)
    assert statistics.mean_square_interval(1.0, 400.0, 3, 0.95, 1.7).low >= 0.0


LAWS: dict[str, tuple[Law, float, tuple[int, ...]]] = {
    "gaussian-needle": (lambda r, s: r.chisquare(1, s), 1.0, (50, 1000)),
    "gaussian-circle": (lambda r, s: r.chisquare(2, s), 2.0, (20, 100)),
    "mean-of-many-scans": (lambda r, s: r.chisquare(20, s), 20.0, (10, 50)),
    "student-8": (lambda r, s: r.standard_t(8, s) ** 2, 8.0 / 6.0, (50, 300)),
    "lognormal": (lambda r, s: r.lognormal(0.0, 0.8, s), float(np.exp(0.32)), (50, 300)),
    "now-and-then-lost": (
        lambda r, s: r.chisquare(2, s) * np.where(r.random(s) < 0.05, 25.0, 1.0),
        4.4,
        (300, 1000),
    ),
}


@pytest.mark.parametrize(("law", "n"), [(k, n) for k, (*_, ns) in LAWS.items() for n in ns])
def test_an_rmse_covers_as_often_as_it_says(law: str, n: int) -> None:
    """95 % intervals of 1000 studies and more cover in 93 to 97 %, and miss on both sides."""
    draw, truth, _ = LAWS[law]
    x = draw(np.random.default_rng(11), (2500, n))
    found = statistics.mean_square_interval(
        x.mean(1), x.var(1, ddof=1), n, 0.95, stats.skew(x, axis=1, bias=False)
    )
    covered = np.mean((found.low <= truth) & (truth <= found.high))
    assert 0.93 <= covered <= 0.97
    assert 0.01 <= np.mean(found.low > truth) <= 0.045
    assert 0.01 <= np.mean(found.high < truth) <= 0.06


@pytest.mark.parametrize("n", [30, 200])
def test_an_rmse_over_time_covers_from_two_moments(n: int) -> None:
    x = np.random.default_rng(12).chisquare(2, (2500, n))
    found = statistics.mean_square_interval(x.mean(1), x.var(1, ddof=1), n)
    assert 0.93 <= np.mean((found.low <= 2.0) & (found.high >= 2.0)) <= 0.97


@pytest.mark.parametrize(
    ("mean", "spread", "n"), [(0.5, 4.0, 40), (0.9, 20.0, 60), (0.97, 9.0, 300)]
)
def test_a_mean_of_shares_covers(mean: float, spread: float, n: int) -> None:
    """Shares of 15 scans that hang together within a run."""
    rng = np.random.default_rng(13)
    own = rng.beta(mean * spread, (1.0 - mean) * spread, (2500, n))
    x = rng.binomial(15, own) / 15.0
    found = statistics.mean_share_interval(x.mean(1), x.var(1, ddof=1), n)
    assert 0.93 <= np.mean((found.low <= mean) & (found.high >= mean)) <= 0.97
    assert np.all((found.low >= 0.0) & (found.high <= 1.0))


def test_a_mean_of_equal_shares_is_wilsons() -> None:
    found = statistics.mean_share_interval(1.0, 0.0, 20)
    np.testing.assert_allclose(found, statistics.share_interval(20, 20))


def test_equal_banks_are_told_apart_as_often_as_agreed() -> None:
    """Four banks alike on heavy-tailed common runs: any pair falsely in at most 5 % of studies."""
    rng = np.random.default_rng(14)
    studies, n, B = 1500, 60, 4
    common = rng.lognormal(0.0, 0.7, (studies, 1, n))
    x = common * rng.chisquare(6, (studies, B, n))
    mean, variance = x.mean(2), x.var(2, ddof=1)
    p = []
    for i in range(B):
        for j in range(i):
            covariance = np.sum((x[:, i] - mean[:, i, None]) * (x[:, j] - mean[:, j, None]), 1) / (
                n - 1
            )
            pair = (mean[:, i], mean[:, j]), (variance[:, i], variance[:, j]), covariance, n
            p.append(statistics.ratio_p(*pair))
    single = np.mean(np.array(p) < 0.05)
    assert 0.035 <= single <= 0.065
    falsely = np.mean(np.any(statistics.holm(np.stack(p, axis=-1)) < 0.05, axis=-1))
    assert falsely <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / studies)


def test_pairing_sees_what_separate_intervals_do_not() -> None:
    a, _ = _paired(60)
    b = 1.05 * a + np.random.default_rng(5).normal(0.0, 0.05, 60)
    assert statistics.ratio_p(*_cov(a, b), 60) < 1e-6
    one, other = (statistics.mean_square_interval(x.mean(), x.var(ddof=1), 60) for x in (a, b))
    assert one.high > other.low
