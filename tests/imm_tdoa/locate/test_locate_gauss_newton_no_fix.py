"""Where there is no fix: what is flagged, what is refused, and in which words."""

from __future__ import annotations

import numpy as np
import pytest
from locate_cases import GROUND, RING, differences, distances, noisy_differences
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Stations
from imm_tdoa.locate import fix_scans, gauss_newton, least_squares
from imm_tdoa.locate import gauss_newton as gauss_newton_function
from imm_tdoa.models import TOA
from imm_tdoa.scans import Scans


def test_fewer_differences_than_unknowns_are_refused():
    with pytest.raises(ValueError, match="stations: 1 independent measurements cannot determine 2"):
        gauss_newton(Stations(RING[:2]), [0.0], toa_sigma=1.0)
    with pytest.raises(ValueError, match=r"expected at least 3 differences \(4 stations\)"):
        gauss_newton(Stations(GROUND[:3]), [0.0, 0.0], toa_sigma=1.0)
    loop = [[1, 0], [2, 1], [2, 0]]
    with pytest.raises(ValueError, match="stations: 2 independent measurements cannot"):
        gauss_newton(Stations(GROUND[:3]), np.zeros(3), toa_sigma=1.0, pairs=loop)
    arrivals = Scans.checked(TOA(Stations(GROUND[:3]), sigma=1.0), [0.0], np.zeros((1, 3)))
    with pytest.raises(ValueError, match="stations: 2 independent measurements cannot"):
        fix_scans(arrivals)


def test_too_few_rows_left_are_no_fix():
    """What a batch misses here and there is flagged, never filled with a number."""
    z = noisy_differences(np.random.default_rng(0), np.array([900.0, 2100.0]), RING, 1.0, 3)
    z[1, 1:] = np.nan
    z[2] = np.nan
    fix = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0)
    assert_array_equal(fix.converged, [True, False, False])
    assert np.isnan(fix.position[1:]).all()
    assert np.isnan(fix.covariance[1:]).all()
    assert_array_equal(fix.dof, [3, 0, 0])
    assert_allclose(fix.position[0], [900.0, 2100.0], atol=20.0)


def test_a_line_of_stations_determines_no_place_in_space():
    s = np.zeros((6, 3))
    s[:, 0] = np.array([0.0, 1.0, 3.0, 4.5, 7.0, 9.0]) * 100.0
    p = np.array([350.0, 400.0, 500.0])
    for initial in (None, p):
        fix = gauss_newton(
            Stations(s), differences(distances(p, s)), toa_sigma=1.0, speed=1.0, initial=initial
        )
        assert not bool(fix.converged)
        assert np.isnan(fix.position).all()
        assert np.isnan(fix.covariance).all()


def test_differences_that_no_emitter_makes_do_not_converge():
    """Beyond the distance of the stations the misfit falls towards infinity."""
    s = RING[:3]
    fix = gauss_newton(Stations(s), [-2500.0, -2500.0], toa_sigma=1e-3, speed=1.0)
    assert not bool(fix.converged)
    assert fix.chi2 > 1e3 or np.isnan(fix.position).all()


def test_an_iteration_that_runs_out_has_not_converged(monkeypatch):
    p = np.array([9000.0, 7000.0])
    z = differences(distances(p, RING))
    full = gauss_newton(Stations(RING), z, toa_sigma=0.01, speed=1.0, initial=[400.0, 350.0])
    assert bool(full.converged)
    assert full.iterations > 3
    monkeypatch.setattr(least_squares, "ITERATIONS", 3)
    cut = gauss_newton(Stations(RING), z, toa_sigma=0.01, speed=1.0, initial=[400.0, 350.0])
    assert not bool(cut.converged)
    assert cut.iterations == 3


@pytest.mark.parametrize(
    ("values", "arguments", "message"),
    [
        (np.zeros(4), {}, "tdoa: expected shape"),
        (np.full(5, np.inf), {}, "tdoa: infinite values are refused"),
        (np.zeros(5), {"toa_sigma": -1.0}, "toa_sigma: expected"),
        (np.zeros(5), {"tdoa_sigma": 1.0}, "exactly one of toa_sigma"),
        (np.zeros(5), {"pairs": "star"}, "pairs: expected 'reference'"),
        (np.zeros(5), {"range_rate": np.zeros(5)}, "range_rate: give range_rate and"),
        (
            np.zeros(5),
            {"range_rate": np.zeros(4), "range_rate_sigma": 1.0},
            "range_rate: expected shape",
        ),
        (np.zeros(5), {"initial": [1.0, 2.0, 3.0]}, "initial: expected shape"),
        (np.zeros(5), {"robust": "huber"}, "robust: expected None or 'student-t'"),
        (np.zeros((2, 5)), {"times": [0.0, -1.0]}, "times: expected times that do not decrease"),
        (np.zeros((0, 5)), {}, "values: expected at least one fix"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(values, arguments, message):
    with pytest.raises(ValueError, match=message):
        gauss_newton_function(Stations(RING), values, **{"toa_sigma": 1.0, **arguments})
