"""Joint estimation of emitter and receivers: against dense oracles, and where it gives up."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from receiver_cases import (
    FAR,
    MID,
    NEAR,
    POSITIONS,
    VELOCITIES,
    VELOCITY,
    against_first,
    declared,
    experiments,
    model,
    rms,
    sigmas,
)
from scipy.optimize import least_squares

from imm_tdoa import Stations, bounds
from imm_tdoa.locate import JointFix, gauss_newton, joint, joint_scans, two_step
from imm_tdoa.models import TOA, RangeRate, Stack
from imm_tdoa.scans import Scans


def residuals(eta, z, rates, s, vs, variance, Q):
    """Whitened residuals of [q; q'; p; (p')] (§3.5), everything dense; one run."""
    p = eta[6:24].reshape(6, 3)
    v = eta[24:].reshape(6, 3) if len(eta) > 24 else vs
    r, rate = model(eta[:3], eta[3:6], p, v)
    R = 0.5 * (np.eye(5) + 1.0)
    L = np.linalg.inv(np.linalg.cholesky(R))
    parts = [
        L @ (z - against_first(r)) / np.sqrt(variance),
        L @ (rates - against_first(rate)) / np.sqrt(0.1 * variance),
        ((s - p) / np.sqrt(np.einsum("sii->si", Q[0]))).ravel(),
    ]
    if len(eta) > 24:
        parts.append(((vs - v) / np.sqrt(np.einsum("sii->si", Q[1]))).ravel())
    return np.concatenate(parts)


@pytest.mark.parametrize("velocity_variance", [0.0, 1e-3])
def test_it_finds_the_minimum_a_dense_solver_finds(velocity_variance):
    """Emitter, receivers and cost; covariances by the dense inverse normal matrix."""
    stations, z, rates, arguments = experiments(MID, 1e-4, 1e-3, 4, 11, velocity_variance)
    fix = joint(stations, z, **arguments)
    assert isinstance(fix, JointFix)
    assert fix.converged.all()
    Q = [stations.position_covariance, stations.velocity_covariance]
    for k in range(4):
        s, vs = stations.positions[k], stations.velocities[k]
        start = np.concatenate([MID, VELOCITY, s.ravel(), vs.ravel() if velocity_variance else []])
        found = least_squares(
            residuals,
            start,
            args=(z[k], rates[k], s, vs, 1e-4, Q),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            x_scale="jac",
        )
        C = np.linalg.inv(found.jac.T @ found.jac)
        sigma = np.sqrt(np.diag(C))
        assert_allclose(fix.chi2[k], 2.0 * found.cost, rtol=1e-6, atol=1e-6)
        assert np.all(np.abs(fix.position[k] - found.x[:3]) < 1e-3 * sigma[:3])
        assert np.all(np.abs(fix.velocity[k] - found.x[3:6]) < 1e-3 * sigma[3:6])
        away = fix.stations[k].ravel() - found.x[6:24]
        assert np.all(np.abs(away) < 1e-3 * sigma[6:24])
        assert_allclose(fix.covariance[k], C[:6, :6], rtol=0.02, atol=1e-9)
        for i in range(6):
            block = slice(6 + 3 * i, 9 + 3 * i)
            assert_allclose(fix.station_covariance[k, i], C[block, block], rtol=1e-3, atol=1e-10)
        if velocity_variance:
            assert_allclose(fix.station_velocities[k].ravel(), found.x[24:], atol=1e-3)
        else:
            assert_allclose(fix.station_velocities[k], vs, rtol=0)


def test_block_elimination_is_exact():
    """§3.5: the first block of the dense inverse is (J_q' (Q_m + J_p Q_p J_p')^-1 J_q)^-1."""
    source, sd2, ss2 = np.array(MID), 1e-4, 1e-2
    stations = declared(ss2)
    eta = np.concatenate([source, VELOCITY, POSITIONS.ravel()])
    r, rate = model(source, VELOCITY, POSITIONS, VELOCITIES)
    u = (source - POSITIONS) / r[:, None]
    b = (VELOCITY - VELOCITIES - rate[:, None] * u) / r[:, None]
    J = np.zeros((28, 24))
    for i in range(5):
        J[i, :3], J[i, 6:9], J[i, 9 + 3 * i : 12 + 3 * i] = u[i + 1] - u[0], u[0], -u[i + 1]
        J[5 + i, :3], J[5 + i, 3:6] = b[i + 1] - b[0], u[i + 1] - u[0]
        J[5 + i, 6:9], J[5 + i, 9 + 3 * i : 12 + 3 * i] = b[0], -b[i + 1]
    J[10:, 6:] = np.eye(18)
    R, Q = 0.5 * sd2 * (np.eye(5) + 1.0), np.zeros((28, 28))
    Q[:5, :5], Q[5:10, 5:10] = R, 0.1 * R
    Q[10:, 10:] = np.diag(np.einsum("sii->si", stations.position_covariance).ravel())
    dense = np.linalg.inv(J.T @ np.linalg.solve(Q, J))
    bound = bounds.crlb(stations, source, velocity=VELOCITY, **sigmas(sd2))
    assert_allclose(bound, dense[:6, :6], rtol=1e-8, atol=1e-8 * np.abs(dense[:6, :6]).min())
    fix = joint(stations, against_first(r), range_rate=against_first(rate), **sigmas(sd2))
    assert_allclose(np.concatenate([fix.position, fix.velocity]), eta[:6], atol=1e-5)
    assert_allclose(fix.covariance, dense[:6, :6], rtol=1e-5)
    for i in range(6):
        block = slice(6 + 3 * i, 9 + 3 * i)
        assert_allclose(fix.station_covariance[i], dense[block, block], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("dims", [2, 3])
def test_receivers_without_errors_stay_and_the_fix_is_that_of_least_squares(dims):
    stations = Stations(POSITIONS[:, :dims], velocities=VELOCITIES[:, :dims])
    rng = np.random.default_rng(12)
    r, _ = model(np.array(MID[:dims]), VELOCITY[:dims], stations.positions, stations.velocities)
    z = against_first(r + 0.05 * rng.normal(size=(20, 6)))
    fix = joint(stations, z, toa_sigma=0.05, speed=1.0)
    other = gauss_newton(stations, z, toa_sigma=0.05, speed=1.0)
    sigma = np.sqrt(np.einsum("nii->ni", other.covariance))
    assert np.all(np.abs(fix.position - other.position) < 1e-3 * sigma)
    assert_allclose(fix.chi2, other.chi2, atol=1e-6)
    assert_allclose(fix.covariance, other.covariance, rtol=1e-2)
    assert np.all(fix.stations == stations.positions)
    assert np.all(fix.station_covariance == 0.0)
    assert fix.velocity is None


def test_as_few_stations_as_determine_a_place_are_searched_and_rivals_named():
    """Three receivers in the plane: two hyperbolas that cross twice."""
    s = np.array([(0.0, 0.0), (1000.0, 0.0), (0.0, 1000.0)])
    p = np.array([-300.0, -420.0])
    r = np.sqrt(np.sum((p - s) ** 2, axis=1))
    stations = Stations(s, position_covariance=np.broadcast_to(1e-4 * np.eye(2), (3, 2, 2)))
    fix = joint(stations, against_first(r), toa_sigma=1e-3, speed=1.0)
    assert fix.mirror is not None
    away = min(np.linalg.norm(fix.position - p), np.linalg.norm(fix.mirror - p))
    assert away < 1e-4
    assert fix.dof == 0


def test_what_does_not_arrive_is_flagged_and_left_at_its_beginning():
    """One step is not enough at a far source: the two-step fix and the declared receivers."""
    stations, z, _, arguments = experiments(FAR, 1e-4, 1e-2, 50, 13)
    fix = joint(stations, z, iterations=1, **arguments)
    assert not fix.converged.any()
    begun = two_step(stations, z, **arguments)
    assert_allclose(fix.position, begun.position, rtol=1e-12)
    assert_allclose(fix.stations, stations.positions, rtol=0)
    assert_allclose(fix.chi2, begun.chi2, rtol=1e-9)
    assert np.all(fix.iterations == 1)


def test_a_distant_source_in_much_noise_does_not_diverge():
    """Trap T18, where plain Taylor iterations diverged in 32 of 1200 runs (§3.5)."""
    stations, z, _, arguments = experiments(FAR, 1e-4, 0.1, 400, 14)
    fix = joint(stations, z, **arguments)
    assert np.mean(~fix.converged) <= 0.01
    bound = bounds.crlb(declared(0.1), FAR, velocity=VELOCITY, **sigmas(1e-4))
    good = fix.converged
    assert rms(fix.position[good] - FAR) < 1.3 * np.sqrt(np.trace(bound[:3, :3]))
    assert np.all(fix.chi2[good] < 40.0)
    assert rms(two_step(stations, z, **arguments).position - FAR) > 2.0 * rms(fix.position - FAR)


def test_either_beginning_leads_to_the_same_place():
    stations, z, _, arguments = experiments(NEAR, 1e-4, 1e-2, 20, 15)
    a = joint(stations, z, **arguments)
    b = joint(stations, z, initial="gauss-newton", **arguments)
    assert_allclose(a.position, b.position, atol=1e-3)
    assert_allclose(a.chi2, b.chi2, atol=1e-6)


def test_refined_receivers_are_nearer_the_truth_by_what_the_covariance_says():
    stations, z, _, arguments = experiments(NEAR, 1e-4, 1e-2, 2000, 16)
    fix = joint(stations, z, **arguments)
    before = np.sum((stations.positions - POSITIONS) ** 2)
    after = np.sum((fix.stations - POSITIONS) ** 2)
    claimed = np.sum(np.einsum("nsii->ns", fix.station_covariance))
    assert_allclose(after, claimed, rtol=0.05)
    assert 0.78 < np.sqrt(after / before) < 0.87  # §8.1


def test_scans_with_missing_stations():
    """Unheard receivers keep their declared place and error; heard ones are corrected."""
    stations = declared(1e-2)
    rng = np.random.default_rng(17)
    r, rate = model(np.array(MID), VELOCITY, POSITIONS, VELOCITIES)
    r, rate = r + 0.01 * rng.normal(size=(4, 6)), rate + 0.003 * rng.normal(size=(4, 6))
    r[1, 0] = rate[1, 0] = np.nan
    r[2] = np.nan
    measurement = Stack(TOA(stations, sigma=0.01, speed=1.0), RangeRate(stations, sigma=0.003))
    fix = joint_scans(Scans.checked(measurement, np.arange(4.0), np.concatenate([r, rate], -1)))
    assert fix.converged.tolist() == [True, True, False, True]
    assert np.isnan(fix.position[2]).all()
    assert_allclose(fix.stations[1, 0], POSITIONS[0], rtol=0)
    assert_allclose(fix.station_covariance[1, 0], stations.position_covariance[0], rtol=1e-12)
    assert np.all(fix.stations[1, 1:] != POSITIONS[1:])
    assert_allclose(fix.stations[2], POSITIONS, rtol=0)
    full = joint(
        stations,
        against_first(r[[0, 3]]),
        toa_sigma=0.01,
        speed=1.0,
        range_rate=against_first(rate[[0, 3]]),
        range_rate_sigma=0.003,
    )
    assert_allclose(fix.position[[0, 3]], full.position, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"initial": "guess"}, "initial: expected one of"),
        ({"iterations": 0}, "iterations: expected a whole number"),
        ({"iterations": True}, "iterations: expected a whole number"),
        ({"range_rate": np.zeros(5)}, "range_rate: give range_rate and"),
        ({"time": "now"}, "time: expected numbers"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        joint(Stations(POSITIONS), np.zeros(5), toa_sigma=1e-9, **arguments)


def test_too_few_stations_are_refused():
    with pytest.raises(ValueError, match="joint needs at least 4 in 3 dimensions, got 3"):
        joint(Stations(POSITIONS[:3]), np.zeros(2), toa_sigma=1e-9)
