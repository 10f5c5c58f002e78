"""How sure a Monte-Carlo figure is: intervals, tests, and groups that cannot be told apart.

Pure functions on arrays with leading batch axes; NaN in, NaN out.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri, ndtri, stdtr, stdtrit

from imm_tdoa.contract import Array, Mask

SMALLEST = 1e-9  # relative standard errors below it are rounding, not knowledge


class Interval(NamedTuple):
    """A figure with its confidence interval.

    Attributes
    ----------
    value, low, high : (...)
        The figure and the ends of its interval.
    """

    value: Array
    low: Array
    high: Array

    def map(self, function: Any) -> Interval:
        """Return the interval of an increasing function of the figure."""
        return Interval(*(np.asarray(function(x), dtype=float) for x in self))


def mean_interval(mean: Any, variance: Any, count: Any, confidence: float = 0.95) -> Interval:
    """Student's interval of a mean, for quantities that are not badly skewed.

    Parameters
    ----------
    mean, variance : (...)
        Of the sample; `variance` divides by count - 1.
    count : (...)
        Size of the sample. Fewer than two give no interval (NaN).
    confidence : float
        Share of intervals that cover.
    """
    mean, variance, count = _sample(mean, variance, count)
    half = _quantile(count, confidence) * _error(variance, count)
    return Interval(mean, mean - half, mean + half)


def mean_square_interval(
    mean: Any,
    variance: Any,
    count: Any,
    confidence: float = 0.95,
    skewness: Any = None,
) -> Interval:
    """Interval of the mean of squared errors, which are skewed to the right.

    Student's interval misses a mean of squares mostly from below: large squares are rare and a
    sample without one looks too precise. Hall's transformation (Hall, J. R. Statist. Soc. B 54,
    1992, 221-228, eq. (2.3)) takes the skewness out of the t statistic and back,

        g(T) = T + G T^2 / (3 sqrt(n)) + G^2 T^3 / (27 n) + G / (6 sqrt(n)),

    monotone in T, so both ends follow in closed form. G is the larger of the sample's skewness,
    which small samples underrate, and that of a gamma law with their mean and variance, twice the
    coefficient of variation, which is exact where errors are Gaussian in one direction.

    Parameters
    ----------
    mean, variance, count, confidence
        As in `mean_interval`; the mean is not negative.
    skewness : (...), optional
        Of the sample; left out, the gamma law's is taken.
    """
    mean, variance, count = _sample(mean, variance, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        G = 2.0 * np.sqrt(variance) / mean
        if skewness is not None:
            G = np.fmax(G, np.asarray(skewness, dtype=float))
        a = G / np.sqrt(count)
    sure = ~(np.abs(a) > 1e-9)  # nothing varies, or nothing is known
    a = np.where(sure, 1.0, a)
    z, error = _quantile(count, confidence), _error(variance, count)

    def back(y: Array) -> Array:
        straightened = 3.0 / a * (np.cbrt(1.0 + a * (y - a / 6.0)) - 1.0)
        return np.where(sure, y, straightened)

    low, high = mean - error * back(z), mean - error * back(-z)
    return Interval(mean, np.where(low < 0.0, 0.0, low), high)


def share_interval(hits: Any, count: Any, confidence: float = 0.95) -> Interval:
    """Wilson's interval of a share `hits / count` (Wilson, J. Am. Statist. Assoc. 22, 1927).

    Hits need not be whole numbers; a count of zero gives NaN.
    """
    hits, count = np.asarray(hits, dtype=float), np.asarray(count, dtype=float)
    z = float(ndtri(0.5 + 0.5 * confidence))
    with np.errstate(invalid="ignore", divide="ignore"):
        p = np.where(count > 0, hits / count, np.nan)
        middle = (p + z**2 / (2.0 * count)) / (1.0 + z**2 / count)
        half = z / (1.0 + z**2 / count) * np.sqrt(p * (1.0 - p) / count + z**2 / (4 * count**2))
    low = np.where(p == 0.0, 0.0, middle - half)  # exact there; rounding would leave 1e-19
    return Interval(p, low, np.where(p == 1.0, 1.0, middle + half))


def share_error(hits: Any, count: Any) -> Array:
    """Return the standard error (...) of a share `hits / count`.

    Two hits and two misses are added, as in Agresti & Coull, Am. Statist. 52, 1998: a share of 0
    or 1 found in few runs is not known exactly.
    """
    hits, count = np.asarray(hits, dtype=float), np.asarray(count, dtype=float)
    p = (hits + 2.0) / (count + 4.0)
    result: Array = np.sqrt(p * (1.0 - p) / (count + 4.0))
    return result


def mean_share_interval(mean: Any, variance: Any, count: Any, confidence: float = 0.95) -> Interval:
    """Interval of the mean of shares, one per run, that stays between 0 and 1.

    Wilson's interval with as many trials as would give a share the same standard error (the
    effective sample size of survey statistics: Korn & Graubard, Survey Methodology 24, 1998).

    Parameters
    ----------
    mean, variance, count, confidence
        As in `mean_interval`.
    """
    mean, variance, count = _sample(mean, variance, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        trials = mean * (1.0 - mean) * count / variance
    trials = np.where(variance > 0.0, np.maximum(trials, 1.0), count)
    found = share_interval(mean * trials, trials, confidence)
    known = count >= 2
    return Interval(mean, np.where(known, found.low, np.nan), np.where(known, found.high, np.nan))


def ratio_interval(
    mean: Any, variance: Any, covariance: Any, count: Any, confidence: float = 0.95
) -> Interval:
    """Interval of a ratio of two means over the same runs (Fieller, J. R. Stat. Soc. B 16, 1954).

    The ratios r for which a paired t test of a against r b does not reject; it leaves out 1
    exactly where `ratio_p` is below 1 - confidence.

    Parameters
    ----------
    mean, variance : pair of (...)
        Of numerator and denominator, which are not negative.
    covariance : (...)
        Between them.
    count : (...)
        Runs.
    """
    (a, b), (va, vb), c, n = _pair(mean, variance, covariance, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        k = _quantile(n, confidence) ** 2 / n
        A, B, C = b**2 - k * vb, a * b - k * c, a**2 - k * va
        root = np.sqrt(np.maximum(B**2 - A * C, 0.0))
        low, high = (B - root) / A, (B + root) / A
        unsure = A <= 0.0  # the denominator may be zero for all that is known
        low = np.where(unsure | (low < 0.0), 0.0, low)
        ratio = np.where(b > 0.0, a / b, np.nan)
    low = np.where(np.isnan(k) | np.isnan(ratio), np.nan, low)
    high = np.where(np.isnan(low), np.nan, np.where(unsure, np.inf, high))
    return Interval(ratio, low, high)


def ratio_p(mean: Any, variance: Any, covariance: Any, count: Any) -> Array:
    """Two-sided p-value (...) of two means over the same runs being equal: the paired t test.

    Differences of banks that are alike are symmetric however skewed their errors are, so the
    test keeps its level in small samples too.
    """
    (a, b), (va, vb), c, n = _pair(mean, variance, covariance, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sqrt(np.maximum(va + vb - 2.0 * c, 0.0) / n)
        least = SMALLEST * np.maximum(a, b)
        t = np.where(a == b, 0.0, np.abs(a - b) / np.maximum(error, least))
    result: Array = 2.0 * stdtr(
        np.where(n >= 2, n - 1.0, np.nan), np.where(np.isnan(va), np.nan, -t)
    )
    return result


def chi_square_region(dof: Any, confidence: float = 0.95) -> tuple[Array, Array]:
    """Where a chi-square variable of `dof` (...) divided by `dof` lies (Bar-Shalom, Li 2001, §5.4).

    The acceptance region of an average NEES over N runs and d components, divided by d, has
    dof = N d. No degree of freedom gives NaN.
    """
    dof = np.asarray(dof, dtype=float)
    tail = 0.5 * (1.0 - confidence)
    nu = np.where(dof > 0, dof, np.nan)
    return chdtri(nu, 1.0 - tail) / nu, chdtri(nu, tail) / nu


def holm(p: Any) -> Array:
    """Adjust p-values (..., K) for being K comparisons (Holm, Scand. J. Statist. 6, 1979).

    Rejecting all below 0.05 rejects any true hypothesis in at most 5 % of studies, however the
    tests depend on each other. NaN is no comparison.
    """
    p = np.asarray(p, dtype=float)
    order = np.argsort(p, axis=-1)  # NaN last
    ranked = np.take_along_axis(p, order, axis=-1)
    left = np.count_nonzero(~np.isnan(p), axis=-1, keepdims=True) - np.arange(p.shape[-1])
    stepped = np.maximum.accumulate(np.minimum(ranked * np.maximum(left, 1), 1.0), axis=-1)
    result = np.empty_like(stepped)
    np.put_along_axis(result, order, stepped, axis=-1)
    return result


def letters(different: Mask) -> tuple[str, ...]:
    """Give letters to B things in order, so that two share one exactly if not told apart.

    The compact letter display by insertion and absorption (Piepho, J. Comput. Graph. Statist. 13,
    2004, 456-466).

    Parameters
    ----------
    different : (B, B) bool
        Which pairs are told apart; the best comes first and gets "a".
    """
    different = np.asarray(different, dtype=bool)
    size = len(different)
    groups: list[frozenset[int]] = [frozenset(range(size))] if size else []
    for i, j in combinations(range(size), 2):
        if not (different[i, j] or different[j, i]):
            continue
        split = [part for g in groups for part in ((g - {i}, g - {j}) if {i, j} <= g else (g,))]
        unique = list(dict.fromkeys(split))
        groups = [g for g in unique if not any(g < other for other in unique)]
    ordered = sorted(groups, key=sorted)
    return tuple(
        "".join(_letter(k) for k, group in enumerate(ordered) if i in group) for i in range(size)
    )


def _letter(k: int) -> str:
    """a ... z, then a2 ... z2 and on."""
    round_, place = divmod(k, 26)
    return chr(ord("a") + place) + (str(round_ + 1) if round_ else "")


def _sample(mean: Any, variance: Any, count: Any) -> tuple[Array, Array, Array]:
    m, v, n = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (mean, variance, count)))
    return m, v, n


def _quantile(count: Array, confidence: float) -> Array:
    dof = np.where(count >= 2, count - 1.0, np.nan)
    result: Array = stdtrit(dof, 0.5 + 0.5 * confidence)
    return result


def _error(variance: Array, count: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(variance / np.where(count > 0, count, np.nan)))


def _pair(
    mean: Any, variance: Any, covariance: Any, count: Any
) -> tuple[tuple[Array, Array], tuple[Array, Array], Array, Array]:
    means, variances = (
        tuple(np.asarray(x, dtype=float) for x in pair) for pair in (mean, variance)
    )
    c, n = np.asarray(covariance, dtype=float), np.asarray(count, dtype=float)
    return (means[0], means[1]), (variances[0], variances[1]), c, np.where(n >= 1, n, np.nan)
