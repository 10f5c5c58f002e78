"""Filters against the bound of a whole track, by simulation on Source A's geometry (§5.3)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from imm_tdoa import IMM, Bank, Stations, Track, bounds
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Static

STATIONS = Stations([[0, 0], [100e3, 0], [-50e3, 86602.54037844388], [-50e3, -86602.54037844384]])
TIMES = 2.0 * np.arange(21)
SIGMA = 1e-7
MODELS = (Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0))
MOTIONS = ("static", "cv", "ca")
START = np.array([[300e3, 400e3], [350e3, 450e3], [250e3, 350e3]])
SPEED = 1e3 * np.array([[0, 1], [0, -1], [0, 1.0]])
ACCELERATION = 100.0 * np.array([[-1, 0], [1, 0], [1, 0.0]])


def states(order, velocity, acceleration):
    """True states (..., 3, 21, 2 (order + 1)) of the three targets."""
    t = TIMES[:, None]
    v = velocity[..., None, :] * (order >= 1)
    a = acceleration[..., None, :] * (order >= 2)
    every = START[:, None] + v * t + a * t**2 / 2, v + a * t, a + 0.0 * t
    return np.concatenate(np.broadcast_arrays(*every)[: order + 1], axis=-1)


def measured(x, runs, rng):
    tdoa = TDOA(STATIONS, tdoa_sigma=SIGMA)
    clean = tdoa.predict(x[..., :2], np.zeros_like(x[..., :2]), 0.0) / tdoa.scale
    return tdoa, clean + rng.normal(0.0, SIGMA, (runs, 3, len(TIMES), 3))


def tracked(bank, tdoa, z) -> Track:
    """Every run from its own fix; one in a thousand distrusts its first scan and starts later."""
    track = IMM(bank, tdoa).run(TIMES, z)
    assert np.mean(np.isnan(track.log_likelihood[..., 0])) < 0.004
    return track


@pytest.mark.parametrize("order", range(3), ids=MOTIONS)
def test_matched_filters_attain_the_bound(order):
    """§5.3's own targets: within 5 % at every step, and in the mean over 20 steps."""
    rng = np.random.default_rng(order)
    x = states(order, SPEED, ACCELERATION)
    tdoa, z = measured(x, 1000, rng)
    bank = Bank([MODELS[order]], birth_std={"velocity": 5e3, "acceleration": 500.0})
    e = tracked(bank, tdoa, z).position - x[..., :2]
    bound = bounds.pcrlb(bank, tdoa, TIMES, x)
    rms = np.sqrt(np.nanmean(np.sum(e**2, axis=-1), axis=0))
    assert np.all(np.abs(np.mean(rms / bound.position_rms, axis=0) - 1.0) < 0.05)
    mean = np.nanmean(np.linalg.norm(e, axis=-1)[..., 1:], axis=(0, 2))
    ratio = mean / bound.position_mean[:, 1:].mean(axis=-1)
    assert np.all(np.abs(ratio - 1.0) < 0.05)
    assert abs(ratio.mean() - 1.0) < 0.02


@cache
def drawn(order):
    """Targets whose velocities and accelerations the filters' priors are true of."""
    rng = np.random.default_rng(order)
    runs, birth = 600, {"velocity": 1e3, "acceleration": 100.0}
    velocity = rng.normal(0.0, birth["velocity"], (runs, 3, 2))
    acceleration = rng.normal(0.0, birth["acceleration"], (runs, 3, 2))
    x = states(order, velocity, acceleration)
    tdoa, z = measured(x, runs, rng)
    x = np.broadcast_to(x, (runs, *x.shape[-3:]))
    matched = Bank([MODELS[order]], birth_std=birth)
    track = tracked(matched, tdoa, z)
    imm = tracked(Bank(MODELS, birth_std=birth), tdoa, z)
    return x, track, imm, bounds.pcrlb(matched, tdoa, TIMES, x, axis=0)


@pytest.mark.parametrize("order", range(3), ids=MOTIONS)
@pytest.mark.parametrize("which", ["matched", "imm"])
def test_no_estimator_is_below_the_bound(order, which):
    """Van Trees' inequality over the drawn targets; Var ‖e‖² = 2 tr C² at the bound C.

    At every step the three targets' mean square is at least the bound's less four of its
    standard errors, and less two in the mean over steps, taken as if they were one.
    """
    x, matched, imm, bound = drawn(order)
    track = matched if which == "matched" else imm
    square = np.nanmean(np.sum((track.position - x[..., :2]) ** 2, axis=-1), axis=0)
    C = bound.position_covariance
    variance = 2.0 * np.einsum("...ij,...ij->...", C, C) / len(x)
    excess = (square - bound.position_rms**2).mean(axis=0)
    error = np.sqrt(variance.sum(axis=0)) / 3.0
    assert np.all(excess > -4.0 * error)
    assert np.mean(excess / error) > -2.0


@pytest.mark.parametrize("order", range(3), ids=MOTIONS)
def test_matched_filters_know_their_errors(order):
    """NEES and NIS in their 95 % regions.

    Innovations are independent: the chi-square region at 17 of 20 steps at least, and of the sum.
    Errors of a track are not, so the region of each track's mean NEES is from its spread.
    """
    x, track, _, _ = drawn(order)
    nis = track.nis[..., 1:]
    tracks = np.count_nonzero(np.isfinite(nis), axis=(0, 1))
    low, high = chi2.ppf([[0.025], [0.975]], 3 * tracks)
    total = np.nansum(nis, axis=(0, 1))
    assert np.count_nonzero((total >= low) & (total <= high)) >= 17
    low, high = chi2.ppf([0.025, 0.975], 3 * tracks.sum())
    assert low <= total.sum() <= high

    e = track.mean - x
    nees = np.einsum("...i,...i->...", e, np.linalg.solve(track.covariance, e[..., None])[..., 0])
    of_track = np.nanmean(nees[..., 1:], axis=-1)
    error = of_track.std() / np.sqrt(of_track.size)
    assert abs(of_track.mean() - x.shape[-1]) < 1.96 * error
