"""The other place that explains the data as well: both are reported, where there are two."""

from __future__ import annotations

import numpy as np
import pytest
from locate_cases import GROUND, RING, differences, distances
from numpy.testing import assert_allclose

from imm_tdoa import Stations
from imm_tdoa.locate import gauss_newton


def test_two_roots_are_both_reported():
    """Three stations in the plane: both crossings of the hyperbolas fit exactly."""
    s = RING[:3]
    p = np.array([-150.0, -250.0])
    z = differences(distances(p, s))
    fix = gauss_newton(Stations(s), z, toa_sigma=1e-3, speed=1.0)
    assert fix.ambiguous
    for root in (fix.position, fix.mirror):
        assert_allclose(differences(distances(root, s)), z, atol=1e-7)
    assert np.linalg.norm(fix.position - fix.mirror) > 1.0
    assert min(np.linalg.norm(x - p) for x in (fix.position, fix.mirror)) < 1e-5


@pytest.mark.parametrize("dims", [2, 3])
def test_the_image_in_a_flat_array_is_reported(dims):
    rng = np.random.default_rng(5)
    s = np.zeros((6, dims))
    s[:, : dims - 1] = rng.uniform(-1e3, 1e3, (6, dims - 1))
    p = np.append(rng.uniform(-1e3, 1e3, dims - 1), 800.0)
    z = differences(distances(p, s))
    fix = gauss_newton(Stations(s), z, toa_sigma=1e-3, speed=1.0)
    assert_allclose(fix.position, p, atol=1e-4)
    assert_allclose(fix.mirror, np.append(p[:-1], -800.0), atol=1e-4)


def test_a_mirror_is_reported_only_where_it_fits():
    """A sixth station above the plane of the others tells the two sides apart."""
    s = GROUND.copy()
    s[:, 2] = 0.0
    p = np.array([7e3, 9e3, 4e3])
    z = differences(distances(p, s))
    assert gauss_newton(Stations(s), z, toa_sigma=1.0, speed=1.0).ambiguous
    s[5, 2] = 500.0
    z = differences(distances(p, s))
    fix = gauss_newton(Stations(s), z, toa_sigma=1.0, speed=1.0)
    assert not fix.ambiguous
    assert_allclose(fix.position, p, atol=1e-2)
