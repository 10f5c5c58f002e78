"""Where the stations are: fixed, sampled, interpolated, unheard."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Stations
from imm_tdoa.stations import pair_index

FIXED = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])


def cubic(coefficients, t):
    """Positions and velocities (..., S, d) of cubic paths with coefficients (4, S, d)."""
    t = np.asarray(t, dtype=float)[..., None, None]
    c = coefficients
    return c[0] + c[1] * t + c[2] * t**2 + c[3] * t**3, c[1] + 2 * c[2] * t + 3 * c[3] * t**2


class TestFixed:
    def test_they_stand_where_they_stand(self):
        stations = Stations(FIXED)
        for time in (0.0, 1e9, np.array([1.0, 2.0])):
            p, v = stations.at(time)
            assert_array_equal(p, FIXED)
            assert_array_equal(v, np.zeros((3, 2)))
        assert len(stations) == 3
        assert (stations.dims, stations.moving) == (2, False)
        assert stations.names == ("0", "1", "2")

    def test_a_velocity_counts_though_the_position_is_fixed(self):
        v = np.ones((3, 2))
        assert_array_equal(Stations(FIXED, velocities=v).at(5.0)[1], v)

    def test_the_callers_array_is_copied_and_ours_is_read_only(self):
        mine = FIXED.copy()
        stations = Stations(mine)
        mine[0, 0] = 99.0
        assert stations.positions[0, 0] == 0.0
        with pytest.raises(ValueError, match="read-only"):
            stations.positions[0, 0] = 1.0


class TestMoving:
    T = np.array([0.0, 1.0, 3.0, 4.5])

    def test_exactly_at_a_sample(self):
        rng = np.random.default_rng(0)
        P, V = rng.normal(size=(4, 3, 2)), rng.normal(size=(4, 3, 2))
        for k, t in enumerate(self.T):
            p, v = Stations(P, velocities=V, times=self.T).at(t)
            assert_array_equal(p, P[k])
            assert_array_equal(v, V[k])
            assert_array_equal(Stations(P, times=self.T).at(t)[0], P[k])

    @settings(deadline=None, max_examples=40)
    @given(seed=st.integers(0, 2**32 - 1), t=st.floats(0.0, 4.5))
    def test_straight_between_samples_without_velocities(self, seed, t):
        P = np.random.default_rng(seed).normal(size=(4, 3, 2))
        k = min(np.searchsorted(self.T, t, side="right") - 1, 2)
        s = (t - self.T[k]) / (self.T[k + 1] - self.T[k])
        p, v = Stations(P, times=self.T).at(t)
        assert_allclose(p, (1 - s) * P[k] + s * P[k + 1], rtol=1e-12, atol=1e-12)
        if t not in self.T:
            slope = (P[k + 1] - P[k]) / (self.T[k + 1] - self.T[k])
            assert_allclose(v, slope, rtol=1e-12, atol=1e-12)

    @settings(deadline=None, max_examples=40)
    @given(seed=st.integers(0, 2**32 - 1), t=st.floats(0.0, 4.5))
    def test_hermite_interpolation_is_exact_on_cubics(self, seed, t):
        c = np.random.default_rng(seed).normal(size=(4, 3, 2))
        P, V = cubic(c, self.T)
        p, v = Stations(P, velocities=V, times=self.T).at(t)
        want_p, want_v = cubic(c, t)
        assert_allclose(p, want_p, rtol=1e-10, atol=1e-10)
        assert_allclose(v, want_v, rtol=1e-9, atol=1e-9)

    def test_velocity_at_a_sample_without_velocities_is_the_slope_between_its_neighbours(self):
        x = np.array([0.0, 1.0, 5.0, 5.0])
        stations = Stations(x[:, None, None], times=self.T)
        got = [float(stations.at(t)[1][0, 0]) for t in self.T]
        assert_allclose(got, [1.0, 5.0 / 3.0, 4.0 / 3.5, 0.0])

    def test_one_sample_stands(self):
        stations = Stations(FIXED[None], times=[2.0])
        p, v = stations.at(2.0)
        assert_array_equal(p, FIXED)
        assert_array_equal(v, np.zeros((3, 2)))
        assert np.isnan(stations.at(2.1)[0]).all()

    @pytest.mark.parametrize("t", [-0.1, 4.6, np.nan])
    def test_outside_its_samples_a_station_is_not_heard(self, t):
        P = np.random.default_rng(0).normal(size=(4, 3, 2))
        for part in Stations(P, times=self.T).at(t):
            assert np.isnan(part).all()

    def test_gaps_are_bridged_per_station(self):
        """A NaN sample is no sample: interpolated over, silent where one side is missing."""
        c = np.random.default_rng(1).normal(size=(4, 2, 2))
        P, V = cubic(c, self.T)
        for velocities in (None, V):
            gap = P.copy()
            gap[1, 0] = np.nan  # bridged
            gap[3, 1] = np.nan  # station 1 ends at its third sample
            stations = Stations(gap, velocities=velocities, times=self.T)
            p, _ = stations.at(1.0)
            straight = P[0, 0] + (P[2, 0] - P[0, 0]) / 3.0
            want = straight if velocities is None else cubic(c, 1.0)[0][0]
            assert_allclose(p[0], want, rtol=1e-10, atol=1e-10)
            assert_allclose(p[1], P[1, 1], rtol=1e-12)
            p, v = stations.at(4.0)
            assert np.isfinite(p[0]).all()
            assert np.isnan(p[1]).all()
            assert np.isnan(v[1]).all()
            assert_array_equal(stations.at(3.0)[0], P[2])

    def test_many_times_at_once(self):
        c = np.random.default_rng(2).normal(size=(4, 3, 3))
        P, V = cubic(c, self.T)
        stations = Stations(P, velocities=V, times=self.T)
        t = np.array([[0.0, 0.7, 5.0], [4.5, 3.0, 2.2]])
        p, v = stations.at(t)
        assert p.shape == v.shape == (2, 3, 3, 3)
        for index in np.ndindex(t.shape):
            one = stations.at(t[index])
            assert_array_equal(p[index], one[0])
            assert_array_equal(v[index], one[1])


class TestRefused:
    @pytest.mark.parametrize(
        ("positions", "arguments", "message"),
        [
            ([0.0, 1.0], {}, r"positions: expected shape \(S, d\), got \(2,\)"),
            (np.zeros((2, 4)), {}, "dims: expected 1, 2 or 3"),
            ([[0.0, np.nan], [1.0, 1.0]], {}, "positions: expected finite"),
            ([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]], {}, "stations '0' and '2' are in the same"),
            (FIXED, {"velocities": np.zeros((2, 2))}, r"velocities: expected shape \(3, 2\)"),
            (FIXED, {"velocities": np.full((3, 2), np.nan)}, "velocities: expected finite"),
            (FIXED, {"times": [0.0]}, r"positions: expected shape \(K, S, d\)"),
            (np.zeros((2, 3, 2)), {"times": [1.0, 1.0]}, r"times\[1\] = 1 s follows 1 s"),
            (np.zeros((2, 3, 2)), {"times": [2.0, 1.0]}, "times: expected strictly increasing"),
            (np.zeros((2, 3, 2)), {"times": [0.0, np.nan]}, "times: expected finite"),
            (np.zeros((2, 3, 2)), {"times": [0.0, 1.0, 2.0]}, r"times: expected shape \(2,\)"),
            (np.full((2, 3, 2), np.inf), {"times": [0.0, 1.0]}, "positions: infinite values"),
            (FIXED, {"position_covariance": np.eye(2)}, r"position_covariance: expected shape"),
            (
                FIXED,
                {"position_covariance": np.tile(-np.eye(2), (3, 1, 1))},
                "position_covariance: a variance on its diagonal is negative",
            ),
            (
                FIXED,
                {"velocity_covariance": np.tile([[1.0, 2.0], [2.0, 1.0]], (3, 1, 1))},
                "velocity_covariance: expected a positive semi-definite",
            ),
            (FIXED, {"names": ["a", "b"]}, "names: expected 3 names, one per station, got 2"),
            (FIXED, {"names": ["a", "b", "a"]}, "names: the station 'a' appears twice"),
        ],
    )
    def test_stations(self, positions, arguments, message):
        with pytest.raises(ValueError, match=message):
            Stations(positions, **arguments)

    def test_names_appear_in_messages(self):
        with pytest.raises(ValueError, match="stations 'roof' and 'mast'"):
            Stations([[0.0, 0.0], [0.0, 0.0]], names=["roof", "mast"])


class TestPairs:
    def test_by_name(self):
        assert_array_equal(pair_index("reference", 4), [[1, 0], [2, 0], [3, 0]])
        assert_array_equal(pair_index("adjacent", Stations(FIXED)), [[0, 1], [1, 2]])
        assert pair_index("reference", 1).shape == (0, 2)

    def test_given(self):
        assert_array_equal(pair_index([[2, 1]], 3), [[2, 1]])
        assert pair_index(np.zeros((5, 0, 2), dtype=int), 3).shape == (5, 0, 2)

    @pytest.mark.parametrize(
        ("pairs", "message"),
        [
            ("every", "pairs: expected 'reference', 'adjacent' or an array"),
            ([1, 0], r"pairs: expected shape \(\.\.\., m, 2\)"),
            ([[1, 0, 2]], r"pairs: expected shape \(\.\.\., m, 2\)"),
            ([[1, 0], [2]], "pairs: expected "),
            ([[1.0, 0.0]], "pairs: expected integers, got float64"),
            ([[True, False]], "pairs: expected integers"),
            ([["a", "b"]], "pairs: expected integers"),
            ([[3, 0]], "pairs: station 3 does not exist; there are 3"),
            ([[-1, 0]], "pairs: station -1 does not exist"),
            ([[1, 1]], "pairs: station 1 is paired with itself"),
        ],
    )
    def test_refused(self, pairs, message):
        with pytest.raises(ValueError, match=message):
            pair_index(pairs, 3)
