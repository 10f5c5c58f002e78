"""Labelled recordings through the tracker: one batch, and yet each target by itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tracker_cases import BANK, MEASUREMENT, PLACES, SPEEDS

from imm_tdoa import IMM, Recording, Stations, Tracker
from imm_tdoa.recording import Noise, Table, unlabelled, without_labels

NAMES = [f"s{i}" for i in range(7)]


def recorded(times, *, pairs=6, sigma=None, extra=None):
    """A recording of targets heard at their own `times` (name -> (T,))."""
    rng = np.random.default_rng(0)
    stations = Stations(MEASUREMENT.stations.positions, names=NAMES)
    columns = {k: [] for k in ("time_s", "station", "reference", "tdoa_s", "target")}
    sigmas = []
    for n, (name, clock) in enumerate(times.items()):
        for t in clock:
            h = MEASUREMENT.predict(PLACES[n] + t * SPEEDS[n], np.zeros(2), 0.0)
            for i in range(6)[:pairs]:
                columns["time_s"].append(t)
                columns["station"].append(NAMES[i + 1])
                columns["reference"].append(NAMES[0])
                columns["tdoa_s"].append((h[i] + 30.0 * rng.normal()) / 299792458.0)
                columns["target"].append(name)
                sigmas.append(sigma[n] if sigma else 1e-7)
    if sigma:
        columns["sigma_s"] = sigmas
    for key, value in (extra or {}).items():
        columns[key] += value
    order = np.argsort(columns["time_s"], kind="stable")
    columns = {key: np.array(column)[order] for key, column in columns.items()}
    return Recording(stations, tdoa=Table(columns), noise=Noise(toa_sigma_s=70e-9))


def alone(recording, name):
    measurement, times, values, pairs = recording.scans(name)
    return IMM(BANK, measurement).run(times, values, pairs=pairs)


def check(recording):
    tracks = Tracker(BANK).run(recording)
    assert tuple(tracks) == recording.targets
    for name in recording.targets:
        one = alone(recording, name)
        assert_allclose(tracks[name].times, one.times)
        assert_allclose(tracks[name].mean, one.mean, rtol=1e-9, atol=1e-6)
        assert_allclose(tracks[name].log_likelihood, one.log_likelihood, rtol=1e-9)
    return tracks


def test_targets_heard_together():
    clock = 2.0 * np.arange(8)
    tracks = check(recorded({"a": clock, "b": clock, "c": clock}))
    assert tracks.living == ("a", "b", "c")
    assert tracks.position.shape == (3, 2)


def test_targets_heard_at_times_of_their_own_and_born_later():
    times = {"a": 2.0 * np.arange(9), "b": 0.7 + 3.1 * np.arange(5), "c": 11.0 + np.arange(4)}
    tracks = check(recorded(times))
    assert tracks.lives["c"].born == 11.0
    assert tracks.lives["b"].scans == 5


def test_noise_of_their_own_makes_batches_of_their_own():
    clock = 2.0 * np.arange(6)
    check(recorded({"a": clock, "b": clock + 1.0}, sigma=[1e-7, 2e-7]))


def test_a_target_that_cannot_be_tracked_is_named_and_spoils_no_other():
    clock = 2.0 * np.arange(6)
    extra = {
        "time_s": [3.0],
        "station": ["s1"],
        "reference": ["s0"],
        "tdoa_s": [1e-6],
        "target": ["lonely"],
    }
    data = recorded({"a": clock, "b": clock}, extra=extra)
    tracks = Tracker(BANK).run(data)
    assert list(tracks) == ["a", "b"]
    assert "determines a position" in tracks.failed["lonely"]


def test_without_labels_the_same_targets_are_found():
    clock = 2.0 * np.arange(10)
    data = without_labels(recorded({"a": clock, "b": clock}))
    tracks = Tracker(BANK).run(data)
    measurement, scans = unlabelled(data)
    assert measurement.size == 6
    assert len(scans) == 10
    labels = tracks.labels(scans)
    share = {name: labels[name].count("a") / len(labels[name]) for name in labels}
    assert sorted(round(a) for a in share.values()) == [0, 1]
    assert all(a < 0.1 or a > 0.9 for a in share.values())


def test_pairs_that_close_a_loop_are_left_out_and_counted():
    clock = 2.0 * np.arange(4)
    extra = {
        "time_s": list(clock[:3]),
        "station": ["s2"] * 3,
        "reference": ["s1"] * 3,
        "tdoa_s": [1e-6] * 3,
        "target": ["a"] * 3,
    }
    found = unlabelled(without_labels(recorded({"a": clock}, extra=extra)))
    assert found.measurement.size == 6
    assert found.ignored == {"tdoa: pair that only repeats others": 3}
    rows = Tracker(BANK).run(without_labels(recorded({"a": clock}, extra=extra))).rows
    assert (rows["given"], rows["ignored"]) == (4 * 6 + 3, 3)


def test_rules_against_gross_errors_are_for_rows_whose_emitter_is_known():
    clock = 2.0 * np.arange(8)
    data = recorded({"a": clock, "b": clock})
    tracks = Tracker(BANK, imm={"robust": "gate"}).run(data)
    measurement, times, values, _ = data.scans("b")
    assert_allclose(tracks["b"].mean, IMM(BANK, measurement, robust="gate").run(times, values).mean)
    with pytest.raises(ValueError, match="robust = 'gate' is for rows of which it is known"):
        Tracker(BANK, imm={"robust": "gate"}).run(without_labels(data))


def test_progress_counts_targets():
    told = []
    clock = 2.0 * np.arange(4)
    Tracker(BANK).run(recorded({"a": clock, "b": clock}), progress=lambda *x: told.append(x))
    assert told[-1] == (2, 2)
