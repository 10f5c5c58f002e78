"""What the bound of a whole track refuses, and in which words."""

from __future__ import annotations

import numpy as np
import pytest
from bounds_cases import SQUARE, T3
from numpy.testing import assert_allclose

from imm_tdoa import Bank, Stations, bounds
from imm_tdoa.models import FDOA, TDOA, ConstantVelocity, CoordinatedTurn, Position, Stack, Static

PATH = np.array([[3e3, 4e3], [3.1e3, 4e3], [3.2e3, 4e3]])
FIX = Position(10.0)
CV = ConstantVelocity(psd=1.0)
PAIR = Bank([Static(psd=1.0), CV])


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((CV, FIX, T3, PATH[:2]), r"trajectory: expected shape \(..., 3, c\)"),
        ((CV, FIX, T3, PATH[:, :1]), r"trajectory: expected 4 \(x, y, vx, vy\) or 2 \(x, y\) or 6"),
        ((CV, FIX, T3[::-1], PATH), "times: expected times that do not decrease"),
        ((CV, FIX, T3, PATH * np.nan), "trajectory: expected finite numbers"),
        ((CV, ConstantVelocity, T3, PATH), "measurement: no measurement model"),
        ((Static, FIX, T3, PATH), "models"),
        ((PAIR, FIX, T3, PATH), "modes: with 2 models, say which is in force"),
    ],
)
def test_refusals(arguments, match):
    with pytest.raises(ValueError, match=match):
        bounds.pcrlb(*arguments)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"modes": [0, 1]}, "modes: expected one for each of the 3 times, got 2"),
        ({"modes": "static"}, "modes: expected 3 indices or names, got 'static'"),
        (
            {"modes": [0, 1, 2]},
            r"modes: modes\[2\] is 2, expected an index below 2 or one of static",
        ),
        ({"modes": [0, "cv", 1]}, r"modes: modes\[1\] is 'cv'"),
        ({"modes": [0, True, 1]}, r"modes: modes\[1\] is True"),
        ({"covariance": np.eye(3)}, "covariance: expected 4 "),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance: expected a positive semi-definite"),
        ({"covariance": [[np.inf, 2.0], [2.0, 1.0]]}, "covariance: expected zeros beside an inf"),
        ({"covariance": [1.0, 2.0]}, r"covariance: expected shape \(..., c, c\)"),
        ({"covariance": "much"}, "covariance: expected numbers, got 'much'"),
        ({"present": np.ones((3, 2), int)}, "present: expected booleans, or values with NaN"),
        ({"present": np.ones((3, 3), bool)}, r"present: expected shape \(..., 3, 2\)"),
        ({"present": np.ones((4, 3, 2), bool), "n": 5}, "trajectory: batch axes"),
        ({"components": ("x", "x")}, "components: expected different names"),
        ({"components": ("x", "vx")}, "components: expected the position x, y among them"),
        ({"axis": 0}, "axis: expected some of the 0 batch axes of the trajectory, got 0"),
        ({"axis": (), "n": 5}, r"axis: expected some of the 1 batch axes of the trajectory"),
        ({"axis": 1.0, "n": 5}, r"axis: expected some of the 1 batch axes of the trajectory"),
        ({"pairs": np.zeros((3, 2, 2), int)}, "pairs: Position does not measure station pairs"),
    ],
)
def test_refused_options(options, match):
    given = {"modes": [0, 1, 1], **options}
    path = np.broadcast_to(PATH, (given.pop("n"), 3, 2)) if "n" in given else PATH
    with pytest.raises(ValueError, match=match):
        bounds.pcrlb(PAIR, FIX, T3, path, **given)


def test_components_that_are_needed():
    turn = CoordinatedTurn(psd=1.0)
    with pytest.raises(
        ValueError, match=r"coordinated-turn is not linear and needs .* lacking: vx"
    ):
        bounds.pcrlb(turn, FIX, T3, PATH)
    states = np.concatenate([PATH, np.tile([100.0, 0.0, 0.1], (3, 1))], axis=-1)
    assert bounds.pcrlb(turn, FIX, T3, states).components[-1] == "omega"
    shuffled = bounds.pcrlb(
        turn, FIX, T3, states[:, ::-1], components=("omega", "vy", "vx", "y", "x")
    )
    assert_allclose(shuffled.covariance, bounds.pcrlb(turn, FIX, T3, states).covariance)
    stations = Stations(SQUARE, velocities=np.zeros_like(SQUARE))
    fdoa = FDOA(stations, range_rate_sigma=0.1)
    with pytest.raises(ValueError, match="trajectory: velocities are measured, so vx, vy are need"):
        bounds.pcrlb(CV, Stack(TDOA(stations, toa_sigma=1e-8), fdoa), T3, PATH)


def test_an_average_over_jacobians_needs_process_noise():
    turn = CoordinatedTurn(psd=0.0)
    states = np.concatenate([PATH, np.tile([100.0, 0.0, 0.1], (3, 1))], axis=-1)
    states = np.stack([states, states + np.array([0, 0, 5.0, 0, 0.1])])
    with pytest.raises(ValueError, match="axis: the Jacobians of coordinated-turn vary"):
        bounds.pcrlb(turn, FIX, T3, states, axis=0)
    assert np.isfinite(bounds.pcrlb(turn, FIX, T3, states).covariance).all()
    times = np.stack([T3, 2 * T3])
    with pytest.raises(ValueError, match="times: expected the same along the axes"):
        bounds.pcrlb(CV, FIX, times, states[..., :4], axis=0)
