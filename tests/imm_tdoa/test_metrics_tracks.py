"""Purity, identity switches, latency, and who follows whom."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import metrics


def line(*x):
    """Positions (T, 1); None is NaN."""
    return np.array([[np.nan if v is None else v] for v in x], dtype=float)


def test_a_track_stays_with_its_target_while_it_is_near():
    """Parallel targets 1 apart: at scan 1 the other track is nearer, but no other id follows."""
    truth = np.stack([line(0, 0, 0), line(1, 1, 1)])
    tracks = np.stack([line(0, 0.7, 0), line(1, 0.3, 1)])
    assert_array_equal(metrics.follow(truth, tracks, 2.0), [[0, 0, 0], [1, 1, 1]])
    # beyond the cutoff a track no longer follows, and the ids change
    assert_array_equal(metrics.follow(truth, tracks, 0.5), [[0, 1, 0], [1, 0, 1]])


def test_gaps_births_and_the_return_of_a_track():
    truth = np.stack([line(0, 0, 0, 0), line(None, 5, 5, 5)])
    tracks = np.stack([line(0, None, None, 0), line(None, None, 5, 5), line(9, 9, 0, 0)])
    got = metrics.follow(truth, tracks, 1.0)
    # track 0 comes back to target 0, but track 2 took over meanwhile and is still near
    assert_array_equal(got, [[0, -1, 2, 2], [-1, -1, 1, 1]])
    assert_array_equal(metrics.id_switches(got), [1, 0])
    assert_array_equal(metrics.false_tracks(got, 3), [False, False, False])
    assert_array_equal(metrics.false_tracks(got[:, :2], 3), [False, True, True])


def test_as_many_as_possible_are_matched_then_the_nearest():
    """Matching the closest pair first (1.0 to 0.9) would leave the other target without."""
    truth = np.stack([line(0), line(1)])
    tracks = np.stack([line(0.9), line(1.9)])
    assert_array_equal(metrics.follow(truth, tracks, 1.0), [[0], [1]])
    assert_array_equal(metrics.follow(truth, tracks, 0.95), [[0], [1]])
    assert_array_equal(metrics.follow(truth, tracks, 0.5), [[-1], [0]])


def test_nobody_to_follow():
    assert metrics.follow(np.zeros((2, 3, 2)), np.zeros((0, 3, 2)), 1.0).tolist() == [[-1] * 3] * 2
    assert metrics.follow(np.zeros((0, 3, 2)), np.zeros((1, 3, 2)), 1.0).shape == (0, 3)


def test_purity_is_the_share_of_the_most_frequent_label():
    label = [[4, 4, 4, 7], [1, 1, -1, -1], [-1, -1, -1, -1], [2, 3, 2, 3]]
    assert_array_equal(metrics.purity(label), [0.75, 1.0, np.nan, 0.5])
    assert metrics.purity([0, 0, 1]) == pytest.approx(2 / 3)
    assert np.isnan(metrics.purity(np.zeros(0)))


def test_id_switches_ignore_gaps():
    track = [[0, 0, 0, 0], [0, -1, -1, 0], [0, -1, 1, 1], [0, 1, 0, 1], [-1, -1, -1, -1]]
    assert_array_equal(metrics.id_switches(track), [0, 0, 1, 3, 0])
    assert metrics.id_switches(np.zeros((2, 0), dtype=int)).tolist() == [0, 0]


def test_latency_counts_from_when_the_target_exists():
    present = np.array([[1, 1, 1, 1], [0, 1, 1, 1], [1, 1, 0, 0], [0, 0, 0, 0]], dtype=bool)
    track = np.array([[0, 0, 0, 0], [-1, -1, -1, 3], [-1, -1, -1, -1], [-1, -1, -1, -1]])
    assert_array_equal(metrics.latency(present, track), [0.0, 2.0, np.nan, np.nan])
    times = [10.0, 12.5, 13.0, 20.0]
    assert_allclose(metrics.latency(present, track, times), [0.0, 7.5, np.nan, np.nan])
    assert np.isnan(metrics.latency(np.zeros(0, dtype=bool), np.zeros(0, dtype=int)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.follow(np.ones((1, 2, 2)), np.ones((1, 2, 3)), 1.0), "tracks: expected"),
        (lambda: metrics.follow(np.ones((1, 2, 2)), np.ones((1, 2, 2)), 0.0), "cutoff: expected"),
        (lambda: metrics.purity([0.5]), "label: expected an array of whole"),
        (lambda: metrics.id_switches(3), "track: expected an array of whole"),
        (lambda: metrics.latency([1, 0], [0, 0]), "present: expected booleans"),
        (lambda: metrics.latency([True], [0, 0]), "present: expected booleans"),
        (lambda: metrics.latency([True], [0], [1.0, 2.0]), "times: expected shape"),
        (lambda: metrics.false_tracks([[2]], 2), "count: expected more than 2 tracks"),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
