"""Satellites with declared errors: a phone in a car, located from every tenth epoch."""

from __future__ import annotations

from pathlib import Path

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose

from imm_tdoa import recording
from imm_tdoa.locate import gauss_newton, joint_scans, two_step_scans
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.scans import Scans

DRIVE = Path(__file__).parents[4] / "shared" / "data" / "gnss_phone_drive"
ORBIT = 1.5  # m, a coordinate of a broadcast GPS orbit with its clock
ORBIT_RATE = 1e-3  # m/s

pytestmark = [
    pytest.mark.recordings,
    pytest.mark.skipif(not DRIVE.is_dir(), reason="the recordings are not here"),
]


@pytest.fixture(scope="module")
def drive():
    """Scans of every tenth epoch, satellites uncertain, and where the phone was."""
    data = recording.read(DRIVE)
    S = len(data.stations)
    stations = attrs.evolve(
        data.stations,
        position_covariance=np.tile(ORBIT**2 * np.eye(3), (S, 1, 1)),
        velocity_covariance=np.tile(ORBIT_RATE**2 * np.eye(3), (S, 1, 1)),
    )
    scans = attrs.evolve(data, stations=stations).scans()
    some = Scans(scans.measurement, scans.times[::10], scans.values[::10])
    return some, data.truth_at(None, some.times)


def quartiles(fix, truth):
    error = np.linalg.norm(fix.position - truth[0], axis=-1)[fix.converged]
    speed = np.linalg.norm(fix.velocity - truth[1], axis=-1)[fix.converged]
    return np.quantile(error, [0.25, 0.5, 0.75]), np.quantile(speed, [0.25, 0.5, 0.75])


@pytest.mark.parametrize("method", [two_step_scans, joint_scans])
def test_every_epoch_is_located(drive, method):
    """Errors of the whole drive: 7, 11, 18 m (quartiles), those of least squares."""
    scans, truth = drive
    fix = method(scans)
    assert np.mean(fix.converged) >= 0.99
    position, velocity = quartiles(fix, truth)
    assert_allclose(position, [7.0, 10.9, 18.1], rtol=0.25)
    assert velocity[1] < 0.3
    assert np.isfinite(fix.position[fix.converged]).all()
    assert np.isnan(fix.covariance[~fix.converged]).all()


def test_they_agree_with_least_squares_that_widens_the_noise(drive):
    """§1.4, §3.5: one epoch of joint estimation is the fix with inflated R."""
    scans, _ = drive
    few = Scans(scans.measurement, scans.times[::4, None], scans.values[::4, None])
    base = fix_scans(few, moving=True)
    for method in (two_step_scans, joint_scans):
        fix = method(Scans(scans.measurement, scans.times[::4], scans.values[::4]))
        both = fix.converged & base.converged
        assert np.mean(both) > 0.95
        sigma = np.sqrt(np.einsum("nii->ni", base.covariance[:, :3, :3]))
        away = np.abs(fix.position - base.position)[both] / sigma[both]
        assert np.median(away) < 0.02
        assert np.quantile(away, 0.95) < 0.3


def test_the_satellites_stay_within_what_was_declared(drive):
    scans, _ = drive
    fix = joint_scans(scans)
    declared, _ = scans.measurement.models[0].stations.at(scans.times)
    moved = np.linalg.norm(fix.stations - declared, axis=-1)
    heard = np.isfinite(scans.values[:, : declared.shape[1]]) & fix.converged[:, None]
    assert 0.0 < np.median(moved[heard]) < ORBIT
    trace = np.einsum("nsii->ns", fix.station_covariance)
    assert np.all(trace <= 3.0 * ORBIT**2 * (1.0 + 1e-9))
    spare = heard & (fix.dof > 0)[:, None]
    assert np.all(trace[spare] < 3.0 * ORBIT**2)


def test_an_unheard_satellite_with_declared_errors_spoils_no_fix(drive):
    """Its direction is unknown, and unknown times nothing must stay nothing in R."""
    scans, truth = drive
    stations = scans.measurement.models[0].stations
    values = scans.values[:1, : len(stations)]
    heard = np.flatnonzero(np.isfinite(values[0]))
    R = scans.measurement.models[0].noise_covariance(truth[0][0], np.zeros(3), scans.times[0])
    assert np.isfinite(R[np.ix_(heard, heard)]).all()
    at = stations.at(scans.times[0])[0][heard]
    fixed = gauss_newton(
        type(stations)(at), values[0, heard[1:]] - values[0, heard[0]], toa_sigma=2e-8
    )
    assert np.linalg.norm(fixed.position - truth[0][0]) < 100.0
