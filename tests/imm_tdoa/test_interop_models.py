"""The models that come from filterpy's matrices obey the laws that they can obey."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from interop_cases import CA_NAMES, CV_NAMES, kalman
from numpy.testing import assert_array_equal

from imm_tdoa import IMM, Bank
from imm_tdoa.contract import LinearMotion
from imm_tdoa.interop import FixedStep, LinearMeasurement, from_filterpy
from imm_tdoa.models import Position
from imm_tdoa.testing import check_measurement_model, check_motion_model


@attrs.frozen(eq=False)
class AnyStep(LinearMotion):
    """A `FixedStep` that takes every step for its own, so that the laws can be tried on it."""

    model: FixedStep
    composes: bool = False

    def components(self, dims):
        return self.model.components(dims)

    def _step(self, dt):
        dt = np.asarray(dt, dtype=float)
        return np.where(dt > 0.0, self.model.dt, dt)

    def transition(self, dt, dims):
        return self.model.transition(self._step(dt), dims)

    def process_noise(self, dt, dims):
        return self.model.process_noise(self._step(dt), dims)

    def propagate(self, x, dt):
        return self.model.propagate(x, self._step(dt))

    def jacobian(self, x, dt):
        return self.model.jacobian(x, self._step(dt))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_fixed_step_obeys_the_laws_that_compare_no_steps(order):
    names = [("x", "y"), CV_NAMES, CA_NAMES][order]
    bank, _, _ = from_filterpy([kalman(1.0, order)], components=names, dt=0.5)
    check_motion_model(
        AnyStep(bank.models[0]), examples=15, without=["semigroup", "noise composes", "kinematics"]
    )


def test_a_linear_measurement_obeys_the_laws():
    measurement = LinearMeasurement([[1, 0, 0.5, 0], [0, 1, 0, 0], [0, 0, 1, 1]], np.eye(3) + 0.2)
    check_measurement_model(
        measurement,
        examples=15,
        without=["translation", "rotation", "units"],
        bad_arguments=[
            lambda: LinearMeasurement(np.eye(3), np.eye(3)),
            lambda: LinearMeasurement(np.eye(2), np.eye(3)),
            lambda: LinearMeasurement(np.eye(2), np.ones((2, 2))),
            lambda: LinearMeasurement(np.eye(2), np.zeros((2, 2))),
            lambda: LinearMeasurement(np.zeros((0, 2)), np.zeros((0, 0))),
            lambda: LinearMeasurement(np.eye(2), np.eye(2), dims=4),
        ],
    )


def test_a_fixed_step_refuses_other_steps():
    model = FixedStep(np.array([[1, 0.1], [0, 1]]), np.eye(2), ("x", "vx"), 0.1)
    stamps = 1.7e9 + 0.1 * np.arange(4)
    assert_array_equal(model.transition(np.diff(stamps), 1), np.tile(model.F, (3, 1, 1)))
    assert_array_equal(model.process_noise(0.0, 1), np.zeros((2, 2)))
    assert_array_equal(model.transition([0.0, 0.1], 1), [np.eye(2), model.F])
    for step in (0.2, 0.05, 0.1002):
        with pytest.raises(ValueError, match=r"dt: F and Q of this model hold for steps of 0.1 s"):
            model.transition(step, 1)
    imm = IMM(Bank([model]), Position(1.0, dims=1))
    with pytest.raises(ValueError, match=r"steps of 0.1 s \(or 0\), got 0.25 s"):
        imm.run([0.0, 0.1, 0.35], np.zeros((3, 1)), start=imm.start(0.0, [0.0], [[1.0]]))
    with pytest.raises(ValueError, match="dims: this model has 1 space dimensions, got 2"):
        model.components(2)
    with pytest.raises(ValueError, match="dims: expected 1, 2 or 3"):
        model.process_noise(0.1, 4)
    with pytest.raises(ValueError, match="x: expected 2 components"):
        model.propagate(np.zeros(3), 0.1)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"F": np.eye(3)}, "F: expected shape"),
        ({"Q": -np.eye(2)}, "Q: a variance on its diagonal is negative"),
        ({"names": ("x", "x")}, "names: expected different names"),
        ({"names": "xy"}, "names: expected component names"),
        ({"names": ("y", "vy")}, r"names: expected the position among them \(x; x and y"),
        ({"dt": 0.0}, "dt: expected a number above 0"),
    ],
)
def test_no_fixed_step(change, match):
    given = {"F": np.eye(2), "Q": np.eye(2), "names": ("x", "vx"), "dt": 1.0}
    with pytest.raises(ValueError, match=match):
        FixedStep(**{**given, **change})
