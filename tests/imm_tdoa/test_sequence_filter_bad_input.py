"""What the sequence filter refuses, and in which words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sequence_cases import FIELD, PLACE, ring

from imm_tdoa import SequenceFilter, Stations
from imm_tdoa.sequence_filter import kappa


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "sigma: give exactly one of tick, toa_sigma, tdoa_sigma, got none"),
        (
            {"tick": 1e-9, "toa_sigma": 1e-9},
            "sigma: give exactly one of tick, toa_sigma, tdoa_sigma, got tick, toa_sigma",
        ),
        ({"tick": 0.0}, "tick: expected a number above 0, got 0.0"),
        ({"tick": 1e-9, "r_factor": -1}, "r_factor: expected a number above 0, got -1"),
        ({"tick": 1e-9, "sigma_times": [0.0]}, "sigma_times: a clock tick does not change"),
        ({"toa_sigma": -1e-9}, "toa_sigma: expected standard deviations above 0"),
        ({"toa_sigma": [1e-9, 1e-9]}, "toa_sigma: expected one number or 5 of them, got (2,)"),
        ({"tick": 1e-9, "rule": "isotropic"}, "rule: expected one of 'iso', 'proj', 'bound', got"),
        ({"tick": 1e-9, "multiplier": -1.0}, "multiplier: expected a number of at least 0"),
        ({"tick": 1e-9, "multiplier": "much"}, "multiplier: expected one number, got 'much', or"),
        ({"tick": 1e-9, "floor": -1e-12}, "floor: expected a number of at least 0, got -1e-12"),
        ({"tick": 1e-9, "gate": 0.0}, "gate: expected a number above 0, got 0.0"),
        ({"tick": 1e-9, "gate_s": "x"}, "gate_s: expected one number, got 'x'"),
        ({"tick": 1e-9, "test": "prior"}, "test: expected one of 'posterior', 'innovation'"),
        ({"tick": 1e-9, "weights": "own"}, "weights: expected one of 'full', 'diagonal'"),
        ({"tick": 1e-9, "reset_on_gate": "no"}, "reset_on_gate: expected one of True, False"),
        ({"tick": 1e-9, "speed": 0.0}, "speed: expected a number above 0"),
    ],
)
def test_bad_settings(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        SequenceFilter(Stations(FIELD), **arguments)
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("stations", "message"),
    [
        (Stations(FIELD[:2]), "stations: expected at least 3 in 2 dimensions, got 2"),
        (Stations(np.eye(3)), "stations: expected at least 4 in 3 dimensions, got 3"),
        (FIELD, "stations: expected Stations, got array"),
    ],
)
def test_bad_stations(stations: Any, message: str) -> None:
    for make in (lambda: SequenceFilter(stations, tick=1e-9), lambda: kappa(stations, PLACE)):
        with pytest.raises(ValueError) as raised:
            make()
        assert str(raised.value).startswith(message)


@pytest.mark.parametrize(
    ("times", "tdoa", "message"),
    [
        ([0.0, 2.0, 1.0], np.zeros((3, 4)), "times: expected times that do not decrease"),
        ([0.0, np.nan, 1.0], np.zeros((3, 4)), "times: expected finite numbers"),
        ([], np.zeros((0, 4)), "times: expected at least one scan"),
        ([0.0, 1.0], np.zeros((3, 4)), "tdoa: expected shape (..., 2, 4), got (3, 4)"),
        ([0.0, 1.0], np.zeros((2, 5)), "tdoa: expected shape (..., 2, 4), got (2, 5)"),
        ([0.0, 1.0], np.full((2, 4), np.inf), "tdoa: infinite values are refused"),
        ([0.0, 1.0], "abc", "tdoa: expected numbers"),
    ],
)
def test_bad_sequences(times: Any, tdoa: Any, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        SequenceFilter(Stations(FIELD), tick=1e-9).run(times, tdoa)
    assert str(raised.value).startswith(message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rule": "any"}, "rule: expected one of"),
        ({"weights": "any"}, "weights: expected one of"),
        ({"multiplier": -0.5}, "multiplier: expected a number of at least 0"),
        ({"position": [1.0, 2.0, 3.0]}, "position: expected shape (..., 2,), got (3,)"),
        ({"position": [np.nan, 2.0]}, "position: expected finite numbers"),
    ],
)
def test_kappa_of_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        kappa(ring(), **{"position": PLACE, **arguments})
    assert str(raised.value).startswith(message)
