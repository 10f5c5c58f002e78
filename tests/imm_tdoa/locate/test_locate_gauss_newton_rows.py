"""Fixes from more than one scan of differences: epochs, range rates, arrivals, heights."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest
from locate_cases import (
    GROUND,
    HO_XU,
    HO_XU_FAR,
    HO_XU_NEAR,
    HO_XU_SOURCE_VELOCITY,
    HO_XU_VELOCITY,
    RING,
    C,
    differences,
    distances,
    information,
    mahalanobis,
    pairs_against,
)
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Stations, bounds
from imm_tdoa.locate import fix_scans, gauss_newton
from imm_tdoa.models import FDOA, TDOA, TOA, Height, Stack
from imm_tdoa.scans import Scans

fixing = import_module("imm_tdoa.locate.gauss_newton")  # hidden by the function of that name


def test_epochs_of_a_static_emitter_stack():
    """The information of several epochs, stations moving in between, is their sum."""
    times = np.array([0.0, 3.0, 5.0, 9.0])
    drift = np.array([(30, 5), (-10, 20), (5, -30), (0, 40), (-20, -20), (9, 9)], float)
    at = RING + times[:, None, None] * drift
    moving = Stations(np.stack([RING, RING + 9.0 * drift]), times=[0.0, 9.0])
    p = np.array([2500.0, 1700.0])
    r = np.stack([distances(p, s) for s in at])
    z = differences(r + np.random.default_rng(0).normal(0.0, 1.0, (50, 4, 6)))
    fix = gauss_newton(moving, z, toa_sigma=1.0, speed=1.0, times=times)
    assert fix.converged.all()
    assert_array_equal(fix.dof, 4 * 5 - 2)
    for position, covariance in zip(fix.position, fix.covariance, strict=True):
        total = sum(information(position, s, 1.0) for s in at)
        assert_allclose(covariance, np.linalg.inv(total), rtol=1e-6)


def test_the_time_of_a_single_epoch_says_where_the_stations_are():
    drift = np.array([(30, 5), (-10, 20), (5, -30), (0, 40), (-20, -20), (9, 9)], float)
    moving = Stations(np.stack([RING, RING + 10.0 * drift]), times=[100.0, 110.0])
    p = np.array([2500.0, 1700.0])
    z = differences(distances(p, RING + 4.0 * drift))
    fix = gauss_newton(moving, z[None] / C, toa_sigma=1e-8, times=[104.0])
    assert_allclose(fix.position, p, atol=1e-3)
    late = gauss_newton(moving, z[None] / C, toa_sigma=1e-8, times=[105.0])
    assert np.linalg.norm(late.position - p) > 10.0


def ho_xu_data(rng, p, variance, runs):
    """Range and range-rate differences of §12.2, (runs, 4) each, and their sigmas."""
    sigma, rate_sigma = np.sqrt(variance / 2.0), np.sqrt(0.1 * variance / 2.0)
    r = distances(p, HO_XU)
    rate = np.sum((p - HO_XU) * (HO_XU_SOURCE_VELOCITY - HO_XU_VELOCITY), axis=-1) / r
    z = differences(r + sigma * rng.normal(size=(runs, 5)))
    return z, differences(rate + rate_sigma * rng.normal(size=(runs, 5))), sigma, rate_sigma


@pytest.mark.parametrize("p", [HO_XU_FAR, HO_XU_NEAR])
def test_range_rates_give_position_and_velocity_at_the_bound(p):
    """Ho & Xu's geometry at -30 dB: the errors have the covariance of the bound."""
    runs = 800
    z, rates, sigma, rate_sigma = ho_xu_data(np.random.default_rng(7), p, 1e-3, runs)
    stations = Stations(HO_XU, velocities=HO_XU_VELOCITY)
    fix = gauss_newton(
        stations,
        z,
        toa_sigma=sigma,
        speed=1.0,
        range_rate=rates,
        range_rate_sigma=rate_sigma,
        initial=p,
    )
    assert fix.converged.all()
    assert fix.velocity.shape == (runs, 3)
    assert fix.covariance.shape == (runs, 6, 6)
    bound = bounds.crlb(
        stations,
        p,
        toa_sigma=sigma,
        velocity=HO_XU_SOURCE_VELOCITY,
        range_rate_sigma=rate_sigma,
        speed=1.0,
    )
    error = np.concatenate([fix.position - p, fix.velocity - HO_XU_SOURCE_VELOCITY], axis=-1)
    for part in (slice(0, 3), slice(3, 6)):
        square = np.sum(error[:, part] ** 2, axis=-1)
        tolerance = 4.0 * np.std(square) / np.sqrt(runs)
        assert abs(np.mean(square) - np.trace(bound[part, part])) < tolerance
    nees = mahalanobis(error, bound)
    assert abs(np.mean(nees) - 6.0) < 4.0 * np.std(nees) / np.sqrt(runs)
    assert abs(np.mean(fix.chi2) - 2.0) < 4.0 * np.sqrt(4.0 / runs)
    searched = gauss_newton(
        stations,
        z[:30],
        toa_sigma=sigma,
        speed=1.0,
        range_rate=rates[:30],
        range_rate_sigma=rate_sigma,
    )
    assert searched.converged.all()
    assert np.all(searched.chi2 <= fix.chi2[:30] + 1e-6)


