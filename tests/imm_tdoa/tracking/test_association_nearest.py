"""Nearest neighbour as Source A's eq. (12) has it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import TDOA, Static
from imm_tdoa.tracking import Nearest, Prediction, Unlabelled

# three slaves of one master; two targets, predicted differences in metres
PREDICTED = np.array([[100.0, -50.0, 0.0], [130.0, -40.0, 400.0]])
S = np.broadcast_to(np.diag([25.0, 16.0, 100.0]), (2, 3, 3))
VALUES = np.array([112.0, 96.0, 131.0, -47.0, -90.0, 60.0])
ROW = np.array([0, 0, 0, 1, 1, 2])


def test_hand_made_case_with_a_fixed_gate():
    """Distances of target 0: station 1: 12, 4, 31; station 2: 3, 40; station 3: 60.

    Of target 1: 18, 34, 1; 7, 50; 340.
    """
    got = Nearest(mu=10.0)(Prediction(PREDICTED, S), Unlabelled(VALUES, ROW))
    assert_array_equal(got.values, [[96.0, -47.0, np.nan], [131.0, -47.0, np.nan]])
    assert_array_equal(got.missed, [[0, 0, 1], [0, 0, 1]])
    assert_array_equal(got.weight, [[0, 1, 0, 1, 0, 0], [0, 0, 1, 1, 0, 0]])
    assert_array_equal(got.unclaimed, [1, 0, 0, 0, 1, 1])  # both targets took the fourth value
    wide = Nearest(mu=61.0)(Prediction(PREDICTED, S), Unlabelled(VALUES, ROW))
    assert_array_equal(wide.values, [[96.0, -47.0, 60.0], [131.0, -47.0, np.nan]])


def test_the_gate_is_strict_as_printed():
    one = Prediction([[0.0]], [[[4.0]]])
    assert_array_equal(Nearest(mu=5.0)(one, Unlabelled([5.0], [0])).values, [[np.nan]])
    assert_array_equal(Nearest(mu=5.1)(one, Unlabelled([5.0], [0])).values, [[5.0]])
    assert_array_equal(Nearest(gamma=2.5)(one, Unlabelled([5.0], [0])).values, [[np.nan]])
    assert_array_equal(Nearest(gamma=2.6)(one, Unlabelled([5.0], [0])).values, [[5.0]])


def test_the_gate_in_standard_deviations_is_each_rows_own():
    """sqrt(S_ii) = 5, 4, 10: with gamma 3 the gates are 15, 12 and 30 m."""
    got = Nearest(gamma=3.0)(Prediction(PREDICTED, S), Unlabelled(VALUES, ROW))
    assert_array_equal(got.values, [[96.0, -47.0, np.nan], [131.0, -47.0, np.nan]])
    tight = Nearest(gamma=0.77)(Prediction(PREDICTED, S), Unlabelled(VALUES, ROW))
    assert_array_equal(tight.values, [[np.nan, -47.0, np.nan], [131.0, np.nan, np.nan]])


def test_no_match_may_become_the_prediction_as_printed():
    got = Nearest(mu=10.0, no_match="predicted")(Prediction(PREDICTED, S), Unlabelled(VALUES, ROW))
    assert_array_equal(got.values, [[96.0, -47.0, 0.0], [131.0, -47.0, 400.0]])
    assert_array_equal(got.missed, [[0, 0, 1], [0, 0, 1]])  # it was still not measured


def test_a_prediction_taken_for_data_shrinks_the_covariance_only():
    """ALGORITHMS §5.2-6: the mean is untouched, P shrinks as if data had arrived."""
    stations = Stations([[0.0, 0.0], [1e4, 0.0], [0.0, 1e4], [1e4, 1.2e4]])
    measurement = TDOA(stations, tdoa_sigma=100e-9, speed=1.0 / 1e-9)
    imm = IMM(Bank([Static(psd=0.0)]), measurement)
    before = imm.start(0.0, [4e3, 3e3], 1e4 * np.eye(2))
    at = measurement.predict(np.array([4e3, 3e3]), np.zeros(2), 0.0)
    H, _ = measurement.jacobian(np.array([4e3, 3e3]), np.zeros(2), 0.0)
    R = measurement.noise_covariance(np.array([4e3, 3e3]), np.zeros(2), 0.0)
    prediction = Prediction(at[None], (H @ before.covariance @ H.T + R)[None])
    nothing = Unlabelled([], [])
    for no_match, shrinks in (("drop", False), ("predicted", True)):
        rows = Nearest(no_match=no_match)(prediction, nothing).values[0]
        after = imm.step(before, 1.0, rows / measurement.scale)
        np.testing.assert_allclose(after.mean, before.mean, rtol=1e-12)
        ratio = np.trace(after.covariance) / np.trace(before.covariance)
        assert ratio == pytest.approx(1.0) if not shrinks else ratio < 0.5


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 2), st.floats(-50.0, 50.0)), max_size=8),
    st.lists(st.tuples(*[st.floats(-50.0, 50.0)] * 3), min_size=1, max_size=3),
    st.floats(0.1, 60.0),
)
def test_equation_12_word_for_word(rows, predicted, mu):
    row = np.array([i for i, _ in rows], dtype=int)
    values = np.array([z for _, z in rows])
    S = np.broadcast_to(np.eye(3), (len(predicted), 3, 3))
    got = Nearest(mu=mu)(Prediction(np.array(predicted), S), Unlabelled(values, row)).values
    for p, target in enumerate(predicted):
        for i in range(3):
            own = [z for z, j in zip(values, row, strict=True) if j == i]
            best = min(own, key=lambda z: abs(target[i] - z), default=None)
            if best is None or not abs(target[i] - best) < mu:
                assert np.isnan(got[p, i])
            else:
                assert got[p, i] == best
