"""Scans that are not as they should be: the tracker goes on, counts, and forgets nobody."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tracker_cases import BANK, MEASUREMENT, SPEED, STEP, path, scan

from imm_tdoa import Tracker
from imm_tdoa.tracking import Scan

BAD = 8  # the scan from which on things go wrong


def track(change, scans=16, **options):
    """Run two targets; `change` (k, scan) is what becomes of the scan from `BAD` on."""
    rng = np.random.default_rng(3)
    tracker = Tracker(BANK, MEASUREMENT)
    before, given = None, 0
    for k in range(scans):
        s = scan(rng, k, slice(0, 2), **options)
        for one in change(k, s, rng) if k >= BAD else [s]:
            tracks = tracker.step(one)
            given += int(np.isfinite(one.values).sum())
        if k == BAD - 1:
            before = tracks
            assert len(before.living) == 2
    for name in before:  # nothing of what was known is lost or changed
        known = len(before[name].times)
        assert_array_equal(tracks[name].mean[:known], before[name].mean)
    accounted_for(tracks, given)
    return tracks


def accounted_for(tracks, given):
    """Every value given is taken, ignored or left; `taken` is counted track by track."""
    rows = tracks.rows
    own = {pair for name in tracks for pair in zip(*map(tuple, tracks.taken(name)), strict=True)}
    assert rows["given"] == given
    assert rows["taken"] == len(own)
    assert rows["ignored"] == sum(tracks.ignored.values())  # nothing but rows is ignored here
    assert rows["left"] == given - rows["taken"] - rows["ignored"] >= 0


def both_followed(tracks, k=15):
    away = np.linalg.norm(tracks.position[:, None] - path(k, slice(0, 2)), axis=-1)
    assert tracks.living == ("1", "2")
    assert np.all(np.sort(away.min(axis=1)) < 100.0)


def test_a_hundred_times_the_usual_rows():
    def flood(k, s, rng):
        if k != BAD:
            return [s]
        count = 100 * len(s)
        row = rng.integers(0, 6, count)
        values = rng.uniform(-40e3, 40e3, count) / SPEED
        return [Scan(s.time, np.append(s.values, values), np.append(s.row, row))]

    tracks = track(flood)
    both_followed(tracks)
    assert tracks.ignored["rows of overloaded scans"] > 1000


def test_scans_without_rows():
    def empty(k, s, rng):
        return [Scan(s.time, [], [])] if k in (BAD, BAD + 1) else [s]

    tracks = track(empty)
    both_followed(tracks)
    assert tracks.lives["1"].gaps >= 2


def test_all_values_missing():
    tracks = track(lambda k, s, rng: [Scan(s.time, s.values * np.nan, s.row)] if k == BAD else [s])
    both_followed(tracks)


def test_identical_times():
    def twice(k, s, rng):
        return [s, scan(rng, k, slice(0, 2))]

    both_followed(track(twice))


def test_a_scan_that_comes_late_is_counted():
    def late(k, s, rng):
        return [s, Scan(s.time - 1.0, s.values, s.row)] if k == BAD else [s]

    tracks = track(late)
    both_followed(tracks)
    assert tracks.ignored["late rows"] > 0


def test_a_station_that_goes_silent():
    def silent(k, s, rng):
        heard = s.row != 2
        return [Scan(s.time, s.values[heard], s.row[heard])]

    both_followed(track(silent))


def test_a_station_whose_clock_jumps_by_a_second():
    def jump(k, s, rng):
        return [Scan(s.time, s.values + (s.row == 2), s.row)]

    tracks = track(jump)
    both_followed(tracks)
    assert len(tracks) == 2
    assert tracks.ignored["impossible values"] > 8


def test_a_station_that_is_off_by_what_is_possible():
    tracks = track(lambda k, s, rng: [Scan(s.time, s.values + 20e-6 * (s.row == 2), s.row)])
    both_followed(tracks)
    assert len(tracks) == 2


def test_targets_closer_than_the_resolution():
    """From scan 8 to 12 both send from one place, and each station measures it once."""

    def merged(k, s, rng):
        if k >= BAD + 4:
            return [s]
        return [scan(rng, k, slice(0, 1))]

    tracks = track(merged)
    assert len(tracks) >= 2
    away = np.linalg.norm(tracks.position[:, None] - path(15, slice(0, 2)), axis=-1)
    assert np.all(away.min(axis=0) < 100.0)


@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_confirms_nobody(seed):
    rng = np.random.default_rng(seed)
    tracker = Tracker(BANK, MEASUREMENT)
    for k in range(10):
        tracks = tracker.step(scan(rng, k, slice(0, 0), false=4))
    assert len(tracks) == 0
    assert tracks.position.shape == (0, 2)
    assert tracks.rows["left"] == tracks.rows["given"] > 0
    assert tracks.time == STEP * 9
