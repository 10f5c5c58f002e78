"""Gross errors and lost tracks: the compiled robust filters against the NumPy ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from kernel_cases import SPEED, Case, assert_alike, assert_engines_agree, cases, station_array

from imm_tdoa import IMM, Bank
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Position,
    Stack,
    Static,
)

TRIED = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
BANK = Bank(
    [Static(psd=1.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)], mean_sojourn=20.0
)
# Student's t trusts a row 10 000 sigmas off by 1e-8. Where others share its arrival or offset, R
# has 1e8 times their own noise in every entry, and they are known to eps times that.
GROSS = 1e-8
LOST = 1e-8  # a lost track's P is 1e7 times R, and S, in which R counts too, is known to eps P
STATIONS = station_array(2, np.random.default_rng(1), count=6, moving=False)


@TRIED
@given(cases("gate"))
def test_the_gates_agree(case):
    assert_engines_agree(case)


@TRIED
@given(cases("student-t"))
def test_the_tails_agree(case):
    assert_engines_agree(case, GROSS)


def disturbed(measurement, targets, T, gross, size, robust, seed=0, **more):
    """Emitters on straight courses; each row is off by `size` sigmas with probability `gross`."""
    rng = np.random.default_rng(seed)
    times = np.arange(1.0, T + 1.0)
    velocity = np.broadcast_to(rng.uniform(-40.0, 40.0, (targets, 1, 2)), (targets, T, 2))
    place = rng.uniform(-3e3, 3e3, (targets, 1, 2)) + velocity * times[:, None]
    clean = measurement.predict(place, velocity, times)
    sigma = np.sqrt(np.diag(measurement.noise_covariance(place[0, 0], velocity[0, 0], 0.0)))
    off = np.where(rng.random(clean.shape) < gross, size, 0.0) * rng.choice([-1, 1], clean.shape)
    off[:, :2] = 0.0
    values = (clean + sigma * (rng.normal(size=clean.shape) + off)) / measurement.scale
    imm = IMM(BANK, measurement, robust=robust, **more)
    start = imm.start(0.0, place[:, 0] - velocity[:, 0], 900.0 * np.eye(2))
    return Case(imm, times, values, start)


@pytest.mark.parametrize("robust", ["gate", "student-t"])
@pytest.mark.parametrize("targets", [2, 12])
@pytest.mark.parametrize(
    "measurement",
    [
        TDOA(STATIONS, toa_sigma=3.0 / SPEED),
        TDOA(STATIONS, tdoa_sigma=3.0 / SPEED, pairs=[[1, 0], [2, 1], [2, 0], [3, 4]]),
        TDOA(STATIONS, toa_sigma=3.0 / SPEED, pairs=[[1, 0], [2, 1], [2, 0], [3, 4], [5, 4]]),
        TOA(STATIONS, sigma=3.0 / SPEED),
        Stack(TOA(STATIONS, sigma=3.0 / SPEED), FDOA(STATIONS, range_rate_sigma=0.5)),
        Position(10.0),
    ],
    ids=["tdoa", "tdoa-own", "tdoa-loop", "toa", "stack", "position"],
)
def test_gross_errors(measurement, targets, robust):
    """A fifth of the rows off by 20 and by 10 000 sigmas."""
    for size in (20.0, 1e4):
        case = disturbed(measurement, targets, 8, 0.2, size, robust)
        assert_engines_agree(case, GROSS if size > 1e3 else 1e-9)


@pytest.mark.parametrize("robust", ["gate", "student-t"])
@pytest.mark.parametrize("measurement", [TDOA, TOA])
def test_many_targets_with_errors_of_their_own(measurement, robust):
    """Blocks in which most targets have nothing to leave out, and others several rows."""
    sigma = {TDOA: {"toa_sigma": 3.0 / SPEED}, TOA: {"sigma": 3.0 / SPEED}}[measurement]
    case = disturbed(measurement(STATIONS, **sigma), 37, 8, 0.04, 12.0, robust)
    values = np.array(case.values)
    values[np.random.default_rng(3).random(values.shape) < 0.1] = np.nan
    values[5] += np.random.default_rng(4).uniform(-1e-6, 1e-6, values[5].shape)  # hopeless
    values[6, 3:6] = np.nan
    track = assert_engines_agree(case._replace(values=values))
    rest = track.row_weight[np.arange(37) != 5]
    assert 0.02 < np.mean(rest[np.isfinite(rest)] < 0.5) < 0.2


@pytest.mark.parametrize("robust", ["gate", "student-t"])
def test_neighbours_do_not_matter(robust):
    """A target has the same track alone and in any company, whatever that does meanwhile."""
    case = disturbed(TDOA(STATIONS, toa_sigma=3.0 / SPEED), 21, 8, 0.1, 20.0, robust)
    together = case.run("compiled")
    mean = case.start.means[0][:, :2]
    for part in ([4], [17, 4, 9], [20, 4, 3, 3, 8, 9, 1, 0, 11, 12]):
        start = case.imm.start(0.0, mean[part], 900.0 * np.eye(2))
        own = case._replace(values=case.values[part], start=start).run("compiled")
        for name in ("mean", "covariance", "mode_probability", "row_weight", "log_likelihood"):
            a, b = getattr(own, name), getattr(together, name)[part]
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.nanmax(np.abs(b)))


@pytest.mark.parametrize("robust", ["gate", "student-t"])
@pytest.mark.parametrize("targets", [1, 12])
def test_a_lost_track_opens_and_is_found_again(targets, robust):
    """30 scans of outliers, then good ones; only some of the targets, at times of their own."""
    measurement = TDOA(STATIONS, toa_sigma=3.0 / SPEED)
    case = disturbed(measurement, targets, 45, 0.0, 0.0, robust, reopen_after=3)
    values = np.array(case.values)
    rng = np.random.default_rng(2)
    away = rng.uniform(-3e-6, 3e-6, (targets, 30, 5))
    for target in range(0, targets, 3):
        first = 4 + target // 3
        values[target, first : first + 30] += away[target]
    track = assert_engines_agree(case._replace(values=values), LOST, keep="every 7")
    whole = case._replace(values=values).run("compiled", threads=2)
    np.testing.assert_allclose(whole.mean[:, ::7], track.mean[:, :7], rtol=1e-7, atol=1e-6)
    assert whole.lost[0].any()
    assert whole.reopened[0].any()
    assert not whole.lost[:, -1].any()
    assert not track.lost[..., -1].any()
    if targets > 1:
        assert not whole.lost[1].any()
        near = case.imm.start(0.0, case.start.means[0][:1] + np.zeros((12, 1)), np.eye(2) * 9e2)
        case = case._replace(values=values[0], start=near)
        assert_engines_agree(case, LOST, keep="every 11")


@pytest.mark.parametrize("robust", ["gate", "student-t"])
def test_lost_tracks_with_pairs_of_their_own(robust):
    """A lost target goes through the plain cycle, with the pairs and stations of its scan."""
    measurement = TDOA(STATIONS, toa_sigma=3.0 / SPEED)
    case = disturbed(measurement, 12, 24, 0.0, 0.0, robust, reopen_after=3)
    values = np.array(case.values)
    values[::2, 4:16] += np.random.default_rng(2).uniform(-3e-6, 3e-6, (6, 12, 5))
    plain = case._replace(values=values).run("numpy")
    own = np.broadcast_to(measurement.pairs, (12, 24, 5, 2)).copy()
    own[::3, ::2] = own[::3, ::2, :, ::-1]
    values[::3, ::2] *= -1.0
    want = assert_engines_agree(case._replace(values=values, pairs=own), LOST)
    assert want.lost.any()
    assert_alike(want, plain, 1e-6)
    own_times = case.times + np.linspace(0.0, 0.5, 12)[:, None]
    assert_engines_agree(case._replace(values=values, pairs=own, times=own_times), LOST)


@pytest.mark.parametrize("robust", ["gate", "student-t"])
def test_targets_that_begin_later_are_trusted_from_then(robust):
    case = disturbed(TDOA(STATIONS, toa_sigma=3.0 / SPEED), 12, 10, 0.1, 50.0, robust)
    values = np.array(case.values)
    for target in range(5):
        values[target, :target] = np.nan
    assert_engines_agree(case._replace(values=values, start=None))
