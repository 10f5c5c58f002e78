"""The mean error of a covariance: by quadrature, and of needles, circles and spheres."""

from __future__ import annotations

import numpy as np
import pytest
from bounds_cases import spd
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import dblquad
from scipy.special import ellipe

from imm_tdoa import bounds


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_mean_error(seed):
    """§3.6 in the plane; in space the mean over all directions, by quadrature."""
    rng = np.random.default_rng(seed)
    C2 = spd(rng, 2, 10.0 ** rng.uniform(-3, 3))
    s2, s1 = np.linalg.eigvalsh(C2)
    assert_allclose(
        bounds.mean_error(C2), np.sqrt(2 / np.pi * s1) * ellipe(1 - s2 / s1), rtol=1e-10
    )
    C3 = spd(rng, 3)
    a, b, c = np.linalg.eigvalsh(C3)

    def length(u, azimuth):
        return np.sqrt(
            (1 - u**2) * (a * np.cos(azimuth) ** 2 + b * np.sin(azimuth) ** 2) + c * u**2
        )

    mean, _ = dblquad(length, 0.0, np.pi / 2, 0.0, 1.0)
    assert_allclose(bounds.mean_error(C3), np.sqrt(8 / np.pi) * mean / (np.pi / 2), rtol=1e-6)


def test_mean_error_of_needles_circles_and_spheres():
    assert_allclose(bounds.mean_error([[9.0]]), 3.0 * np.sqrt(2 / np.pi))
    assert_allclose(bounds.mean_error(np.diag([9.0, 0.0])), 3.0 * np.sqrt(2 / np.pi))
    assert_allclose(bounds.mean_error(9.0 * np.eye(2)), 3.0 * np.sqrt(np.pi / 2))
    assert_allclose(bounds.mean_error(9.0 * np.eye(3)), 3.0 * np.sqrt(8 / np.pi))
    assert bounds.mean_error(np.zeros((2, 2))) == 0.0
    unknown = np.array([np.diag([np.inf, 1.0]), np.full((2, 2), np.nan), np.eye(2)])
    assert_allclose(bounds.mean_error(unknown), [np.inf, np.nan, np.sqrt(np.pi / 2)])
    rng = np.random.default_rng(3)
    C3 = spd(rng, 3)
    lengths = np.linalg.norm(rng.multivariate_normal(np.zeros(3), C3, 200_000), axis=-1)
    error = lengths.std() / np.sqrt(len(lengths))
    assert_allclose(lengths.mean(), bounds.mean_error(C3), atol=4 * error)
    with pytest.raises(ValueError, match=r"covariance: expected shape \(..., d, d\) with d from 1"):
        bounds.mean_error(np.eye(4))
    with pytest.raises(ValueError, match="covariance: expected a positive semi-definite"):
        bounds.mean_error([[1.0, 2.0], [2.0, 1.0]])
