"""Fixes by damped Gauss-Newton iteration against bounds, statistics and other derivations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from locate_cases import (
    GROUND,
    RING,
    C,
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
from imm_tdoa.locate import fix_scans, gauss_newton


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
