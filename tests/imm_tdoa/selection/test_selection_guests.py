"""Candidates and starts that come from elsewhere: filterpy's fixed steps, a batch of states."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imm_tdoa import IMM, Bank, selection
from imm_tdoa.interop import FixedStep
from imm_tdoa.models import ConstantVelocity, Position, Static

POSITION = Position(sigma=1.0, dims=2)
TIMES = np.arange(12.0)


def drifting(seed: int = 0):
    place = np.stack([3.0 * TIMES, -2.0 * TIMES], axis=-1)
    return place + np.random.default_rng(seed).normal(size=(12, 2))


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_model_of_one_fixed_step_competes(noise: float) -> None:
    """It answers for no other step, so its likelihood is stepped scan by scan."""
    model = ConstantVelocity(psd=noise)
    F, Q = model.transition(1.0, 2), model.process_noise(1.0, 2)
    fixed = FixedStep(F, Q, model.components(2), 1.0)
    found = selection.compare([fixed, Static(psd=0.0)], POSITION, TIMES, drifting())
    plain = selection.compare([model, Static(psd=0.0)], POSITION, TIMES, drifting())
    assert found.best == 0
    assert_allclose(found.log_evidence, plain.log_evidence, rtol=1e-9)
    assert_allclose(found.aic, plain.aic, rtol=1e-6)


def test_several_starts_on_the_same_scans() -> None:
    models = [Static(psd=0.0), ConstantVelocity(psd=0.0)]
    imm = IMM(Bank(models), POSITION)
    start = imm.start(-1.0, np.array([[-3.0, 2.0], [0.0, 0.0], [5.0, 5.0]]), 25.0 * np.eye(2))
    found = selection.compare(models, POSITION, TIMES, drifting(), start=start)
    assert found.log_evidence.shape == (3, 2)
    assert np.all(found.best == 1)
    assert_allclose(found.aic, np.broadcast_to(found.aic[0], (3, 2)), rtol=1e-6)
