"""Every motion model that ships obeys every law of the kit."""

from __future__ import annotations

import pytest

from imm_tdoa import registry
from imm_tdoa.models import (
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Singer,
    Static,
)
from imm_tdoa.testing import check_motion_model, verdicts

CONTINUOUS = [
    Static(psd=2.0),
    ConstantVelocity(psd=0.3),
    ConstantAcceleration(psd=0.1),
    Singer(psd=0.2),
    CoordinatedTurn(psd=0.5),
]
PIECEWISE = [
    Static(std=2.0),
    ConstantVelocity(std=0.5),
    ConstantAcceleration(std=0.1),
    CoordinatedTurn(std=0.5, turn_rate_psd=0.0),
]
CORNERS = [
    Static(psd=0.0),
    ConstantVelocity(psd=0.0),
    ConstantAcceleration(psd=1e-9),
    Singer(std=3.0, time_constant=0.5),
    Singer(psd=1e4, time_constant=1e5),
    CoordinatedTurn(psd=0.0, turn_rate_psd=1.0),
]


@pytest.mark.parametrize("model", CONTINUOUS, ids=repr)
def test_continuous_noise(model):
    check_motion_model(model, examples=30)


@pytest.mark.parametrize("model", PIECEWISE, ids=repr)
def test_piecewise_constant_noise(model):
    check_motion_model(model, examples=12)
    exempt = {v.law for v in verdicts(model, examples=1) if v.outcome == "exempt"}
    assert exempt - {"linear"} == {"noise composes"}  # the only law that it may break (T23)


@pytest.mark.parametrize("model", CORNERS, ids=repr)
def test_corners(model):
    check_motion_model(model, examples=12)


def test_all_registered_motion_models_are_tried_here():
    tried = {registry.name_of(model) for model in CONTINUOUS}
    assert tried >= {"static", "constant-velocity", "constant-acceleration", "singer"}
    assert tried | {"coordinated-turn"} == set(registry.names("motion"))


@pytest.mark.parametrize("model", [*CONTINUOUS, *PIECEWISE], ids=repr)
def test_composes_tells_which_noise_does(model):
    assert getattr(model, "composes", True) == (model in CONTINUOUS)
