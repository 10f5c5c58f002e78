"""Starting points in closed form, and the small tools around them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from locate_cases import HO_XU, HO_XU_VELOCITY, differences, distances, geometries
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Stations
from imm_tdoa.locate.choice import choose
from imm_tdoa.locate.closed_form import closed_form_points, places
from imm_tdoa.locate.normal import inverse
from imm_tdoa.locate.problem import Problem
from imm_tdoa.locate.pseudo_ranges import pseudo_ranges
from imm_tdoa.models import FDOA, TDOA, TOA, Height, Position, RangeRate, Stack
from imm_tdoa.scans import Scans

P = np.array([700.0, 900.0, 1300.0])


def problem(model, values, times=(0.0,), pairs=None, moving=False):
    return Problem.of(Scans.checked(model, np.array(times), values, pairs), moving, None)


@settings(deadline=None, max_examples=50)
@given(data=st.data(), dims=st.sampled_from([2, 3]), extra=st.integers(1, 4))
def test_exact_pseudo_ranges_lead_to_the_emitter(data, dims, extra):
    stations, p = data.draw(geometries(dims, dims + extra))
    s = stations.positions
    offset = data.draw(st.floats(-1e5, 1e5))
    found = places(s[None], distances(p, s)[None] + offset, np.ones((1, len(s)), dtype=bool))[0]
    assert found.shape == (4, dims)
    assert np.nanmin(np.linalg.norm(found - p, axis=-1)) < 1.0


@pytest.mark.parametrize("dims", [2, 3])
def test_a_flat_array_leads_to_both_sides(dims):
    rng = np.random.default_rng(0)
    s = np.zeros((dims + 2, dims))
    s[:, : dims - 1] = rng.uniform(-1e3, 1e3, (dims + 2, dims - 1))
    p = np.append(np.full(dims - 1, 300.0), 800.0)
    image = np.append(np.full(dims - 1, 300.0), -800.0)
    found = places(s[None], distances(p, s)[None], np.ones((1, len(s)), dtype=bool))[0]
    for truth in (p, image):
        assert np.nanmin(np.linalg.norm(found - truth, axis=-1)) < 1e-3


def test_stations_not_heard_do_not_count():
    heard = np.array([[True, True, False, True, True]])
    tau = distances(P, HO_XU)[None]
    garbled = np.where(heard, tau, 1e9)
    assert_allclose(places(HO_XU[None], garbled, heard), places(HO_XU[None], tau, heard))
    assert np.isnan(places(HO_XU[None], tau, heard & [[True, True, True, True, False]])).all()


STATIONS = Stations(HO_XU, velocities=HO_XU_VELOCITY)
PAIRS = np.array([[1, 0], [2, 1], [3, 1], [4, 3]])


@pytest.mark.parametrize(
    "model",
    [
        TDOA(STATIONS, toa_sigma=1e-8),
        TDOA(STATIONS, toa_sigma=1e-8, pairs=PAIRS, speed=343.0),
        TDOA(STATIONS, tdoa_sigma=1e-8, pairs=np.concatenate([PAIRS, [[0, 4], [2, 0]]])),
        TOA(STATIONS, sigma=1e-8),
        Stack(TDOA(STATIONS, toa_sigma=1e-8), FDOA(STATIONS, range_rate_sigma=0.1), Height(5.0)),
        Stack(RangeRate(STATIONS, sigma=0.1), TOA(STATIONS, sigma=1e-8)),
    ],
)
def test_pseudo_ranges_are_ranges_up_to_a_constant(model):
    """Recognised from predictions alone, among rows of other kinds, whatever the pairs."""
    v = np.array([10.0, -20.0, 5.0])
    values = (model.predict(P, v, 0.0) / model.scale)[None]
    s, tau, heard = pseudo_ranges(problem(model, values, moving=True))
    assert heard.all()
    for place, distance in zip(s[0], tau[0] - tau[0, 0], strict=True):
        k = int(np.argmin(distances(place, HO_XU)))
        assert_array_equal(place, HO_XU[k])
        expected = distances(P, place[None])[0] - distances(P, s[0, :1])[0]
        assert_allclose(distance, expected, atol=1e-4)


def test_the_fullest_scan_is_used_and_what_is_missing_is_not_heard():
    model = TOA(STATIONS, sigma=1e-8)
    t = distances(P, HO_XU) / 299_792_458.0
    values = np.stack([t, t, t])
    values[0, 1:] = np.nan
    values[1, 2] = np.nan
    values[2, :2] = np.nan
    s, tau, heard = pseudo_ranges(problem(model, values, times=(0.0, 1.0, 2.0)))
    assert heard.sum() == 4
    near = distances(s[0][heard[0]], HO_XU[2:3])[:, 0]
    assert near.min() > 1.0
    assert tau.shape == heard.shape


def test_other_measurements_have_no_closed_form():
    for model, values in (
        (Position([1.0, 1.0]), [[3.0, 4.0]]),
        (FDOA(STATIONS, range_rate_sigma=0.1), np.zeros((1, 4))),
    ):
        assert np.isnan(closed_form_points(problem(model, values, moving=True))).all()


def test_subsets_of_the_stations_outlive_a_gross_error():
    rng = np.random.default_rng(1)
    s = rng.uniform(-1e3, 1e3, (9, 2))
    p = np.array([1500.0, -400.0])
    t = distances(p, s)
    t[[2, 7]] += [900.0, -500.0]
    one = problem(TOA(Stations(s), sigma=1.0, speed=1.0), t[None])
    plain, robust = closed_form_points(one), closed_form_points(one, robust=True)
    assert np.nanmin(np.linalg.norm(plain - p, axis=-1)) > 10.0
    assert np.nanmin(np.linalg.norm(robust - p, axis=-1)) < 1e-3


def test_inverses_do_not_care_about_units():
    rng = np.random.default_rng(2)
    A = rng.normal(size=(5, 4, 4))
    A = A @ A.swapaxes(-1, -2) + 0.1 * np.eye(4)
    units = np.array([1.0, 1e3, 1e-4, 30.0])
    scaled = A * units[:, None] * units
    found, regular = inverse(scaled)
    assert regular.all()
    assert_allclose(found * units[:, None] * units, np.linalg.inv(A), rtol=1e-6)
    singular = np.array([[1.0, 1e5], [1e5, 1e10]])
    found, regular = inverse(np.stack([singular, np.eye(2), np.zeros((2, 2))]))
    assert_array_equal(regular, [False, True, False])
    assert np.isnan(found[0]).all()
    assert_array_equal(found[1], np.eye(2))


def pick(points, cost, usable=None):
    points = np.array(points, float)[None]
    K, d = points.shape[1:]
    usable = np.ones((1, K), dtype=bool) if usable is None else np.array([usable])
    information = np.broadcast_to(np.eye(d), (1, K, d, d))
    best, mirror = choose(points, np.array([cost], float), usable, information, np.zeros((1, d)))
    return int(best[0]), mirror[0]


def test_the_best_solution_and_its_rival():
    nan = [np.nan, np.nan]
    best, mirror = pick([(9, 9), (1, 1), (5, 5)], [7.0, 3.0, 30.0])
    assert best == 1
    assert_array_equal(mirror, (9, 9))
    best, mirror = pick([(9, 9), (1, 1)], [17.0, 3.0])
    assert_array_equal(mirror, nan)  # fits too badly to be a rival
    best, mirror = pick([(1.001, 1), (1, 1)], [3.0, 3.0])
    assert_array_equal(mirror, nan)  # the same place
    best, mirror = pick([(9, 9), (1, 1)], [3.0, 3.0])
    assert best == 1  # equally good: the nearer
    best, mirror = pick([(2, -3), (2, 3)], [3.0, 3.0 + 1e-9])
    assert best == 1  # equally near: the upper
    assert_array_equal(mirror, (2, -3))
    best, mirror = pick([(2, 3), (1, 1)], [1.0, 5.0], usable=[False, True])
    assert best == 1  # no minimum at the first
    assert_array_equal(mirror, nan)
    best, mirror = pick([nan, nan], [np.inf, np.inf], usable=[False, False])
    assert_array_equal(mirror, nan)
    best, mirror = pick([(1, 1), (2, 2)], [np.nan, 4.0], usable=[False, False])
    assert best == 1


def test_differences_of_the_test_oracle():
    """The helper that the other tests lean on: arrival minus reference arrival."""
    assert_array_equal(differences(np.array([1.0, 4.0, 9.0])), [3.0, 8.0])
    assert_array_equal(differences(np.array([1.0, 4.0, 9.0]), 1), [-3.0, 5.0])