def test_several_epochs_of_range_rates_follow_a_straight_motion():
    p, v = np.array([1200.0, -600.0]), np.array([-15.0, 22.0])
    times = np.array([0.0, 2.0, 3.0])
    path = p + (times - times[-1])[:, None] * v
    r = np.stack([distances(x, RING) for x in path])
    rate = np.stack([np.sum((x - RING) * v, axis=-1) / d for x, d in zip(path, r, strict=True)])
    fix = gauss_newton(
        Stations(RING),
        differences(r),
        toa_sigma=1.0,
        speed=1.0,
        range_rate=differences(rate),
        range_rate_sigma=0.1,
        times=times,
    )
    assert_allclose(fix.position, p, atol=1e-4)
    assert_allclose(fix.velocity, v, atol=1e-4)
    assert fix.dof == 3 * 5 * 2 - 4


def test_arrivals_and_differences_give_the_same_fix():
    p = np.array([1500.0, -800.0])
    rng = np.random.default_rng(3)
    sigma = rng.uniform(0.5, 2.0, 6)
    t = distances(p, RING) + sigma * rng.normal(size=(4, 6)) + 12_345.0
    t[1, 0] = t[2, 3] = np.nan
    toa = TOA(Stations(RING), sigma=sigma, speed=1.0)
    raw = fix_scans(Scans.checked(toa, [0.0], t[:, None]))
    for k in (0, 2, 3):
        tdoa = TDOA(Stations(RING), toa_sigma=sigma, speed=1.0)
        fix = fix_scans(Scans.checked(tdoa, [0.0], differences(t[k])[None]))
        assert_allclose(fix.position, raw.position[k], atol=1e-3)
        assert_allclose(fix.covariance, raw.covariance[k], rtol=1e-5)
        assert fix.dof == raw.dof[k]
    assert raw.dof[1] == 2  # without the reference of the others, nothing else is lost


def test_a_reported_height_is_one_more_row():
    stations = Stations(GROUND[:4])
    p = np.array([7e3, 9e3, 4e3])
    model = Stack(TDOA(stations, toa_sigma=1.0, speed=1.0), Height(5.0))
    values = np.append(differences(distances(p, GROUND[:4])), p[2])
    fix = fix_scans(Scans.checked(model, [0.0], values[None]))
    assert_allclose(fix.position, p, atol=1e-2)
    H = np.array([0.0, 0.0, 1.0])
    expected = np.linalg.inv(information(p, GROUND[:4], 1.0) + np.outer(H, H) / 25.0)
    assert_allclose(fix.covariance, expected, rtol=1e-5)
    assert fix.dof == 1
    assert not fix.ambiguous


