"""Predictions and unlabelled rows: shapes, unknown rows, emissions, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import mixture, tracking
from imm_tdoa.tracking import Prediction, Unlabelled


def test_every_associator_keeps_the_protocol():
    for associator in (
        tracking.Nearest(),
        tracking.GlobalNearest(),
        tracking.Jpda(0.9, 1e-4),
    ):
        assert isinstance(associator, tracking.Associator)


@pytest.mark.parametrize(
    "associator",
    [
        tracking.Nearest(),
        tracking.Nearest(no_match="predicted"),
        tracking.GlobalNearest(over="station"),
        tracking.GlobalNearest(),
        tracking.Jpda(0.9, 1e-4),
    ],
    ids=repr,
)
def test_nothing_measured_no_target_and_unknown_rows(associator):
    one = Prediction([[1.0, np.nan]], [[[4.0, np.nan], [np.nan, np.nan]]])
    empty = associator(one, Unlabelled([], []))
    assert empty.weight.shape == (1, 0)
    assert_array_equal(empty.missed, [[1.0, 1.0]])
    scan = Unlabelled([1.5, 3.0, np.nan], [0, 1, 0])
    got = associator(one, scan)  # row 1 cannot be measured, the third value was not
    assert_array_equal(got.weight[:, 1:], [[0.0, 0.0]])
    assert got.weight[0, 0] > 0.5
    assert_array_equal(got.unclaimed[1:], [1.0, 1.0])
    assert np.isnan(got.values[0, 1])
    if not got.decided:
        assert_array_equal(got.innovation[..., 1], 0.0)
        assert_array_equal(got.covariance[0, 0, 1], [0.0, 1.0])
    nobody = associator(Prediction(np.zeros((0, 2)), np.zeros((0, 2, 2))), scan)
    assert nobody.weight.shape == (0, 3)
    assert_array_equal(nobody.unclaimed, 1.0)


def test_the_bank_is_the_mixture_of_its_modes():
    rng = np.random.default_rng(0)
    mean = rng.normal(size=(2, 3, 2))
    A = rng.normal(size=(2, 3, 2, 2))
    S = A @ np.swapaxes(A, -1, -2) + np.eye(2)
    w = np.array([[0.2, 0.3, 0.5], [1.0, 0.0, 0.0]])
    with np.errstate(divide="ignore"):
        bank = Prediction(mean, S, log_weight=np.log(w))
    got_mean, got_S = bank.bank()
    want_mean, want_S = mixture.moments(w, mean, S)
    assert_allclose(got_mean, want_mean)
    assert_allclose(got_S, want_S)
    assert_allclose(got_S[1], S[1, 0])


def test_modes_on_either_side_of_an_angle_average_where_they_are():
    mean = np.array([[[3.1], [-3.1]]])
    bank = Prediction(
        mean, np.full((1, 2, 1, 1), 1e-4), log_weight=np.log([[0.5, 0.5]]), angular=[True]
    )
    middle, S = bank.bank()
    assert_allclose(np.abs(middle), np.pi, atol=1e-12)
    assert S[0, 0, 0] < 0.01
    got = tracking.Nearest()(bank, Unlabelled([-3.14], [0]))
    assert_array_equal(got.values, [[-3.14]])


def test_values_of_one_emission_are_one_candidate():
    scan = Unlabelled([1.0, 2.0, 3.0, np.nan], [2, 0, 2, 0], emission=[7, 7, 5, 5])
    (block,) = scan.blocks(4)
    assert_array_equal(block.columns, [0, 2])
    assert_array_equal(block.z, [[np.nan, 3.0], [2.0, 1.0]])
    assert_array_equal(block.members, [[-1, 2], [1, 0]])
    columns = [b.columns.tolist() for b in Unlabelled([1.0, 2.0, 3.0], [2, 0, 2]).blocks(3)]
    assert columns == [[0], [2]]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Prediction([1.0], [[1.0]]), r"mean: expected shape \(N, m\)"),
        (lambda: Prediction([[1.0, 2.0]], [[1.0]]), r"covariance: expected shape \(1, 2, 2\)"),
        (lambda: Prediction([[1.0]], [[[0.0]]]), "covariance: .*positive variances"),
        (lambda: Prediction([[1.0]], [[[np.nan]]]), "covariance: .*finite"),
        (lambda: Prediction([[np.inf]], [[[1.0]]]), "mean: infinite"),
        (
            lambda: Prediction(np.ones((1, 2, 1)), np.ones((1, 2, 1, 1))),
            "log_weight: needed for 2 modes",
        ),
        (
            lambda: Prediction(np.ones((1, 2, 1)), np.ones((1, 2, 1, 1)), log_weight=[[0.0, 0.0]]),
            "log_weight: expected logs of weights that sum to 1",
        ),
        (
            lambda: Prediction(np.ones((1, 2, 1)), np.ones((1, 2, 1, 1)), log_weight=[0.5]),
            r"log_weight: expected shape \(1, 2\)",
        ),
        (lambda: Prediction([[1.0]], [[[1.0]]], angular=[1]), "angular: expected 1 booleans"),
        (lambda: Unlabelled([np.inf], [0]), "values: infinite"),
        (lambda: Unlabelled([1.0, 2.0], [0]), "row: expected 2 row numbers"),
        (lambda: Unlabelled([1.0], [-1]), "row: expected numbers from 0, got -1"),
        (lambda: Unlabelled([1.0], [0.5]), "row: expected whole numbers"),
        (lambda: Unlabelled([1.0], [0], emission=[0, 1]), "emission: expected 1 numbers"),
        (
            lambda: Unlabelled([1.0, 2.0], [3, 3], emission=[4, 4]),
            "emission 4 has more than one value of row 3",
        ),
        (
            lambda: tracking.Nearest()(Prediction([[1.0]], [[[1.0]]]), Unlabelled([1.0], [1])),
            "row: expected row numbers below 1",
        ),
        (lambda: tracking.Nearest(gamma=0.0), "gamma: expected a number above 0"),
        (lambda: tracking.Nearest(mu=-1.0), "mu: expected a number above 0"),
        (lambda: tracking.Nearest(no_match="keep"), "no_match: expected one of 'drop'"),
        (lambda: tracking.GlobalNearest(over="row"), "over: expected one of 'station'"),
        (lambda: tracking.GlobalNearest(gate_probability=1.0), "gate_probability: .*below 1"),
        (lambda: tracking.GlobalNearest(unassigned=np.nan), "unassigned: expected finite"),
        (lambda: tracking.Jpda(1.1, 1.0), "detection_probability: expected at most 1"),
        (lambda: tracking.Jpda(0.9, 0.0), "clutter_density: expected densities above 0"),
        (lambda: tracking.Jpda(0.9, 1.0, exact_up_to=20), "exact_up_to: expected a size"),
        (
            lambda: tracking.Jpda(0.9, 1.0, permutations="some"),
            "permutations: expected one of 'all', 'best'",
        ),
        (
            lambda: tracking.Jpda(0.9, [1.0, 2.0])(
                Prediction([[1.0]], [[[1.0]]]), Unlabelled([], [])
            ),
            "clutter_density: expected one density or 1",
        ),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
