"""Two-step fixes: exact without noise, efficient with it, honest about their errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from locate_cases import pairs_against
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

from imm_tdoa import Stations, bounds
from imm_tdoa.locate import chan_ho, two_step, two_step_scans
from imm_tdoa.models import FDOA, TDOA, TOA, RangeRate, Stack
from imm_tdoa.scans import Scans

STEPS = ("error-correction", "squared")


def exact(dims=3):
    r, rate = model(
        np.array(MID[:dims]), VELOCITY[:dims], POSITIONS[:, :dims], VELOCITIES[:, :dims]
    )
    return r, rate


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("step", [*STEPS, "none"])
@pytest.mark.parametrize("moving", [False, True])
def test_noise_free_fixes_are_the_truth(dims, step, moving):
    stations = Stations(POSITIONS[:, :dims], velocities=VELOCITIES[:, :dims])
    r, rate = exact(dims)
    more = {"range_rate": against_first(rate), "range_rate_sigma": 1e-4} if moving else {}
    fix = two_step(stations, against_first(r), toa_sigma=1e-3, speed=1.0, second_step=step, **more)
    assert_allclose(fix.position, MID[:dims], rtol=1e-8)
    assert bool(fix.converged)
    assert_allclose(fix.chi2, 0.0, atol=1e-6)
    assert fix.dof == (10 - 2 * dims if moving else 5 - dims)
    assert fix.iterations == 4
    if moving:
        assert_allclose(fix.velocity, VELOCITY[:dims], rtol=1e-7)
    else:
        assert fix.velocity is None
    if step != "none":
        bound = bounds.crlb(
            stations,
            MID[:dims],
            toa_sigma=1e-3,
            speed=1.0,
            velocity=VELOCITY[:dims] if moving else None,
            range_rate_sigma=1e-4 if moving else None,
        )
        assert_allclose(fix.covariance, bound, rtol=1e-5)


@pytest.mark.parametrize("source", [NEAR, MID, FAR])
@pytest.mark.parametrize("step", STEPS)
def test_the_covariance_of_a_fix_is_the_bound_with_receiver_errors(source, step):
    """§3.6, receivers' velocities uncertain too.

    Never below the bound, and above it in no direction by more than 3 %: the first step's
    weights do not know that the reference's own error comes back in the second. The squared
    step loses more near the reference.
    """
    stations = declared(1e-4, 1e-4)
    r, rate = model(np.array(source), VELOCITY, POSITIONS, VELOCITIES)
    fix = two_step(
        stations,
        against_first(r),
        range_rate=against_first(rate),
        second_step=step,
        **sigmas(1e-4),
    )
    bound = bounds.crlb(stations, source, velocity=VELOCITY, **sigmas(1e-4))
    L = np.linalg.inv(np.linalg.cholesky(bound))
    ratio = np.linalg.eigvalsh(L @ fix.covariance @ L.T)
    assert ratio[0] > 1.0 - 1e-6
    assert ratio[-1] < (1.25 if step == "squared" and source == NEAR else 1.03)


def test_without_receiver_errors_positions_are_as_good_as_those_of_chan_and_ho():
    rng = np.random.default_rng(1)
    r, _ = exact()
    z = against_first(r + 0.01 * rng.normal(size=(500, 6)))
    ours = two_step(Stations(POSITIONS), z, toa_sigma=0.01, speed=1.0)
    theirs = chan_ho(Stations(POSITIONS), z, toa_sigma=0.01, speed=1.0)
    assert rms(ours.position - theirs.position) < 0.05 * rms(theirs.position - MID)


def test_sample_covariances_are_the_claimed_ones_whatever_the_weights():
    """Ratio of the traces over 2000 runs: standard error below 3.2 %."""
    for weights in ("both", "first", "none"):
        for step in ("error-correction", "squared", "none"):
            stations, z, _, arguments = experiments(NEAR, 1e-4, 1e-4, 2000, 3)
            fix = two_step(stations, z, second_step=step, receiver_weights=weights, **arguments)
            claimed = np.trace(np.median(fix.covariance[:, :3, :3], axis=0))
            assert_allclose(rms(fix.position - NEAR) ** 2, claimed, rtol=0.1)
            claimed = np.trace(np.median(fix.covariance[:, 3:, 3:], axis=0))
            assert_allclose(rms(fix.velocity - VELOCITY) ** 2, claimed, rtol=0.1)


def test_receiver_velocity_errors_are_weighed():
    """With sigma_v² = 1e-3 (m/s)² they dominate; the bound is reached within 10 %."""
    stations, z, _, arguments = experiments(NEAR, 1e-4, 1e-4, 2000, 4, velocity_variance=1e-3)
    fix = two_step(stations, z, **arguments)
    C = bounds.crlb(declared(1e-4, 1e-3), NEAR, velocity=VELOCITY, **sigmas(1e-4))
    without = bounds.crlb(declared(1e-4), NEAR, velocity=VELOCITY, **sigmas(1e-4))
    assert np.trace(C[3:, 3:]) > 3.0 * np.trace(without[3:, 3:])
    assert_allclose(rms(fix.velocity - VELOCITY) ** 2, np.trace(C[3:, 3:]), rtol=0.1)
    assert_allclose(fix.chi2.mean(), 4.0, atol=4.0 * np.sqrt(8.0 / 2000))


def test_weights_that_know_the_receivers_halve_the_error():
    """Trap T17, §3.4: near source, sigma_d² 1e-4, sigma_s² 0.1; 2.475, 2.546, 5.264 m there."""
    stations, z, _, arguments = experiments(NEAR, 1e-4, 0.1, 2000, 5)
    errors = {
        weights: rms(two_step(stations, z, receiver_weights=weights, **arguments).position - NEAR)
        for weights in ("both", "first", "none")
    }
    bound = bounds.crlb(declared(0.1), NEAR, velocity=VELOCITY, **sigmas(1e-4))
    assert_allclose(np.sqrt(np.trace(bound[:3, :3])), 2.487, atol=5e-4)
    assert_allclose(errors["both"], 2.487, rtol=0.05)
    assert errors["first"] > errors["both"]
    assert_allclose(errors["first"], 2.546, rtol=0.06)
    assert errors["none"] > 1.8 * errors["both"]


def test_the_correction_is_taken_off():
    """Trap T16: with the other sign (twice the first step less the fix) errors nearly double."""
    stations, z, _, arguments = experiments(FAR, 0.1, 1e-4, 1000, 6)
    fix = two_step(stations, z, **arguments)
    first = two_step(stations, z, second_step="none", **arguments)
    wrong = 2.0 * first.position - fix.position
    right = rms(fix.position - FAR)
    bound = bounds.crlb(declared(1e-4), FAR, velocity=VELOCITY, **sigmas(0.1))
    assert_allclose(right, np.sqrt(np.trace(bound[:3, :3])), rtol=0.1)
    assert rms(wrong - FAR) > 1.5 * right


@settings(deadline=None, max_examples=25)
@given(data=st.data())
def test_turns_shifts_and_units_change_nothing(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    shift, drift = 1e4 * rng.normal(size=3), 10.0 * rng.normal(size=3)
    unit = 10.0 ** rng.uniform(-4.0, 4.0)
    step = data.draw(st.sampled_from(["error-correction", "none"]))
    stations, z, rates, arguments = experiments(MID, 1e-4, 1e-3, 5, 7)
    base = two_step(stations, z, second_step=step, **arguments)
    spread = stations.position_covariance
    moved = Stations(
        unit * (stations.positions @ Q.T + shift),
        velocities=unit * (stations.velocities @ Q.T + drift),
        times=stations.times,
        position_covariance=unit**2 * Q @ spread @ Q.T,
    )
    for name in ("toa_sigma", "range_rate_sigma"):
        arguments[name] = unit * arguments[name]
    arguments["range_rate"] = unit * rates
    fix = two_step(moved, unit * z, second_step=step, **arguments)
    assert_allclose(fix.position / unit, base.position @ Q.T + shift, atol=1e-4)
    assert_allclose(fix.velocity / unit, base.velocity @ Q.T + drift, atol=1e-4)
    assert_allclose(fix.chi2, base.chi2, rtol=1e-4, atol=1e-6)


def test_equivalent_pairs_give_one_fix():
    """Any pairs that span the stations; and arrival times, whose emission time nobody knows."""
    stations = declared(1e-4)
    rng = np.random.default_rng(8)
    r, rate = exact()
    r, rate = r + 0.01 * rng.normal(size=(3, 6)), rate + 0.01 * rng.normal(size=(3, 6))
    how = {"toa_sigma": 0.01, "range_rate_sigma": 0.01, "speed": 1.0}
    base = two_step(stations, against_first(r), range_rate=against_first(rate), **how)
    every = np.array([(i, j) for i in range(6) for j in range(i)])
    for pairs in (pairs_against(6, 3), every, np.array([(i + 1, i) for i in range(5)])):
        i, j = pairs.T
        fix = two_step(
            stations, r[:, i] - r[:, j], range_rate=rate[:, i] - rate[:, j], pairs=pairs, **how
        )
        for name in ("position", "velocity", "covariance", "chi2", "dof"):
            assert_allclose(getattr(fix, name), getattr(base, name), rtol=1e-6)
    measurement = Stack(TOA(stations, sigma=0.01, speed=1.0), RangeRate(stations, sigma=0.01))
    scans = Scans.checked(measurement, np.arange(3.0), np.concatenate([r + 77.0, rate - 5.0], -1))
    fix = two_step_scans(scans)
    for name in ("position", "velocity", "covariance", "chi2", "dof"):
        assert_allclose(getattr(fix, name), getattr(base, name), rtol=1e-6)


def test_missing_stations_are_as_if_they_were_not_there():
    r, _ = exact(2)
    Q = 1e-4 * np.array([1.0, 2, 3, 4, 5, 6])[:, None, None] * np.eye(2)
    all_of_them = Stations(POSITIONS[:, :2], position_covariance=Q)
    z = np.tile(r + 0.01 * np.random.default_rng(9).normal(size=6), (3, 1))
    z[0, 2] = z[1, 0] = np.nan  # an ordinary one, the reference of "reference"
    fix = two_step_scans(Scans.checked(TOA(all_of_them, sigma=0.01, speed=1.0), np.arange(3.0), z))
    for k, missing in ((0, 2), (1, 0)):
        kept = np.delete(np.arange(6), missing)
        few = Stations(POSITIONS[kept, :2], position_covariance=Q[kept])
        alone = two_step(few, against_first(z[k, kept]), toa_sigma=0.01, speed=1.0)
        assert_allclose(fix.position[k], alone.position, rtol=1e-9)
        assert_allclose(fix.covariance[k], alone.covariance, rtol=1e-7)
        assert fix.dof[k] == alone.dof == 2
    assert fix.dof[2] == 3


def test_what_is_singular_spoils_no_other():
    """Too few rows in one fix; stations in a plane; nothing at all: NaN, not converged."""
    r, rate = exact()
    z = np.tile(against_first(r), (4, 1))
    f = np.tile(against_first(rate), (4, 1))
    z[1, 1:], f[2] = np.nan, np.nan
    stations = Stations(POSITIONS, velocities=VELOCITIES)
    for step in (*STEPS, "none"):
        fix = two_step(
            stations,
            z,
            toa_sigma=0.01,
            speed=1.0,
            range_rate=f,
            range_rate_sigma=0.01,
            second_step=step,
        )
        assert fix.converged.tolist() == [True, False, False, True]
        assert np.isnan(fix.position[1:3]).all()
        assert np.isnan(fix.covariance[1:3]).all()
        assert_allclose(fix.position[[0, 3]], [MID, MID], rtol=1e-7)
    flat = POSITIONS * [1.0, 1.0, 0.0]
    r, _ = model(np.array(MID), VELOCITY, flat, VELOCITIES)
    fix = two_step(Stations(flat), against_first(r), toa_sigma=0.01, speed=1.0)
    assert not fix.converged
    nothing = two_step(stations, np.full((2, 5), np.nan), toa_sigma=0.01, speed=1.0)
    assert not nothing.converged.any()


GOOD = {"toa_sigma": 1e-9}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "give exactly one of toa_sigma"),
        ({"toa_sigma": 1e-9, "tdoa_sigma": 1e-9}, "give exactly one of toa_sigma"),
        ({**GOOD, "range_rate": np.zeros(5)}, "range_rate: give range_rate and"),
        ({**GOOD, "range_rate": np.zeros(4), "range_rate_sigma": 1.0}, "range_rate: expected"),
        ({**GOOD, "pairs": "all"}, "pairs: expected 'reference'"),
        ({**GOOD, "second_step": "third"}, "second_step: expected one of"),
        ({**GOOD, "receiver_weights": True}, "receiver_weights: expected one of"),
        ({**GOOD, "reweight": -1}, "reweight: expected a whole number"),
        ({**GOOD, "reweight": 1.5}, "reweight: expected a whole number"),
        ({**GOOD, "time": np.zeros(3)}, "time: expected one time"),
        ({**GOOD, "time": np.nan}, "time: expected finite"),
        ({**GOOD, "speed": -1.0}, "speed: expected a number above 0"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        two_step(Stations(POSITIONS), np.zeros(5), **arguments)


def test_bad_shapes_and_measurements_are_named():
    with pytest.raises(ValueError, match="tdoa: expected shape"):
        two_step(Stations(POSITIONS), np.zeros(4), toa_sigma=1e-9)
    with pytest.raises(ValueError, match="tdoa: expected at least one fix"):
        two_step(Stations(POSITIONS), np.zeros((0, 5)), toa_sigma=1e-9)
    with pytest.raises(ValueError, match="two_step needs at least 5 in 3 dimensions, got 4"):
        two_step(Stations(POSITIONS[:4]), np.zeros(3), toa_sigma=1e-9)
    stations = Stations(POSITIONS)
    rates = FDOA(stations, range_rate_sigma=1.0)
    with pytest.raises(ValueError, match="range rates only"):
        two_step_scans(Scans.checked(rates, [0.0], np.zeros((1, 5))))
    two = Stack(TDOA(stations, toa_sigma=1e-9), TDOA(stations, toa_sigma=1e-9))
    with pytest.raises(ValueError, match="expected time differences of arrival, with or without"):
        two_step_scans(Scans.checked(two, [0.0], np.zeros((1, 10))))
    other = Stack(TDOA(stations, toa_sigma=1e-9), FDOA(Stations(POSITIONS), range_rate_sigma=1.0))
    with pytest.raises(ValueError, match="one set of stations"):
        two_step_scans(Scans.checked(other, [0.0], np.zeros((1, 10))))