def test_one_pair_at_a_time_of_a_moving_emitter():
    """A window of scans with one difference each, under a prior on the velocity."""
    rng = np.random.default_rng(12)
    times = np.arange(9.0)
    p, v, std = np.array([800.0, 1400.0]), np.array([12.0, -8.0]), np.array([20.0, 20.0])
    pairs = np.array([[rng.permutation(6)[:2]] for _ in times])
    path = p + (times - times[-1])[:, None] * v
    r = np.stack([distances(x, RING) for x in path]) + rng.normal(0.0, 0.5, (9, 6))
    index = np.arange(9)
    z = r[index, pairs[:, 0, 0]] - r[index, pairs[:, 0, 1]]
    model = TDOA(Stations(RING), toa_sigma=0.5, speed=1.0)
    scans = Scans.checked(model, times, z[:, None], pairs)
    fix = fix_scans(scans, moving=True, velocity_std=std)
    assert bool(fix.converged)
    assert fix.dof == 9 - 2
    A = np.diag([0.0, 0.0, *std**-2.0])
    x = np.concatenate([fix.position, fix.velocity])
    g = np.concatenate([[0.0, 0.0], -fix.velocity / std**2])
    for k in range(9):
        lever = np.concatenate([np.eye(2), (times[k] - times[-1]) * np.eye(2)], axis=1)
        here = lever @ x
        d = distances(here, RING)
        i, j = pairs[k, 0]
        H = ((here - RING[i]) / d[i] - (here - RING[j]) / d[j]) @ lever
        A += np.outer(H, H) / 0.5
        g += H * (z[k] - (d[i] - d[j])) / 0.5
    assert_allclose(fix.covariance, np.linalg.inv(A), rtol=1e-5)
    assert mahalanobis(g, A) < 1e-6
    assert mahalanobis(x - np.concatenate([p, v]), fix.covariance) < 20.0


def test_targets_with_their_own_times_and_pairs():
    rng = np.random.default_rng(13)
    drift = np.array([(30, 5), (-10, 20), (5, -30), (0, 40), (-20, -20), (9, 9)], float)
    moving = Stations(np.stack([RING, RING + 10.0 * drift]), times=[0.0, 10.0])
    times = np.array([[0.0, 1.0], [2.0, 7.0], [4.0, 4.5]])
    pairs = np.array([[pairs_against(6, k)[rng.permutation(5)] for k in (0, 3)] for _ in range(3)])
    p = rng.uniform(-2e3, 2e3, (3, 2))
    z = np.empty((3, 2, 5))
    for b, t in np.ndindex(3, 2):
        r = distances(p[b], RING + times[b, t] * drift)
        z[b, t] = r[pairs[b, t, :, 0]] - r[pairs[b, t, :, 1]]
    model = TDOA(moving, toa_sigma=1.0, speed=1.0)
    fix = fix_scans(Scans.checked(model, times, z, pairs))
    assert fix.converged.all()
    assert_allclose(fix.position, p, atol=1e-3)


@pytest.mark.parametrize("robust", [None, "student-t"])
def test_one_scan_says_nothing_of_the_velocity(monkeypatch, robust):
    """Solving for the position alone and adding the prior of the velocity is the whole solution."""
    rng = np.random.default_rng(5)
    p = rng.uniform(-4e3, 4e3, (30, 2))
    r = np.linalg.norm(p[:, None, :] - RING, axis=-1)
    z = differences(r + rng.normal(0.0, 1.0, r.shape))[:, None, :]
    z[3, 0, 2] = np.nan
    z[4, 0, 1:] = np.nan  # two stations: nowhere
    scans = Scans.checked(TDOA(Stations(RING), toa_sigma=1.0, speed=1.0), np.zeros(1), z)
    std = np.array([10.0, 20.0])
    short = fix_scans(scans, moving=True, velocity_std=std, robust=robust)
    monkeypatch.setattr(fixing, "_silent_on_velocity", lambda scans: False)
    whole = fix_scans(scans, moving=True, velocity_std=std, robust=robust)
    assert_array_equal(short.converged, whole.converged)
    assert not short.converged[4]
    assert np.isnan(short.velocity[4]).all()
    for name in ("position", "velocity", "covariance", "chi2", "dof", "mirror", "weight"):
        mine, other = getattr(short, name), getattr(whole, name)
        if other is None:
            assert mine is None
        else:
            scale = np.nanmax(np.abs(other)) if np.size(other) else 1.0
            assert_allclose(mine, other, rtol=1e-5, atol=1e-7 * scale)


def test_what_may_tell_the_velocity():
    stations = Stations(RING)
    tdoa = TDOA(stations, toa_sigma=1.0, speed=1.0)
    rates = FDOA(stations, range_rate_sigma=1.0)
    one = Scans.checked(tdoa, np.zeros(1), np.zeros((1, 5)))
    assert fixing._silent_on_velocity(one)
    two = Scans.checked(tdoa, np.arange(2.0), np.zeros((2, 5)))
    assert not fixing._silent_on_velocity(two)
    both = Scans.checked(Stack(tdoa, rates), np.zeros(1), np.zeros((1, 10)))
    assert not fixing._silent_on_velocity(both)
