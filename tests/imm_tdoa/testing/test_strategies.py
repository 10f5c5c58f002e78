"""What the public strategies promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imm_tdoa.models import FDOA, TDOA, Height, Stack
from imm_tdoa.stations import Stations
from imm_tdoa.testing import strategies as kit

quick = settings(max_examples=25, deadline=None, database=None, derandomize=True)
NAMES = ("x", "y", "vx", "vy", "ax", "ay", "omega", "heading")


@quick
@given(kit.time_steps(), kit.time_steps(0.5, 2.0), kit.numbers(-1.0, 1.0, decimals=1))
def test_numbers_stay_within_bounds(dt, short, number):
    assert 1e-3 <= dt <= 100.0
    assert 0.5 <= short <= 2.0
    assert -1.0 <= number <= 1.0
    assert number == round(number, 1)


@quick
@given(kit.states(NAMES))
def test_states_stay_within_what_their_names_allow(x):
    bound = [1e5, 1e5, 1e3, 1e3, 50.0, 50.0, 0.5, 1.0]
    assert np.all(np.abs(x) <= bound)
    tiny = np.abs(x[x != 0.0])
    assert tiny.size == 0 or tiny.min() >= 1e-6


@quick
@given(st.sampled_from([2, 3]).flatmap(kit.rotations))
def test_rotations_are_rotations(R):
    np.testing.assert_allclose(R @ R.T, np.eye(len(R)), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    if len(R) == 3:
        assert np.array_equal(R[2], [0.0, 0.0, 1.0])


def test_rotations_need_a_plane():
    with pytest.raises(ValueError, match="dims: expected 2 or 3"):
        kit.rotations(1)


@quick
@given(kit.covariances(3), kit.station_pairs(4), kit.present_rows(5, low=2))
def test_matrices_pairs_and_masks(P, pairs, present):
    assert np.linalg.eigvalsh(P)[0] >= 1.0 - 1e-9
    assert pairs.shape[1] == 2
    assert np.all(pairs[:, 0] != pairs[:, 1])
    assert len({frozenset(p) for p in pairs.tolist()}) == len(pairs)
    assert present.shape == (5,)
    assert present.sum() >= 2


@quick
@given(st.data(), st.sampled_from([1, 2, 3]), st.booleans(), st.booleans())
def test_station_arrays(data, dims, moving, uncertain):
    stations = data.draw(kit.station_arrays(dims, moving=moving, uncertain=uncertain))
    assert 3 <= len(stations) <= 6
    assert stations.dims == dims
    assert stations.moving == moving
    assert (stations.position_covariance is not None) == uncertain
    place, velocity = stations.at(10.0)
    apart = np.linalg.norm(place[:, None] - place, axis=-1) + 1e9 * np.eye(len(stations))
    assert apart.min() > 50.0
    assert np.any(velocity != 0.0) or np.all(velocity == 0.0)


@quick
@given(st.data())
def test_emitters_can_be_measured(data):
    stations = data.draw(kit.station_arrays(3, moving=True))
    both = Stack(TDOA(stations, toa_sigma=1e-7), Height(sigma=5.0))
    k = data.draw(kit.kinematics(both))
    place = stations.at(k.time)[0]
    assert 0.0 <= k.time <= 20.0
    assert np.all(np.isfinite(both.predict(*k)))
    assert np.linalg.norm(place - k.position, axis=-1).min() > 1.0
    assert np.all(np.abs(k.velocity) <= 300.0)


def test_times_are_those_at_which_noise_is_known():
    stations = Stations(np.array([[0.0, 0.0], [1e3, 0.0], [0.0, 1e3]]))
    sampled = FDOA(stations, range_rate_sigma=np.ones((2, 3)), sigma_times=[3.0, 7.0])
    fixed = TDOA(stations, toa_sigma=1e-7)

    @quick
    @given(kit.kinematics(Stack(fixed, sampled)))
    def check(k):
        assert k.time in (3.0, 7.0)

    check()
    assert len(kit.stations_of(Stack(fixed, sampled))) == 2
