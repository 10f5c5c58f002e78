"""Rows that come one pair of stations at a time: no scan gives a place, several together do."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from tracker_cases import BANK, MEASUREMENT, PLACES, SPEED, SPEEDS, STEP

from imm_tdoa import IMM, Bank, Tracker, metrics
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.models import Static
from imm_tdoa.scans import Scans
from imm_tdoa.tracking import PairedFixes, Scan
from imm_tdoa.tracking.gathering import gathered
from imm_tdoa.tracking.memory import Heard

M, EVERY, SCANS = MEASUREMENT.size, 0.5, 40
STD = np.full(2, 150.0)  # m/s, of the bank's birth law
REACH = 40e3  # m, the baselines


def place(k, speeds=SPEEDS):
    return PLACES + EVERY * k * speeds


def noisy(rng, k, speeds=SPEEDS):
    h = MEASUREMENT.predict(place(k, speeds), np.zeros((4, 2)), 0.0)
    R = MEASUREMENT.noise_covariance(np.zeros(2), np.zeros(2), 0.0)
    return h + rng.normal(size=h.shape) @ np.linalg.cholesky(R).T


def scans(seed, who, *, false=0.0, count=SCANS, speeds=SPEEDS):
    """Each scan has one pair: its values of those of `who` that it hears, and false ones."""
    rng = np.random.default_rng(seed)
    result = []
    for k in range(count):
        i, z = int(rng.integers(M)), noisy(rng, k, speeds)
        heard = [n for n in who if rng.random() < 0.9]
        values = [*z[heard, i], *rng.uniform(-REACH, REACH, rng.poisson(false))]
        names = [*(str(n) for n in heard), *[""] * (len(values) - len(heard))]
        row = np.full(len(values), i)
        result.append(Scan(EVERY * k, np.array(values) / SPEED, row, target=np.array(names, str)))
    return result


@pytest.mark.parametrize("who", [[0], [0, 1]])
def test_targets_are_found_from_single_rows(who):
    """After the first dozen scans each has its track, as good as it says."""
    data = scans(1, who, false=0.3)
    tracks = Tracker(BANK, MEASUREMENT).run(data)
    times = np.array([s.time for s in data])
    truth = np.stack([place(k)[who] for k in range(SCANS)], axis=1)
    follow = metrics.follow(truth, tracks.at(times)[1], cutoff=500.0)
    assert len(tracks.living) == len(tracks) == len(who)
    assert tracks.rows["given"] == sum(len(s) for s in data)
    assert tracks.rows["taken"] == sum(life.rows for life in tracks.lives.values())
    assert_array_equal(metrics.id_switches(follow), 0)
    late = metrics.latency(np.ones(follow.shape, dtype=bool), follow)
    assert np.all(late <= 15)
    error = tracks.position[follow[:, -1]] - truth[:, -1]
    nees = metrics.nees(error, tracks.position_covariance[follow[:, -1]])
    assert nees.sum() < chi2.isf(1e-4, 2 * len(who))
    for labels in tracks.labels(data).values():
        number = [int(label) if label else 99 for label in labels]
        assert metrics.purity(np.array(number)) > 0.9


def test_single_rows_of_nobody_confirm_nobody():
    tracks = Tracker(BANK, MEASUREMENT).run(scans(2, [], false=1.5, count=20))
    assert len(tracks) == 0


def test_what_does_not_move_is_found_too():
    data = scans(3, [0, 1], speeds=np.zeros((4, 2)))
    tracks = Tracker(Bank([Static(psd=0.0)]), MEASUREMENT).run(data)
    away = np.linalg.norm(tracks.position[:, None] - PLACES[:2], axis=-1)
    assert len(tracks) == 2
    assert np.all(away.min(axis=0) < 60.0)


def test_the_start_is_the_fix_of_the_gathered_rows():
    """The same rows and velocity prior by Gauss-Newton: one joint fit, no filter."""
    rng = np.random.default_rng(4)
    heard, values = [], np.full((10, M), np.nan)
    for k in range(10):
        z = noisy(rng, k)[0]
        values[k, k % M] = z[k % M]
        value, row = np.array([z[k % M]]), np.array([k % M])
        heard.append(Heard(EVERY * k, k, value, row, np.full(M, 1e-5)))
    found = gathered(IMM(BANK, MEASUREMENT), heard, STD, 1000, 0.9)
    times = EVERY * np.arange(10)
    fix = fix_scans(
        Scans(MEASUREMENT, times, values / SPEED),
        moving=True,
        velocity_std=STD,
        initial=place(9)[0],
    )
    assert len(found.members) >= 1
    assert_array_equal(found.members[0], np.where(np.arange(M) == 9 % M, 0, -1))
    assert np.all(np.isfinite(found.gains[0, :10]))
    delta = found.state.mean[0, :2] - fix.position
    # the bank's own process noise and linearisation row by row: a fraction of what is not known
    assert delta @ np.linalg.solve(fix.covariance[:2, :2], delta) < 0.5**2
    ratio = np.diag(found.state.covariance[0])[:2] / np.diag(fix.covariance)[:2]
    assert_allclose(ratio, 1.0, atol=0.3)


def test_too_few_rows_begin_nothing():
    """Two pairs in all: as many hyperbolas as a place takes, and none to tell ghosts by."""
    rng = np.random.default_rng(5)
    z = noisy(rng, 0)[0]
    heard = [Heard(EVERY * k, k, z[[k]], np.array([k]), np.full(M, 1e-5)) for k in range(2)]
    assert gathered(IMM(BANK, MEASUREMENT), heard, STD, 1000, 0.9).state is None
    one_pair = [Heard(EVERY * k, k, z[[0]], np.array([0]), np.full(M, 1e-5)) for k in range(9)]
    assert gathered(IMM(BANK, MEASUREMENT), one_pair, STD, 1000, 0.9).state is None


def test_scans_may_be_thin_and_full_in_turns():
    """Every other second all pairs, single rows in between: the track takes both."""
    rng, data = np.random.default_rng(6), []
    for k in range(24):
        z, rows = noisy(rng, k)[0], np.arange(M) if k % 4 == 0 else np.array([k % M])
        data.append(Scan(EVERY * k, z[rows] / SPEED, rows))
    tracks = Tracker(BANK, MEASUREMENT).run(data)
    assert tracks.living == ("1",)
    assert tracks.lives["1"].confirmed <= STEP * 4
    assert np.linalg.norm(tracks.position[0] - place(23)[0]) < 100.0


def test_a_tracker_with_thin_scans_resumes(tmp_path):
    data = scans(7, [0, 1], false=0.3, count=12)
    whole = Tracker(BANK, MEASUREMENT).run(data)
    first = Tracker(BANK, MEASUREMENT)
    first.run(data[:5])
    first.save(tmp_path / "t.npz")
    again = Tracker(BANK, MEASUREMENT).resume(tmp_path / "t.npz")
    tracks = again.run(data[5:])
    assert list(tracks) == list(whole)
    for name in whole:
        assert_array_equal(tracks[name].mean, whole[name].mean)


def test_more_scans_than_are_remembered_are_refused():
    with pytest.raises(ValueError, match="gathered: expected at most 20 scans, got 21"):
        PairedFixes(gathered=21)
