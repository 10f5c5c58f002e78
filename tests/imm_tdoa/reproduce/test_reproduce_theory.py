"""Errors by theory against closed forms, and against the bounds, which come another way."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ellipe
from scipy.stats import rice

from imm_tdoa import bounds
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Position
from imm_tdoa.reproduce.motion_form import expected, scenario, theory
from imm_tdoa.reproduce.motion_form.switches import Switches


@pytest.mark.parametrize("short", [0.0, 0.03, 0.4, 1.0])
def test_mean_length_without_bias_is_the_elliptic_integral(short: float) -> None:
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    C = 9.0 * turn @ np.diag([1.0, short**2]) @ turn.T
    printed = np.sqrt(2.0 / np.pi) * 3.0 * ellipe(1.0 - short**2)
    assert_allclose(theory.mean_length(np.zeros(2), C), printed, rtol=3e-4)
    assert_allclose(theory.mean_length(np.zeros(2), C), bounds.mean_error(C), rtol=3e-4)


@pytest.mark.parametrize("bias", [0.0, 0.5, 2.0, 30.0])
def test_mean_length_with_bias_is_rices(bias: float) -> None:
    found = theory.mean_length(bias * np.array([0.6, -0.8]), 4.0 * np.eye(2))
    assert_allclose(found, rice.mean(bias / 2.0, scale=2.0), rtol=3e-4)


def test_mean_length_of_an_ellipse_with_bias_by_drawing() -> None:
    C, bias = np.array([[4.0, 1.5], [1.5, 1.0]]), np.array([1.0, -2.0])
    drawn = np.random.default_rng(3).multivariate_normal(bias, C, 400_000)
    length = np.linalg.norm(drawn, axis=-1)
    error = 4.0 * length.std() / np.sqrt(len(length))
    assert abs(float(theory.mean_length(bias, C)) - length.mean()) < error


@pytest.mark.parametrize(("model", "order"), [(ConstantVelocity, 1), (ConstantAcceleration, 2)])
def test_direct_fixes_give_polynomial_regression(model: type, order: int) -> None:
    """Variance ratios of the end point of a line and of a parabola through n fixes (§5.3)."""
    times, n = 2.0 * np.arange(21.0), np.arange(1.0, 22.0)
    prior = np.diag(np.repeat([1.0, *[1e8] * order], 2))
    C = theory.error_covariance(
        Position(sigma=1.0, dims=2),
        model(psd=0.0),
        times,
        np.zeros((21, 6)),
        noise=np.eye(2),
        spread=prior,
        prior=prior,
    )
    line = (4 * n - 2) / (n * (n + 1))
    parabola = 3 * (3 * n**2 - 3 * n + 2) / (n * (n + 1) * (n + 2))
    enough = slice(order, None)
    ratio = (line if order == 1 else parabola)[enough]
    assert_allclose(C[enough, 0, 0], ratio, rtol=2e-6)
    assert_allclose(C[enough, 1, 1], ratio, rtol=2e-6)


@pytest.mark.parametrize("noise", ["independent", "correlated"])
def test_a_filter_that_is_right_in_all_attains_the_bound(noise: str) -> None:
    """The posterior Cramér-Rao bound (another program) is this recursion with nothing wrong."""
    switches = Switches(noise=noise)  # type: ignore[arg-type]
    for model, motion in zip(scenario.MODELS, scenario.MOTIONS, strict=True):
        bound = expected.bound_of_filter(motion, switches)
        measurement, truth = scenario.measurement(switches), motion.truth()
        believed, actual = expected._fix_covariance(truth[:, 0], switches)
        assert_allclose(believed, actual, rtol=1e-9)
        _, P = expected.first_state(truth[:, 0, :2], believed, model)
        C = theory.error_covariance(
            measurement,
            scenario.motion_model(model),
            motion.times,
            truth,
            noise=scenario.true_noise(switches),
            spread=P,
            prior=P,
        )
        assert_allclose(bounds.mean_error(C)[:, 1:] / 1e3, bound, rtol=1e-6)


def test_the_deterministic_predictions_of_the_specification() -> None:
    """ALGORITHMS §5.3, last column, to its printed digits; §10 gives the same means."""
    switches = Switches()
    assert_allclose(expected.bound_of_fixes(scenario.STATIC, switches).mean(), 0.9886, atol=6e-5)
    printed = zip(scenario.MOTIONS, (0.3368, 0.6030, 0.7812), strict=True)
    for motion, value in printed:
        assert_allclose(expected.bound_of_filter(motion, switches).mean(), value, atol=6e-5)
