"""The search for the global minimum: minimal sets, distant sources, flat arrays, satellites."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from locate_cases import (
    HO_XU,
    HO_XU_NEAR,
    HO_XU_SOURCE_VELOCITY,
    HO_XU_VELOCITY,
    differences,
    distances,
    geometries,
    information,
)
from numpy.testing import assert_allclose

from imm_tdoa import Stations
from imm_tdoa.contract import Measurement
from imm_tdoa.locate import fix_scans, gauss_newton
from imm_tdoa.models import TDOA
from imm_tdoa.scans import Scans


def near(points, truth, scale):
    """Whether any of the points, of which some may be None, is the truth."""
    return any(p is not None and np.linalg.norm(p - truth) <= scale for p in points)


@settings(deadline=None, max_examples=80)
@given(data=st.data(), dims=st.sampled_from([2, 3]))
def test_a_minimal_set_gives_the_emitter_or_names_it_as_the_mirror(data, dims):
    stations, p = data.draw(geometries(dims, dims + 1, reach=10.0))
    z = differences(distances(p, stations.positions))
    fix = gauss_newton(stations, z, toa_sigma=1e-3, speed=1.0)
    scale = np.sqrt(np.trace(np.linalg.inv(information(p, stations.positions, 1e-3))))
    assert bool(fix.converged)
    assert near((fix.position, fix.mirror), p, 1e-2 * scale + 1e-6)
    if fix.mirror is not None:
        centre = stations.positions.mean(axis=0)
        assert np.linalg.norm(fix.position - centre) <= np.linalg.norm(fix.mirror - centre) * 1.001


@settings(deadline=None, max_examples=80)
@given(data=st.data(), dims=st.sampled_from([2, 3]), extra=st.integers(2, 4))
def test_with_a_station_to_spare_the_emitter_is_found(data, dims, extra):
    stations, p = data.draw(geometries(dims, dims + extra, reach=10.0))
    z = differences(distances(p, stations.positions))
    fix = gauss_newton(stations, z, toa_sigma=1e-3, speed=1.0)
    scale = np.sqrt(np.trace(np.linalg.inv(information(p, stations.positions, 1e-3))))
    assert bool(fix.converged)
    if fix.mirror is None:
        assert near((fix.position,), p, 1e-2 * scale + 1e-6)
    else:
        assert near((fix.position, fix.mirror), p, 1e-2 * scale + 1e-6)


def check(stations, p, z, sigma, **arguments):
    """The search finds what the iteration begun at the truth finds, or something that fits better.

    Returns whether there was a minimum near the truth to be found.
    """
    fix = gauss_newton(stations, z, toa_sigma=sigma, speed=1.0, **arguments)
    known = gauss_newton(stations, z, toa_sigma=sigma, speed=1.0, initial=p, **arguments)
    if not bool(known.converged):
        return False
    assert bool(fix.converged)
    assert fix.chi2 <= known.chi2 + 1e-3
    return True


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("sigma", [1e-3, 1.0])
def test_sources_up_to_twenty_times_as_far_as_the_array_is_wide(dims, sigma):
    rng = np.random.default_rng(20)
    found = 0
    for _ in range(40):
        s = rng.uniform(-1e3, 1e3, (dims + 1 + int(rng.integers(0, 4)), dims))
        direction = rng.normal(size=dims)
        p = direction / np.linalg.norm(direction) * np.exp(rng.uniform(np.log(1e3), np.log(4e4)))
        z = differences(distances(p, s) + rng.normal(0.0, sigma, len(s)))
        found += check(Stations(s), p, z, sigma)
    assert found > 30


@pytest.mark.parametrize("roughness", [20.0, 500.0])
def test_stations_on_the_ground_and_an_emitter_above(roughness):
    """Below the ground lies a second minimum that fits nearly as well."""
    rng = np.random.default_rng(21)
    found = 0
    for _ in range(40):
        S = int(rng.integers(5, 9))
        s = np.column_stack([rng.uniform(-2e4, 2e4, (S, 2)), rng.uniform(0.0, roughness, S)])
        p = np.array([*rng.uniform(-6e4, 6e4, 2), rng.uniform(500.0, 12e3)])
        z = differences(distances(p, s) + rng.normal(0.0, 1.0, S))
        found += check(Stations(s), p, z, 1.0)
    assert found > 30


def test_satellites_around_a_receiver_near_the_origin():
    """The same equations with the roles exchanged: 20 000 km up, the earth inside the array."""
    rng = np.random.default_rng(22)
    for _ in range(30):
        direction = rng.normal(size=3)
        p = 6.37e6 * direction / np.linalg.norm(direction)
        s = rng.normal(size=(60, 3))
        s = 26.6e6 * s / np.linalg.norm(s, axis=-1, keepdims=True)
        risen = (s - p) @ p > 0.1 * 6.37e6 * distances(p, s)
        s = s[risen][: int(rng.integers(5, 11))]
        z = differences(distances(p, s) + rng.normal(0.0, 3.0, len(s)))
        assert check(Stations(s), p, z, 3.0)


def test_five_of_sixty_stations_across_a_thousand_kilometres():
    rng = np.random.default_rng(23)
    found = 0
    for _ in range(30):
        ground = rng.uniform(-5e5, 5e5, (60, 2))
        s = np.column_stack(
            [ground, rng.uniform(0.0, 300.0, 60) - np.sum(ground**2, axis=-1) / 12.74e6]
        )
        place = rng.uniform(-5e5, 5e5, 2)
        p = np.append(place, rng.uniform(1e3, 12e3) - place @ place / 12.74e6)
        r = distances(p, s)
        hear = np.argsort(r)[:8][rng.permutation(8)[:5]]
        r = r + rng.normal(0.0, 20.0, 60)
        pairs = np.array([[i, hear[0]] for i in range(60) if i != hear[0]])
        z = np.where(np.isin(pairs[:, 0], hear), r[pairs[:, 0]] - r[hear[0]], np.nan)
        found += check(Stations(s), p, z, 20.0, pairs=pairs)
    assert found > 25


def test_time_and_frequency_differences_are_searched_together():
    rng = np.random.default_rng(24)
    p, v = HO_XU_NEAR, HO_XU_SOURCE_VELOCITY
    r = distances(p, HO_XU)
    rate = np.sum((p - HO_XU) * (v - HO_XU_VELOCITY), axis=-1) / r
    for _ in range(15):
        z = differences(r + rng.normal(0.0, 0.2, 5))
        rates = differences(rate + rng.normal(0.0, 0.07, 5))
        stations = Stations(HO_XU, velocities=HO_XU_VELOCITY)
        assert check(stations, p, z, 0.2, range_rate=rates, range_rate_sigma=0.07)


@pytest.mark.parametrize("moving", [False, True])
def test_one_difference_at_a_time(moving):
    """No scan determines a place by itself: the star around the stations has to do."""
    rng = np.random.default_rng(25)
    std = np.array([20.0, 20.0])
    for _ in range(25):
        s = rng.uniform(-1e3, 1e3, (6, 2))
        p, v = rng.uniform(-3e3, 3e3, 2), moving * rng.normal(0.0, 10.0, 2)
        times = np.arange(10.0)
        pairs = np.array([[rng.permutation(6)[:2]] for _ in times])
        path = p + (times - times[-1])[:, None] * v
        r = np.sqrt(np.sum((path[:, None] - s) ** 2, axis=-1)) + rng.normal(0.0, 0.5, (10, 6))
        z = [[r[k, i] - r[k, j]] for k, ((i, j),) in enumerate(pairs)]
        scans = Scans.checked(TDOA(Stations(s), toa_sigma=0.5, speed=1.0), times, z, pairs)
        arguments = {"moving": moving, "velocity_std": std if moving else None}
        known = fix_scans(scans, initial=p, **arguments)
        fix = fix_scans(scans, **arguments)
        if bool(known.converged):
            assert bool(fix.converged)
            assert fix.chi2 <= known.chi2 + 1e-3


class Bearings(Measurement):
    """Directions in which stations see the emitter, rad: nothing that knows ranges."""

    def __init__(self, stations, sigma):
        self.stations, self.sigma = np.asarray(stations, float), sigma

    dims = 2

    @property
    def size(self):
        return len(self.stations)

    @property
    def angular(self):
        return np.ones(self.size, dtype=bool)

    def predict(self, position, velocity, time):
        d = position[..., None, :] - self.stations
        return np.arctan2(d[..., 1], d[..., 0])

    def jacobian(self, position, velocity, time):
        d = position[..., None, :] - self.stations
        H = np.stack([-d[..., 1], d[..., 0]], axis=-1) / np.sum(d**2, axis=-1)[..., None]
        return H, np.zeros_like(H)

    def noise_covariance(self, position, velocity, time):
        return self.sigma**2 * np.eye(self.size)

    def anchors(self, time, present):
        return np.where(present[..., None], self.stations, np.nan)


def test_a_measurement_of_another_kind_is_searched_too():
    """Bearings of two sides of the cut at 180 degrees: residuals are wrapped."""
    s = np.array([(0, 0), (300, 800), (-200, -700)], float)
    rng = np.random.default_rng(26)
    for _ in range(20):
        p = np.array([-4000.0, 0.0]) + rng.uniform(-1500, 1500, 2)
        d = p - s
        bearing = np.arctan2(d[:, 1], d[:, 0]) + rng.normal(0.0, 1e-3, 3)
        bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
        fix = fix_scans(Scans.checked(Bearings(s, 1e-3), [0.0], bearing[None]))
        assert bool(fix.converged)
        error = fix.position - p
        assert error @ np.linalg.solve(fix.covariance, error) < 25.0
        A = sum(
            np.outer(n, n) / (1e-6 * (e @ e) ** 2)
            for e in fix.position - s
            for n in [np.array([-e[1], e[0]])]
        )
        assert_allclose(fix.covariance, np.linalg.inv(A), rtol=1e-4)
