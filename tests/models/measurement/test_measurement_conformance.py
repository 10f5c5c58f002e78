"""Every measurement model that ships obeys every law of the kit, in all its variants."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from imm_tdoa import Stations, registry
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.models import FDOA, TDOA, TOA, Height, Position, RangeRate, Stack
from imm_tdoa.testing import check_measurement_model

PLACES = np.array([[0.0, 0.0], [9e3, 1e3], [2e3, 8e3], [-7e3, -5e3], [-3e3, 6e3]])
SPEEDS = np.array([[0.0, 0.0], [30.0, 5.0], [-20.0, 15.0], [3.0, -40.0], [1.0, 2.0]])
LOOPS = [[1, 0], [2, 1], [2, 0], [3, 2], [0, 3], [4, 1]]
SPREAD = np.array([5.0, 10.0, 20.0, 40.0, 80.0]) * 1e-9


def blocks(scale: float, d: int) -> np.ndarray:
    """Five different covariances (5, d, d) with correlations."""
    A = np.random.default_rng(7).normal(size=(5, d, d))
    return scale**2 * (A @ np.swapaxes(A, -1, -2) + np.eye(d))


FIXED = Stations(PLACES, velocities=SPEEDS)
DEEP = Stations(np.column_stack([PLACES, [20.0, 300.0, 5.0, 90.0, 1500.0]]))
TIMES = np.array([0.0, 8.0, 20.0])
MOVING = Stations(
    PLACES + TIMES[:, None, None] * SPEEDS,
    velocities=np.stack([SPEEDS, 0.5 * SPEEDS, SPEEDS]),
    times=TIMES,
)
UNSURE = Stations(
    PLACES,
    velocities=SPEEDS,
    position_covariance=blocks(15.0, 2),
    velocity_covariance=blocks(0.3, 2),
)
DRIFTING = Stations(MOVING.positions, times=TIMES, position_covariance=blocks(15.0, 2))
FRAME = EastNorthUp(47.4, 8.5, 430.0)
SOMETIMES = {"sigma_times": [1.0, 4.0]}

MAIN = {
    "position": Position(sigma=[5.0, 9.0], dims=2),
    "tdoa": TDOA(FIXED, toa_sigma=SPREAD),
    "toa": TOA(UNSURE, sigma=SPREAD),
    "fdoa": FDOA(UNSURE, range_rate_sigma=0.2),
    "range-rate": RangeRate(MOVING, sigma=0.2),
    "height": Height(sigma=5.0, frame=FRAME),
    "stack": Stack(TDOA(UNSURE, toa_sigma=5e-8), FDOA(UNSURE, range_rate_sigma=0.2)),
}
VARIANTS = {
    "position 1-D": Position(sigma=10.0, dims=1),
    "position 3-D, sampled": Position(sigma=[[1.0, 2.0, 3.0]] * 2, dims=3, **SOMETIMES),
    "tdoa 3-D": TDOA(DEEP, toa_sigma=7e-8),
    "tdoa adjacent": TDOA(FIXED, toa_sigma=SPREAD, pairs="adjacent"),
    "tdoa loops": TDOA(FIXED, toa_sigma=SPREAD, pairs=LOOPS),
    "tdoa loops, independent": TDOA(FIXED, tdoa_sigma=1e-7, pairs=LOOPS),
    "tdoa differences": TDOA(FIXED, tdoa_sigma=SPREAD[:4]),
    "tdoa moving": TDOA(MOVING, toa_sigma=7e-8, pairs=LOOPS),
    "tdoa unsure": TDOA(UNSURE, toa_sigma=SPREAD),
    "tdoa unsure loops": TDOA(UNSURE, toa_sigma=SPREAD, pairs=LOOPS),
    "tdoa moving and unsure": TDOA(DRIFTING, toa_sigma=7e-8),
    "tdoa under water": TDOA(FIXED, toa_sigma=1e-3, speed=1500.0),
    "tdoa sampled": TDOA(FIXED, toa_sigma=np.stack([SPREAD, 2 * SPREAD]), **SOMETIMES),
    "tdoa two stations": TDOA(Stations(PLACES[:2]), toa_sigma=7e-8),
    "tdoa one dimension": TDOA(Stations([[0.0], [4e3], [7e3]]), toa_sigma=7e-8),
    "toa 3-D": TOA(DEEP, sigma=7e-8),
    "fdoa loops": FDOA(FIXED, range_rate_sigma=[0.1, 0.2, 0.3, 0.4, 0.5], pairs=LOOPS),
    "fdoa differences, moving": FDOA(MOVING, difference_sigma=0.2, pairs="adjacent"),
    "fdoa 3-D": FDOA(DEEP, range_rate_sigma=0.1),
    "range rate unsure": RangeRate(UNSURE, sigma=0.2),
    "height, local": Height(sigma=5.0),
    "stack of groups": Stack(TOA(UNSURE, sigma=5e-8), RangeRate(UNSURE, sigma=0.2)),
    "stack 3-D": Stack(TDOA(DEEP, toa_sigma=7e-8), Height(sigma=5.0)),
    "stack of strangers": Stack(TDOA(FIXED, toa_sigma=7e-8, pairs=LOOPS), TOA(UNSURE, sigma=1e-7)),
}


def refused(model: object) -> list:
    """Return calls that each model's constructor must refuse."""
    if isinstance(model, Stack):
        return [Stack, lambda: Stack(model, Height()), lambda: Stack(3)]
    name = {TDOA: "toa_sigma", FDOA: "range_rate_sigma"}.get(type(model), "sigma")
    stations = (model.stations,) if hasattr(model, "stations") else ()
    return [partial(type(model), *stations, **{name: bad}) for bad in (-1.0, 0.0, np.nan)]


@pytest.mark.parametrize("name", MAIN)
def test_model(name):
    check_measurement_model(MAIN[name], bad_arguments=refused(MAIN[name]), examples=25)


@pytest.mark.parametrize("name", VARIANTS)
def test_variant(name):
    check_measurement_model(VARIANTS[name], examples=8)


def test_all_registered_measurement_models_are_tried_here():
    assert set(registry.names("measurement")) - set(MAIN) <= {"phase-difference"}
