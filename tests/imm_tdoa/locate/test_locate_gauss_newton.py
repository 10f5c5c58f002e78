"""Fixes by damped Gauss-Newton iteration against bounds, statistics and other derivations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from locate_cases import (
    HO_XU,
    HO_XU_FAR,
    HO_XU_NEAR,
    HO_XU_SOURCE_VELOCITY,
    HO_XU_VELOCITY,
    differences,
    distances,
    geometries,
    information,
    mahalanobis,
    noisy_differences,
    pairs_against,
    undamped,
)
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Stations, bounds
from imm_tdoa.locate import fix_scans, gauss_newton, least_squares
from imm_tdoa.locate import gauss_newton as gauss_newton_function
from imm_tdoa.models import TDOA, TOA, Height, Stack
from imm_tdoa.scans import Scans

C = 299_792_458.0
RING = np.array([(0, 0), (1000, 0), (0, 1000), (1100, 1200), (500, -400), (-700, 300)], float)
GROUND = np.array(
    [(0, 0, 0), (9e3, 0, 50), (0, 8e3, 120), (1e4, 1.1e4, 10), (5e3, -4e3, 300), (-6e3, 2e3, 80)]
)


def test_a_distant_source_is_reached_from_bad_starts():
    """Undamped iteration flies off from these starts (trap T18); the damped one arrives."""
    p = np.array([9000.0, 7000.0])
    z = differences(distances(p, RING))[None]
    starts = [np.array([x, y]) for x in (-3000.0, 400.0, 3000.0) for y in (-2500.0, 900.0, 3500.0)]
    lost = 0
    for start in starts:
        fix = gauss_newton(Stations(RING), z, toa_sigma=0.01, speed=1.0, initial=start)
        assert fix.converged.all()
        assert_allclose(fix.position, p[None], atol=1e-3)
        try:
            plain = undamped(start, RING, z, 30)[0]
        except np.linalg.LinAlgError:
            plain = np.full(2, np.inf)
        lost += not np.linalg.norm(plain - p) < 1.0
    assert lost >= 3


@settings(deadline=None, max_examples=25)
@given(data=st.data(), dims=st.sampled_from([2, 3]))
def test_no_fix_depends_on_the_reference(data, dims):
    stations, p = data.draw(geometries(dims, dims + 3))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    S = len(stations)
    sigma = rng.uniform(0.5, 2.0, S)
    t = distances(p, stations.positions) + sigma * rng.normal(size=S)
    first = gauss_newton(stations, differences(t), toa_sigma=sigma, speed=1.0, initial=p)
    assert bool(first.converged)
    units = np.sqrt(np.diag(first.covariance))
    for k in range(1, S):
        pairs = pairs_against(S, k)
        fix = gauss_newton(
            stations, differences(t, k), toa_sigma=sigma, speed=1.0, initial=p, pairs=pairs
        )
        assert_allclose(fix.position, first.position, atol=1e-3 * units.min())
        assert_allclose(fix.covariance, first.covariance, rtol=1e-3)
        assert_allclose(fix.chi2, first.chi2, atol=1e-6)
        assert fix.dof == first.dof == S - 1 - dims


@settings(deadline=None, max_examples=25)
@given(data=st.data(), dims=st.sampled_from([2, 3]))
def test_the_covariance_is_the_bound_at_the_solution(data, dims):
    stations, p = data.draw(geometries(dims, dims + 2))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    z = differences(distances(p, stations.positions) + rng.normal(size=len(stations)))
    fix = gauss_newton(stations, z, toa_sigma=1.0, speed=1.0, initial=p)
    expected = np.linalg.inv(information(fix.position, stations.positions, 1.0))
    units = np.sqrt(np.diag(expected))
    assert_allclose(
        fix.covariance / np.outer(units, units), expected / np.outer(units, units), atol=1e-5
    )


@pytest.mark.parametrize(("s", "p"), [(RING, (700.0, 900.0)), (GROUND, (7e3, 9e3, 4e3))])
def test_the_residuals_of_good_data_are_chi_square(s, p):
    """Mean and variance of chi2 are dof and 2 dof; errors have the stated covariance."""
    p, runs = np.array(p), 3000
    z = noisy_differences(np.random.default_rng(8), p, s, 1.0, runs)
    fix = gauss_newton(Stations(s), z, toa_sigma=1.0, speed=1.0)
    assert fix.converged.all()
    dof = len(s) - 1 - len(p)
    assert_array_equal(fix.dof, dof)
    assert abs(np.mean(fix.chi2) - dof) < 4.0 * np.sqrt(2.0 * dof / runs)
    spread = np.sqrt((8.0 * dof**2 + 48.0 * dof) / runs)  # of a sample variance of chi-square
    assert abs(np.var(fix.chi2) - 2.0 * dof) < 4.0 * spread
    nees = mahalanobis(fix.position - p, fix.covariance)
    assert abs(np.mean(nees) - len(p)) < 4.0 * np.sqrt(2.0 * len(p) / runs)


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


def test_missing_rows_are_as_stations_never_built():
    rng = np.random.default_rng(3)
    p = np.array([1500.0, -800.0])
    z = noisy_differences(rng, p, RING, 1.0, 5)
    for gone in ([2], [1, 4]):
        kept = np.delete(RING, gone, axis=0)
        missing = z.copy()
        missing[:, np.array(gone) - 1] = np.nan
        fix = gauss_newton(Stations(RING), missing, toa_sigma=1.0, speed=1.0)
        fewer = gauss_newton(
            Stations(kept), np.delete(z, np.array(gone) - 1, axis=1), toa_sigma=1.0, speed=1.0
        )
        assert_allclose(fix.position, fewer.position, atol=1e-3)
        assert_allclose(fix.covariance, fewer.covariance, rtol=1e-5)
        assert_allclose(fix.chi2, fewer.chi2, atol=1e-6)
        assert_array_equal(fix.dof, fewer.dof)


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


def test_a_batch_equals_its_members():
    rng = np.random.default_rng(9)
    p = rng.uniform(-3e3, 3e3, (3, 4, 2))
    z = differences(distances(p, RING) + rng.normal(0.0, 1.0, (3, 4, 6)))
    z[0, 1, 2], z[2, 3, :2] = np.nan, np.nan
    batch = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0)
    assert batch.position.shape == (3, 4, 2)
    assert batch.chi2.shape == batch.dof.shape == batch.iterations.shape == (3, 4)
    for index in np.ndindex(3, 4):
        one = gauss_newton(Stations(RING), z[index], toa_sigma=1.0, speed=1.0)
        assert_allclose(batch.position[index], one.position, rtol=1e-5, atol=1e-4)
        assert_allclose(batch.covariance[index], one.covariance, rtol=1e-4, atol=1e-9)
        assert batch.converged[index] == one.converged
        assert batch.dof[index] == one.dof
        rival = np.full(2, np.nan) if batch.mirror is None else batch.mirror[index]
        assert np.isnan(rival).all() == (one.mirror is None)
        if one.mirror is not None:
            assert_allclose(rival, one.mirror, rtol=1e-5, atol=1e-3)


def test_large_batches_are_searched_in_parts(monkeypatch):
    z = noisy_differences(np.random.default_rng(1), np.array([900.0, 2100.0]), RING, 1.0, 10)
    whole = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0)
    monkeypatch.setitem(fix_scans.__globals__, "CHUNK", 3)
    parts = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0)
    assert_allclose(parts.position, whole.position, rtol=1e-9)
    assert_array_equal(parts.iterations, whole.iterations)


def test_seconds_and_metres_turned_and_shifted_axes():
    """The same fix in any units and axes."""
    rng = np.random.default_rng(2)
    p = np.array([4000.0, 2500.0])
    z = noisy_differences(rng, p, RING, 1.0, 1)[0]
    fix = gauss_newton(Stations(RING), z / C, toa_sigma=1.0 / C)
    for scale in (1e-3, 1e3):
        other = gauss_newton(Stations(RING * scale), z * scale, toa_sigma=scale, speed=1.0)
        assert_allclose(other.position / scale, fix.position, rtol=1e-5)
        assert_allclose(other.covariance / scale**2, fix.covariance, rtol=1e-4)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    shift = np.array([-3e5, 7e5])
    other = gauss_newton(Stations(RING @ turn.T + shift), z / C, toa_sigma=1.0 / C)
    assert_allclose(other.position, turn @ fix.position + shift, rtol=1e-7)
    assert_allclose(other.covariance, turn @ fix.covariance @ turn.T, rtol=1e-4)


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


def test_receiver_errors_widen_the_fix_and_shift_the_weights():
    """The noise then depends on the place: the solution is a fixed point of its own weights."""
    Q = np.array([1.0, 25.0, 4.0, 100.0, 9.0, 0.25])[:, None, None] * np.eye(2)
    stations = Stations(RING, position_covariance=Q)
    p, runs = np.array([1900.0, -900.0]), 3000
    rng = np.random.default_rng(6)
    moved = RING - rng.normal(size=(runs, 6, 2)) * np.sqrt(np.diagonal(Q, axis1=1, axis2=2))
    r = np.sqrt(np.sum((p - moved) ** 2, axis=-1)) + rng.normal(0.0, 1.0, (runs, 6))
    z = differences(r)
    fix = gauss_newton(stations, z, toa_sigma=1.0, speed=1.0, initial=p)
    assert fix.converged.all()
    for k in range(5):
        bound = bounds.crlb(stations, fix.position[k], toa_sigma=1.0, speed=1.0)
        assert_allclose(fix.covariance[k], bound, rtol=1e-6)
    u = (fix.position[:, None] - RING) / distances(fix.position, RING)[..., None]
    D = np.concatenate([-np.ones((5, 1)), np.eye(5)], axis=1)
    variance = 1.0 + np.einsum("bsi,sij,bsj->bs", u, Q, u)
    R = np.einsum("is,bs,js->bij", D, variance, D)
    gradient = np.einsum(
        "bki,bk->bi",
        np.einsum("ks,bsi->bki", D, u),
        np.linalg.solve(R, (z - differences(distances(fix.position, RING)))[..., None])[..., 0],
    )
    assert np.max(mahalanobis(gradient, np.linalg.inv(fix.covariance))) < 1e-6
    nees = mahalanobis(fix.position - p, fix.covariance)
    assert abs(np.mean(nees) - 2.0) < 4.0 * np.std(nees) / np.sqrt(runs)


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
