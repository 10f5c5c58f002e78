"""Mean errors that the rows of Table 1 should have, from the geometry alone (ALGORITHMS §5.3)."""

from __future__ import annotations

import numpy as np

from imm_tdoa import bounds
from imm_tdoa.contract import Array
from imm_tdoa.reproduce.motion_form import faithful, scenario, theory
from imm_tdoa.reproduce.motion_form.scenario import KM, Motion
from imm_tdoa.reproduce.motion_form.switches import Switches
from imm_tdoa.reproduce.motion_form.tracking import first_state


def of_fixes(motion: Motion, switches: Switches) -> Array:
    """Mean errors (3, K) of fixes from each epoch alone, km."""
    _, actual = _fix_covariance(motion.truth()[:, 1:], switches)
    return bounds.mean_error(actual) / KM


def of_filter(model: str, motion: Motion, switches: Switches) -> Array:
    """Mean errors (3, K) of a filter: bias from a run without noise, spread by theory, km."""
    measurement, truth = scenario.measurement(switches), motion.truth()
    motion_model = scenario.motion_model(model, switches.process_noise)
    believed, actual = _fix_covariance(truth[:, 0], switches)
    x, P = first_state(truth[:, 0, :2], believed, model)
    spread = np.zeros_like(P)
    spread[..., :2, :2] = actual
    positions = faithful.extended_kalman(
        measurement,
        motion_model,
        motion.times,
        scenario.ideal(motion),
        x,
        P,
        columns=switches.jacobian,
    )
    covariance = theory.error_covariance(
        measurement,
        motion_model,
        motion.times,
        truth,
        noise=scenario.true_noise(switches),
        spread=spread,
        prior=P,
        columns=switches.jacobian,
    )
    return theory.mean_length(positions - truth[..., :2], covariance)[..., 1:] / KM


def bound_of_fixes(motion: Motion, switches: Switches) -> Array:
    """Mean errors (3, K) of fixes at the Cramér-Rao bound, km."""
    places = motion.truth()[:, 1:, :2]
    right = scenario.measurement(Switches(noise=switches.noise))
    information = bounds.fisher_information(right, places, np.zeros_like(places), 0.0)
    C = np.linalg.inv(information[..., :2, :2])
    return bounds.mean_error(C) / KM


def bound_of_filter(motion: Motion, switches: Switches) -> Array:
    """Mean errors (3, K) at the posterior Cramér-Rao bound, if told the motion, km."""
    right = Switches(noise=switches.noise)
    bank = scenario.all_models()
    bound = bounds.pcrlb(
        bank,
        scenario.measurement(right),
        motion.times,
        motion.truth(),
        modes=motion.modes(),
        components=bank.space(2).components,
    )
    return bound.position_mean[..., 1:] / KM


def _fix_covariance(truth: Array, switches: Switches) -> tuple[Array, Array]:
    """Covariance (..., 2, 2) of fixes at the truth as their R has it, and as it is, m²."""
    measurement, p = scenario.measurement(switches), truth[..., :2]
    H = faithful.jacobian(measurement, p, 0.0, 0.0, "zeros")
    R = measurement.noise_covariance(p, np.zeros_like(p), 0.0)
    G = np.swapaxes(np.linalg.solve(R, H), -1, -2)
    believed = np.asarray(np.linalg.inv(G @ H), dtype=float)
    K = believed @ G
    return believed, K @ scenario.true_noise(switches) @ np.swapaxes(K, -1, -2)
