"""The tracker on scenes whose truth is known: who is found, kept, lost, and how it is told."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tracker_cases import BANK, MEASUREMENT, PLACES, STEP, path, scan

from imm_tdoa import IMM, Tracker, metrics, plot, recording
from imm_tdoa.tracking import Hits, Jpda, PairedFixes, Silence

SCANS = 16


def run(scans, **parts):
    tracker = Tracker(BANK, MEASUREMENT, **parts)
    return tracker.run(scans)


@pytest.fixture(scope="module")
def four():
    rng = np.random.default_rng(5)
    return [scan(rng, k) for k in range(SCANS)]


@pytest.fixture(scope="module")
def found(four):
    return run(four)


def truth(scans=SCANS):
    return np.stack([path(k) for k in range(scans)], axis=1)


def test_all_targets_are_found_and_nothing_else(found):
    names, positions = found.at(STEP * np.arange(SCANS))
    follow = metrics.follow(truth(), positions, cutoff=300.0)
    assert names == ("1", "2", "3", "4")
    assert not metrics.false_tracks(follow, len(names)).any()
    assert_array_equal(metrics.id_switches(follow), 0)
    late = metrics.latency(np.ones(follow.shape, dtype=bool), follow)
    assert np.all(late <= 5)  # two fixes, one more scan, and the gaps of a 0.95 detection


def test_errors_are_what_the_covariance_says(found):
    """NEES of the last scan: four targets, two axes; below the 1e-4 quantile of chi-square 8."""
    own = np.argmin(np.linalg.norm(found.position[:, None] - path(SCANS - 1), axis=-1), axis=1)
    error = found.position - path(SCANS - 1)[own]
    assert sorted(own) == [0, 1, 2, 3]
    assert metrics.nees(error, found.position_covariance).sum() < 31.8


def test_tracks_have_the_rows_of_their_own_target(found, four):
    for labels in found.labels(four).values():
        number = [int(label) if label else 99 for label in labels]
        assert metrics.purity(np.array(number)) > 0.95


def test_as_good_as_with_labels(found):
    """GOSPA of the last scans at most 1.25 times that of one IMM per target, told its rows."""
    rng = np.random.default_rng(5)
    values = np.full((len(PLACES), SCANS, MEASUREMENT.size), np.nan)
    for k in range(SCANS):
        s = scan(rng, k)
        for value, row, who in zip(s.values, s.row, s.target, strict=True):
            if who:
                values[int(who), k, row] = value
    told = IMM(BANK, MEASUREMENT).run(STEP * np.arange(SCANS), values)
    _, positions = found.at(STEP * np.arange(SCANS))
    ours, theirs = (
        metrics.gospa_curve(truth(), p, cutoff=300.0).distance[8:].mean()
        for p in (positions, told.position)
    )
    assert ours <= 1.25 * theirs


@pytest.mark.parametrize("associator", ["jpda", "nearest", Jpda(0.9, 1e-5)])
def test_associators_are_exchangeable(four, associator):
    tracks = run(four[:10], associator=associator)
    assert len(tracks.living) == 4


def test_m_of_n_confirms_too(four):
    tracks = run(four[:10], confirmation=Hits(hits=3, scans=5))
    assert len(tracks.living) == 4


def test_a_target_that_vanishes_ends_with_its_history_kept():
    rng = np.random.default_rng(7)
    scans = [scan(rng, k, slice(0, 2) if k < 9 else slice(0, 1)) for k in range(22)]
    tracks = run(scans, deletion=Silence(hits=2, scans=6))
    assert len(tracks) == 2
    assert len(tracks.living) == 1
    gone = next(name for name in tracks if name not in tracks.living)
    life = tracks.lives[gone]
    assert life.reason == "fewer than 2 of 6 scans heard it"
    assert life.heard >= STEP * 8
    assert life.ended <= life.heard + STEP * 8
    kept = tracks[gone].position[tracks[gone].times == STEP * 8.0]
    assert np.linalg.norm(kept[0] - path(8)[1]) < 100.0


def test_a_gap_is_coasted_through_and_counted():
    rng = np.random.default_rng(8)
    scans = [scan(rng, k, slice(0, 1), detection=0.0 if 8 <= k < 12 else 1.0) for k in range(18)]
    tracks = run(scans)
    assert list(tracks) == ["1"]
    assert tracks.lives["1"].gaps == 4
    assert np.linalg.norm(tracks.position[0] - path(17)[0]) < 100.0


def test_late_comers_get_new_names():
    rng = np.random.default_rng(9)
    scans = [scan(rng, k, slice(0, 1) if k < 7 else slice(0, 3)) for k in range(15)]
    tracks = run(scans)
    assert list(tracks) == ["1", "2", "3"]
    assert tracks.lives["1"].confirmed < STEP * 7 <= tracks.lives["2"].confirmed


def test_stepping_is_running(four, found):
    tracker = Tracker(BANK, MEASUREMENT)
    for s in four:
        tracks = tracker.step(s)
    for name in found:
        assert_array_equal(tracks[name].mean, found[name].mean)
    assert_array_equal(tracks.position, found.position)


def test_order_of_rows_does_not_matter(four, found):
    rng = np.random.default_rng(0)
    mixed = []
    for s in four:
        p = rng.permutation(len(s))
        mixed.append(type(s)(s.time, s.values[p], s.row[p]))
    tracks = run(mixed)
    assert_allclose(np.sort(tracks.position, axis=0), np.sort(found.position, axis=0), atol=1e-6)


def test_what_is_now_is_the_end_of_the_histories(found):
    for n, name in enumerate(found.living):
        assert_allclose(found[name].position[-1], found.position[n])
        assert_allclose(found[name].velocity[-1], found.velocity[n])
        assert_allclose(found[name].mode_probability[-1], found.mode_probability[n])


def test_tracks_are_written_and_drawn_like_any(found, tmp_path):
    recording.write_track(tmp_path / "tracks.csv", found)
    text = (tmp_path / "tracks.csv").read_text()
    assert text.startswith("time_s,target,x_m")
    plot.track(found, stations=MEASUREMENT.stations, path=tmp_path / "tracks.png")
    assert found["1"].smooth().position.shape == found["1"].position.shape


def test_progress_is_told(four):
    told = []
    Tracker(BANK, MEASUREMENT).run(four[:3], progress=lambda done, all_: told.append((done, all_)))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_wrong_arguments_are_named(four):
    with pytest.raises(ValueError, match="measurement: needed to take scans"):
        Tracker(BANK).step(four[0])
    with pytest.raises(ValueError, match="associator: expected one of"):
        Tracker(BANK, MEASUREMENT, associator="best")
    with pytest.raises(ValueError, match="unknown argument"):
        Tracker(BANK, MEASUREMENT, colour=3)
    with pytest.raises(ValueError, match="row: expected numbers below 6"):
        Tracker(BANK, MEASUREMENT).step(type(four[0])(0.0, [1e-6], [6]))
    with pytest.raises(ValueError, match="detection_probability"):
        Tracker(BANK, MEASUREMENT, detection_probability=1.0)
    for robust in ("gate", "student-t"):  # they would make the rows of other emitters fit
        with pytest.raises(ValueError, match=f"imm: robust = '{robust}' is for rows of which it"):
            Tracker(BANK, MEASUREMENT, imm={"robust": robust})


def test_the_detection_probability_reaches_the_beginning_of_tracks():
    assert Tracker(BANK, MEASUREMENT).settings.initiation == PairedFixes()
    tracker = Tracker(BANK, MEASUREMENT, detection_probability=0.6)
    assert tracker.settings.initiation == PairedFixes(detection_probability=0.6)
    own = PairedFixes(detection_probability=0.8)
    tracker = Tracker(BANK, MEASUREMENT, detection_probability=0.6, initiation=own)
    assert tracker.settings.initiation is own
