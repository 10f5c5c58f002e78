"""Who follows whom, against cases put together by hand."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Bank, Tracker, bounds, following, metrics
from imm_tdoa.contract import Array
from imm_tdoa.following import Following
from imm_tdoa.models import ConstantVelocity
from imm_tdoa.recording import Recording, unlabelled
from imm_tdoa.simulate import load, simulate_labelled

T = 6
EAST = np.stack([10.0 * np.arange(T), np.zeros(T)], axis=-1)
NORTH = EAST[:, ::-1] + np.array([0.0, 500.0])


def made(position: Array, cutoff: float = 20.0) -> Following:
    """Two targets, one to the east and one to the north, which is there from the third scan on."""
    truth = np.stack([EAST, NORTH])
    truth[1, :2] = np.nan
    names = tuple(str(n + 1) for n in range(len(position)))
    return Following(np.arange(T) * 2.0, ("east", "north"), names, truth, position, cutoff)


def test_a_track_that_goes_over_to_the_other_target() -> None:
    """Track 1 follows both in turn, 2 takes over, 3 is nobody's."""
    off = np.array([[3.0, 4.0], [0.0, 6.0], [0.0, 9e3]])
    first, second, third = EAST + off[:, None]
    first[4:] = NORTH[4:]
    second[:4] = np.nan
    found = made(np.stack([first, second, third]))
    assert_array_equal(found.follower, [[0, 0, 0, 0, 1, 1], [-1, -1, -1, -1, 0, 0]])
    assert_array_equal(found.followed, [[0, 0, 0, 0, 1, 1], [-1, -1, -1, -1, 0, 0], [-1] * 6])
    assert_array_equal(found.id_switches, [1, 0])
    assert_array_equal(found.latency, [0.0, 4.0])
    assert_allclose(found.kept, [1.0, 0.5])
    assert_allclose(found.purity, [4 / 6, 1.0, np.nan])
    assert found.main == {"1": "east", "2": "east"}
    assert_array_equal(found.false_tracks, [False, False, True])
    assert_allclose(found.missed, [0, 0, 1, 1, 0, 0])
    assert_allclose(found.false, [1, 1, 1, 1, 1, 1])
    assert_allclose(found.gospa.distance[0], np.sqrt(25.0 + 200.0))
    assert_allclose(found.gospa.distance[5], np.sqrt(36.0 + 200.0))
    assert_allclose(found.ospa[0], np.sqrt((25.0 + 400.0) / 2.0))


def test_no_tracks_at_all() -> None:
    found = made(np.zeros((0, T, 2)))
    assert_allclose(found.missed, [1, 1, 2, 2, 2, 2])
    assert_array_equal(found.kept, [0.0, 0.0])
    assert found.main == {}
    assert np.isnan(found.latency).all()


def test_purity_of_names() -> None:
    assert following.labels({"1": ["a", "a", "b", ""], "2": ["c"]}) == {"1": 2 / 3, "2": 1.0}
    assert np.isnan(following.labels({"1": ["", ""]})["1"])


@pytest.fixture(scope="module")
def tracked() -> tuple[Recording, Any]:
    bank = Bank([ConstantVelocity(psd=0.01)], birth_std={"velocity": 30.0})
    data = simulate_labelled(load("crossing"), 3).recording
    found = unlabelled(data)
    tracker = Tracker(bank, found.measurement)
    return data, tracker.run(found.scans[:30])


def test_tracks_count_from_their_confirmation_on(tracked: tuple[Recording, Any]) -> None:
    data, tracks = tracked
    found = following.follow(tracks, data, cutoff=40.0)
    assert found is not None
    for n, name in enumerate(tracks):
        alive = found.times[found.alive[n]]
        assert alive[0] == tracks.lives[name].confirmed
        assert alive[-1] == tracks.time
        i = np.searchsorted(tracks[name].times, alive)
        assert_allclose(found.position[n, found.alive[n]], tracks[name].position[i])
    _, by_tracks = tracks.at(found.times)
    assert_allclose(found.position, by_tracks)
    true = data.truth_at("northbound", found.times)[0]
    assert_allclose(found.truth[found.targets.index("northbound")], true)
    assert_array_equal(found.follower, metrics.follow(found.truth, by_tracks, 40.0))


def test_the_cutoff_is_three_sigmas_of_a_fix(tracked: tuple[Recording, Any]) -> None:
    data, tracks = tracked
    measurement = unlabelled(data).measurement
    found = following.follow(tracks, data, measurement=measurement)
    assert found is not None
    places = found.truth[found.present]
    C = bounds.crlb(data.stations, places, toa_sigma=50e-9)
    fix = np.median(np.sqrt(np.einsum("nii->n", C)))
    assert_allclose(found.cutoff, 3.0 * fix, rtol=0.05)  # two digits


def test_axes_of_the_truth(tracked: tuple[Recording, Any]) -> None:
    data, tracks = tracked
    only = attrs.evolve(data, truth_scoring=attrs.evolve(data.truth_scoring, axes=("y",)))
    found = following.follow(tracks, only, cutoff=40.0)
    assert found is not None
    assert found.truth.shape[-1] == found.position.shape[-1] == 1
    whole = following.follow(tracks, data, cutoff=40.0)
    assert whole is not None
    assert_allclose(found.truth[..., 0], whole.truth[..., 1])


def test_nothing_to_compare_with(tracked: tuple[Recording, Any]) -> None:
    data, tracks = tracked
    assert following.follow(tracks, attrs.evolve(data, truth=None), cutoff=1.0) is None
    assert following.follow(tracks, data, [1e9], cutoff=1.0) is None
    assert following.follow(tracks, data) is None  # nothing says what the cutoff is
