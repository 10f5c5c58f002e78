"""Scores against truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from imm_tdoa import metrics


def test_rmse_is_the_root_mean_square_length():
    error = np.array([[3.0, 4.0], [0.0, 0.0], [np.nan, 1.0]])
    assert_allclose(metrics.rmse(error), np.sqrt(12.5))
    both = np.stack([error, 2 * error])
    assert_allclose(metrics.rmse(both, axis=-1), [np.sqrt(12.5), 2 * np.sqrt(12.5)])
    assert_allclose(metrics.rmse(both[:, :2], axis=0), [np.sqrt(62.5), 0.0])


def test_rmse_of_nothing_is_nan():
    assert np.isnan(metrics.rmse(np.full((3, 2), np.nan)))
    got = metrics.rmse(np.array([[[np.nan, 0.0]], [[3.0, 4.0]]]), axis=-1)
    assert_array_equal(got, [np.nan, 5.0])


def test_nees_by_inverse():
    rng = np.random.default_rng(0)
    A, e = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3))
    P = A @ np.swapaxes(A, -1, -2)
    want = [x @ np.linalg.inv(C) @ x for x, C in zip(e, P, strict=True)]
    assert_allclose(metrics.nees(e, P), want, rtol=1e-8)
    assert_allclose(metrics.nis(e, P), want, rtol=1e-8)
    e[1, 0], P[2, 1, 1] = np.nan, np.nan
    got = metrics.nees(e, P)
    assert_array_equal(np.isnan(got), [False, True, True, False, False])
    assert_allclose(got[[0, 3, 4]], np.array(want)[[0, 3, 4]], rtol=1e-8)


def test_nees_of_a_matched_gaussian_is_chi_square():
    rng = np.random.default_rng(1)
    P = np.array([[4.0, 1.0], [1.0, 2.0]])
    e = rng.multivariate_normal(np.zeros(2), P, size=5000)
    # the mean of n chi-square variables of d degrees has variance 2 d / n
    assert abs(metrics.nees(e, P).mean() - 2.0) < 4 * np.sqrt(2 * 2.0 / 5000)


@pytest.mark.parametrize("probability", [0.5, 0.95, 0.99])
def test_error_radius_of_a_circle_a_ball_and_a_needle_is_exact(probability):
    for d in (1, 2, 3):
        want = 3.0 * np.sqrt(chi2.ppf(probability, d))
        assert_allclose(metrics.error_radius(9.0 * np.eye(d), probability), want, rtol=1e-12)
    needle = np.diag([9.0, 0.0])
    want = 3.0 * np.sqrt(chi2.ppf(probability, 1))
    assert_allclose(metrics.error_radius(needle, probability), want, rtol=1e-12)


def test_error_radius_of_an_ellipse_holds_its_probability():
    rng = np.random.default_rng(2)
    n = 20_000
    P = np.array([[4.0, 1.5], [1.5, 1.0]])
    r = np.linalg.norm(rng.multivariate_normal(np.zeros(2), P, size=n), axis=1)
    share = np.mean(r < metrics.error_radius(P))
    # 4 sigma of the binomial, and half a per cent for matching two moments only
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / n) + 0.005


def test_error_radius_keeps_the_batch_and_its_gaps():
    P = np.stack([np.eye(2), np.full((2, 2), np.nan), np.zeros((2, 2)), 4 * np.eye(2)])
    r = metrics.error_radius(P)
    assert r.shape == (4,)
    assert np.isnan(r[1])
    assert_allclose(r[[0, 2, 3]], np.array([1.0, 0.0, 2.0]) * np.sqrt(chi2.ppf(0.95, 2)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.rmse(3.0), r"error: expected shape \(\.\.\., d,\)"),
        (lambda: metrics.rmse([np.inf, 0.0]), "error: infinite"),
        (lambda: metrics.nees([1.0, 2.0], np.eye(3)), r"covariance: expected shape"),
        (lambda: metrics.nees([1.0, 2.0], np.zeros((2, 2))), "covariance: .*singular"),
        (lambda: metrics.error_radius(np.zeros((2, 3))), r"covariance: expected shape"),
        (lambda: metrics.error_radius(4.0), r"covariance: expected shape"),
        (lambda: metrics.error_radius(np.eye(2), 1.0), "probability: expected a probability"),
        (lambda: metrics.error_radius(np.eye(2), -0.1), "probability: expected a probability"),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
