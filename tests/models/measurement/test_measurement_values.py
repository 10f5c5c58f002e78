"""Measurement models against numbers by hand and against independent formulations."""

from __future__ import annotations

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imm_tdoa import Stations
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.gaussian import offset_contrast
from imm_tdoa.models import FDOA, TDOA, TOA, Height, Position, RangeRate
from imm_tdoa.testing.strategies import kinematics, present_rows, station_arrays, station_pairs

C = 299792458.0
SQUARE = Stations([[0.0, 0.0], [6.0, 0.0], [0.0, 8.0]])
HERE, STILL = np.array([3.0, 4.0]), np.zeros(2)
quick = settings(max_examples=25, deadline=None, database=None, derandomize=True)


def test_tdoa_by_hand():
    """Emitter at (3, 4): all three stations are 5 m away; at (0, 0) they are 0, 6 and 8 m away."""
    model = TDOA(SQUARE, toa_sigma=1e-9)
    np.testing.assert_allclose(model.predict(HERE, STILL, 0.0), [0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(model.predict(np.zeros(2), STILL, 0.0), [6.0, 8.0])
    H, Hv = model.jacobian(HERE, STILL, 0.0)  # u_0 = (.6, .8), u_1 = (-.6, .8), u_2 = (.6, -.8)
    np.testing.assert_allclose(H, [[-1.2, 0.0], [0.0, -1.6]])
    assert not np.any(Hv)
    assert np.array_equal(model.scale, [C, C])


def test_the_sign_is_station_minus_reference():
    """Nearer to the reference, the pulse arrives later at the other station: positive."""
    near = np.array([1.0, 0.0])
    assert TDOA(SQUARE, toa_sigma=1e-9).predict(near, STILL, 0.0)[0] == pytest.approx(4.0)
    back = TDOA(SQUARE, toa_sigma=1e-9, pairs=[[0, 1]])
    assert back.predict(near, STILL, 0.0)[0] == pytest.approx(-4.0)


def test_covariances_by_hand():
    """§1.1: I + 1 1' for a shared reference, tridiagonal for adjacent pairs, m²."""
    sigma = 10.0 / C
    R = TDOA(SQUARE, toa_sigma=sigma).noise_covariance(HERE, STILL, 0.0)
    np.testing.assert_allclose(R, 100.0 * np.array([[2.0, 1.0], [1.0, 2.0]]))
    four = Stations([[0.0, 0.0], [6.0, 0.0], [0.0, 8.0], [9.0, 9.0]])
    R = TDOA(four, toa_sigma=sigma, pairs="adjacent").noise_covariance(HERE, STILL, 0.0)
    np.testing.assert_allclose(R, 100.0 * (2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)))
    R = TDOA(SQUARE, tdoa_sigma=[1 / C, 2 / C]).noise_covariance(HERE, STILL, 0.0)
    np.testing.assert_allclose(R, np.diag([1.0, 4.0]))
    R = TDOA(SQUARE, toa_sigma=[3 / C, 1 / C, 2 / C]).noise_covariance(HERE, STILL, 0.0)
    np.testing.assert_allclose(R, [[10.0, 9.0], [9.0, 13.0]])
    R = FDOA(SQUARE, range_rate_sigma=0.5).noise_covariance(HERE, STILL, 0.0)
    np.testing.assert_allclose(R, [[0.5, 0.25], [0.25, 0.5]])
    R = FDOA(SQUARE, difference_sigma=0.5).noise_covariance(HERE, STILL, 0.0)
    np.testing.assert_allclose(R, [[0.25, 0.0], [0.0, 0.25]])


def test_fdoa_by_hand():
    """u_0 = (.6, .8), u_1 = (-.6, .8), u_2 = (.6, -.8); v = (10, 5), station 1 moves along x."""
    moving = Stations(SQUARE.positions, velocities=[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    v = np.array([10.0, 5.0])
    rates = [10.0, -0.6 * 9.0 + 4.0, 2.0]
    np.testing.assert_allclose(RangeRate(moving, sigma=1.0).predict(HERE, v, 0.0), rates)
    fdoa = FDOA(moving, range_rate_sigma=1.0).predict(HERE, v, 0.0)
    np.testing.assert_allclose(fdoa, [rates[1] - rates[0], rates[2] - rates[0]])


@quick
@given(st.data(), st.sampled_from([1, 2, 3]), st.booleans())
def test_pairs_against_a_loop_over_them(data, dims, moving):
    stations = data.draw(station_arrays(dims, moving=moving))
    pairs = data.draw(station_pairs(len(stations)))
    sigma = np.arange(1.0, len(stations) + 1.0)
    model = TDOA(stations, toa_sigma=sigma / C, pairs=pairs)
    k = data.draw(kinematics(model))
    place = stations.at(k.time)[0]
    r = [float(np.sqrt(sum((k.position - s) ** 2))) for s in place]
    rows = [r[a] - r[b] for a, b in pairs]
    np.testing.assert_allclose(model.predict(*k), rows, atol=1e-9)
    R = model.noise_covariance(*k)
    for i, (a, b) in enumerate(pairs):
        for j, (c, d) in enumerate(pairs):
            same = sigma**2 @ ((np.arange(len(r)) == a) * (1.0 * (a == c) - (a == d)))
            same += sigma**2 @ ((np.arange(len(r)) == b) * (1.0 * (b == d) - (b == c)))
            assert R[i, j] == pytest.approx(same, abs=1e-9)


@quick
@given(st.data(), st.booleans())
def test_range_rates_are_the_change_of_ranges(data, moving):
    """d/dt of the range between an emitter and stations that both go their way."""
    stations = data.draw(station_arrays(3, moving=moving))
    model = RangeRate(stations, sigma=1.0)
    k = data.draw(kinematics(model))
    place, speed = stations.at(k.time)
    h = 1e-3 * np.linalg.norm(k.position - place, axis=-1).min() / 500.0

    def ranges(t):
        return np.linalg.norm(k.position + t * k.velocity - place - t * speed, axis=-1)

    change = (8.0 * (ranges(h) - ranges(-h)) - (ranges(2 * h) - ranges(-2 * h))) / (12.0 * h)
    np.testing.assert_allclose(model.predict(*k), change, rtol=1e-6, atol=1e-6)


@quick
@given(st.data(), st.booleans())
def test_arrivals_say_what_their_differences_say(data, uncertain):
    """TOA less its offset has the information of TDOA with toa_sigma; RangeRate that of FDOA."""
    stations = data.draw(station_arrays(2, uncertain=uncertain))
    sigma = np.arange(1.0, len(stations) + 1.0)
    k = data.draw(kinematics(TDOA(stations, toa_sigma=1.0)))
    heard = data.draw(present_rows(len(stations), low=2))
    couples = [
        (TOA(stations, sigma=sigma / C), TDOA(stations, toa_sigma=sigma / C)),
        (RangeRate(stations, sigma=sigma), FDOA(stations, range_rate_sigma=sigma)),
    ]
    for single, difference in couples:
        H, R = np.hstack(single.jacobian(*k)), single.noise_covariance(*k)
        T, left = offset_contrast(np.diag(R), heard, single.offset_group)
        A = T[left]
        free = (A @ H).T @ np.linalg.solve(A @ R @ A.T, A @ H)
        there = np.flatnonzero(heard)
        pairs = [[i, there[0]] for i in there[1:]]
        model = difference.with_pairs(pairs)
        G = np.hstack(model.jacobian(*k))
        info = G.T @ np.linalg.solve(model.noise_covariance(*k), G)
        U = np.abs(H[heard])
        scale = U.T @ np.linalg.inv(R[np.ix_(heard, heard)]) @ U
        assert np.all(np.abs(free - info) <= 1e-9 * scale + 1e-300)


def test_a_loop_of_shared_arrivals_is_cut():
    model = TDOA(SQUARE, toa_sigma=1e-9, pairs=[[1, 0], [2, 1], [0, 2]])
    every = np.ones(3, dtype=bool)
    assert model.independent(every).tolist() == [True, True, False]
    assert model.independent(np.array([True, False, True])).tolist() == [True, False, True]
    assert TDOA(SQUARE, tdoa_sigma=1e-9, pairs=model.pairs).independent(every).all()
    np.testing.assert_allclose(model.predict(np.zeros(2), STILL, 0.0).sum(), 0.0, atol=1e-15)


def test_anchors_are_the_stations_behind_the_rows():
    model = TDOA(SQUARE, toa_sigma=1e-9)
    where = model.anchors(0.0, np.array([False, True]))
    np.testing.assert_array_equal(where, [[0.0, 0.0], [np.nan, np.nan], [0.0, 8.0]])
    where = TOA(SQUARE, sigma=1e-9).anchors(0.0, np.array([False, True, True]))
    np.testing.assert_array_equal(where, [[np.nan, np.nan], [6.0, 0.0], [0.0, 8.0]])
    assert Position(dims=3).anchors(0.0, np.ones(3, dtype=bool)).shape == (0, 3)


def test_a_station_that_is_not_heard_gives_nan():
    path = np.array([SQUARE.positions, SQUARE.positions + 10.0])
    path[1, 2] = np.nan
    model = TDOA(Stations(path, times=[0.0, 10.0]), toa_sigma=1e-9)
    rows = model.predict(HERE, STILL, 5.0)
    assert np.isfinite(rows[0])
    assert np.isnan(rows[1])


def test_sampled_noise_with_a_gap_spoils_only_its_own_rows():
    """NaN in a sampled toa_sigma: that station was not measured then; the others were."""
    four = Stations([[0.0, 0.0], [6.0, 0.0], [0.0, 8.0], [9.0, 9.0]])
    sigma = np.array([[1.0, 2.0, np.nan, 3.0], [1.0, 1.0, 1.0, 1.0]])
    for model in (
        TDOA(four, toa_sigma=sigma / C, sigma_times=[0.0, 1.0]),
        FDOA(four, range_rate_sigma=sigma, sigma_times=[0.0, 1.0]),
    ):
        R = model.noise_covariance(HERE, STILL, 0.0)
        expected = [[5.0, np.nan, 1.0], [np.nan, np.nan, np.nan], [1.0, np.nan, 10.0]]
        np.testing.assert_allclose(R, expected)
        R = model.noise_covariance(HERE, STILL, np.array([1.0, 0.0]))
        np.testing.assert_allclose(R, [np.eye(3) + 1.0, expected])


def test_sampled_noise_holds_at_its_times_only():
    model = Position(sigma=[[1.0], [2.0]], dims=1, sigma_times=[0.0, 5.0])
    R = model.noise_covariance(np.zeros((2, 1)), np.zeros((2, 1)), np.array([5.0, 0.0]))
    np.testing.assert_allclose(R, [[[4.0]], [[1.0]]])
    with pytest.raises(ValueError, match=r"sigma: no standard deviation was given for time 2\.5"):
        model.noise_covariance(np.zeros(1), np.zeros(1), 2.5)


def test_height_against_the_geodesy_library():
    """The ellipsoid falls away from the tangent plane: 8 m at 10 km."""
    frame = EastNorthUp(47.4, 8.5, 430.0)
    place = pymap3d.geodetic2enu(47.5, 8.7, 1234.5, 47.4, 8.5, 430.0)
    model = Height(sigma=5.0, frame=frame)
    assert model.predict(np.array(place), np.zeros(3), 0.0)[0] == pytest.approx(1234.5, abs=1e-6)
    far = model.predict(np.array([1e4, 0.0, 0.0]), np.zeros(3), 0.0)[0]
    assert far - 430.0 == pytest.approx(1e4**2 / (2 * 6.388e6), rel=2e-3)
    flat = Height(sigma=5.0).predict(np.array([1e4, 0.0, 70.0]), np.zeros(3), 0.0)
    np.testing.assert_array_equal(flat, [70.0])


def test_position_is_itself():
    model = Position(sigma=[1.0, 2.0, 3.0], dims=3)
    p = np.array([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(model.predict(p, p, 0.0), p)
    np.testing.assert_allclose(model.noise_covariance(p, p, 0.0), np.diag([1.0, 4.0, 9.0]))
