"""What an IMM refuses, and in which words."""

from __future__ import annotations

import numpy as np
import pytest
from imm_cases import KINDS, SIGMA, STATIONS, imm_2d

from imm_tdoa import IMM, Bank
from imm_tdoa.models import TDOA, Position, Static


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bank": [Static(psd=0.0)]}, "bank: expected a Bank"),
        ({"measurement": TDOA}, "measurement: no measurement model"),
        ({"measurement": Static(psd=1.0)}, "measurement: no measurement model"),
        ({"update": "kf"}, "update: expected"),
        ({"robust": "huber"}, "robust: expected"),
        ({"gate_probability": 1.0}, "gate_probability: expected a probability"),
        ({"gate_probability": 0.0}, "gate_probability: expected a number above 0"),
        ({"gate_probability": np.nan}, "gate_probability: expected a finite number"),
        ({"gate_probability": "high"}, "gate_probability: expected one number"),
    ],
)
def test_bad_estimators(arguments, message):
    good = {"bank": Bank(KINDS), "measurement": TDOA(STATIONS, toa_sigma=SIGMA)}
    with pytest.raises(ValueError, match=message):
        IMM(**{**good, **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mean": [1.0, 2.0, 3.0]}, r"mean: expected 2 components \(position\) or 6 \(x, y, vx"),
        ({"mean": 1.0}, r"mean: expected shape \(\.\.\., n,\)"),
        ({"mean": [np.nan, 0.0]}, "mean: expected finite numbers"),
        ({"mean": ["a", "b"]}, "mean: expected numbers"),
        ({"covariance": np.eye(3)}, r"covariance: expected shape \(\.\.\., 2, 2\)"),
        ({"covariance": [[1.0, 0.5], [0.2, 1.0]]}, "covariance: expected a symmetric"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance: expected a positive semi-def"),
        ({"covariance": -np.eye(2)}, "covariance: a variance on its diagonal is negative"),
        ({"covariance": np.full((2, 2), np.inf)}, "covariance: expected finite"),
        ({"time": np.nan}, "time: expected finite"),
        ({"components": ["x", "vx"]}, "components: expected 2 of"),
        ({"components": ["x", "y", "vx"]}, "components: expected 2 of"),
        ({"components": ["x", "omega"]}, "components: expected 2 of"),
        ({"components": ["x", "x"]}, "components: expected 2 of"),
        (
            {"components": ["x", "y", "vx", "vx"], "mean": [0.0] * 4, "covariance": np.eye(4)},
            "components: expected 4 of",
        ),
        (
            {"mean": np.zeros((3, 2)), "covariance": np.tile(np.eye(2), (4, 1, 1))},
            r"batch axes do not fit together: mean \(3,\), covariance \(4,\), time \(\)",
        ),
    ],
)
def test_bad_starts(arguments, message):
    good = {"time": 0.0, "mean": [0.0, 0.0], "covariance": np.eye(2)}
    with pytest.raises(ValueError, match=message):
        imm_2d().start(**{**good, **arguments})


@pytest.mark.parametrize(
    ("time", "values", "message"),
    [
        (4.0, np.zeros(4), "time: expected a time at or after the state's, 5 s, got 4 s"),
        (np.nan, np.zeros(4), "time: expected finite"),
        (6.0, np.zeros(3), r"values: expected shape \(\.\.\., 4,\), got \(3,\)"),
        (6.0, 0.0, r"values: expected shape \(\.\.\., 4,\)"),
        (6.0, [0.0, np.inf, 0.0, 0.0], "values: infinite values are refused .* index 1"),
        (6.0, ["a"] * 4, "values: expected numbers"),
    ],
)
def test_bad_steps(time, values, message):
    imm = imm_2d()
    with pytest.raises(ValueError, match=message):
        imm.step(imm.start(5.0, [0.0, 0.0], np.eye(2)), time, values)


def test_a_state_of_another_bank_is_refused():
    other = IMM(Bank([Static(psd=0.0)]), Position(1.0)).start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="state: expected a state of this bank's modes"):
        imm_2d().step(other, 1.0, np.zeros(4))
    with pytest.raises(ValueError, match="start: expected a state of this bank's modes"):
        imm_2d().run([1.0], np.zeros((1, 4)), start=other)


def test_pairs_for_what_measures_no_pairs_are_refused():
    imm = IMM(Bank([Static(psd=0.0)]), Position(1.0))
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="pairs: Position does not measure station pairs"):
        imm.step(start, 0.0, [0.0, 0.0], pairs=[[1, 0], [2, 0]])


def test_unknown_stations_in_pairs_are_refused():
    imm = imm_2d()
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="pairs: station 7 does not exist"):
        imm.step(start, 1.0, [0.0], pairs=[[7, 0]])
    with pytest.raises(ValueError, match="pairs: station 7 does not exist"):
        imm.run([1.0, 2.0], np.zeros((2, 1)), start=start, pairs=[[[1, 0]], [[7, 0]]])


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([1.0, 0.5], np.zeros((2, 4)), r"times: .*times\[1\] = 0.5 s follows 1 s"),
        ([-1.0, 0.5], np.zeros((2, 4)), "times: expected a time at or after the start's, 0 s"),
        ([1.0, 2.0, 3.0], np.zeros((2, 4)), r"values: expected shape \(\.\.\., 3, 4\)"),
        ([1.0, 2.0], np.zeros((2, 5)), r"values: expected shape \(\.\.\., 2, 4\)"),
        ([], np.zeros((0, 4)), "times: expected at least one scan"),
    ],
)
def test_bad_runs(times, values, message):
    imm = imm_2d()
    with pytest.raises(ValueError, match=message):
        imm.run(times, values, start=imm.start(0.0, [0.0, 0.0], np.eye(2)))


def test_batches_that_do_not_fit_are_refused():
    imm = imm_2d()
    start = imm.start(0.0, np.zeros((3, 2)), np.eye(2))
    with pytest.raises(ValueError, match=r"batch axes .*: state \(3,\), time \(\), values \(5,\)"):
        imm.step(start, 1.0, np.zeros((5, 4)))
    with pytest.raises(ValueError, match=r"batch axes .*: start \(3,\), times and values \(5,\)"):
        imm.run([1.0], np.zeros((5, 1, 4)), start=start)
    with pytest.raises(ValueError, match="measurement: expected one in 2 dimensions, got 3"):
        imm.step(start, 1.0, np.zeros(3), measurement=Position(1.0, dims=3))


def test_an_unknown_engine_is_refused():
    imm = imm_2d()
    with pytest.raises(ValueError, match="engine: expected"):
        imm.run([1.0], np.zeros((1, 4)), start=imm.start(0, [0, 0], np.eye(2)), engine="steam")


def test_a_measurement_beyond_all_numbers_is_refused():
    imm = IMM(Bank([Static(psd=0.0)]), Position(1.0, dims=1))
    with pytest.raises(ValueError, match="at time 3 s no mode can explain the measurement"):
        imm.step(imm.start(3.0, [0.0], [[1.0]]), 3.0, [1e200])
