"""Mixing and predicting the modes of a bank (ALGORITHMS §9.1 steps 1 to 3, §9.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imm_tdoa import gaussian, mixture
from imm_tdoa.contract import Array, MotionModel
from imm_tdoa.state import State
from imm_tdoa.statespace import apply_lift


def mix(
    state: State, chain: Array, mixing: str
) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
    """Mix the modes before prediction (§9.1 steps 1 and 2), states matched by component (§9.3).

    Parameters
    ----------
    state : State
        The modes after the last scan.
    chain : (..., r, r)
        Transition probabilities over the step; rows sum to one.
    mixing : "birth", "unbiased" or "zero"
        What fills the components a mode lacks.

    Returns
    -------
    means, covariances : tuple of (..., n_j), (..., n_j, n_j)
        Each mode's mixed initial condition.
    log_probability : (..., r)
        Predicted mode probabilities. A mode that cannot be reached keeps its own state and has
        probability zero.
    """
    r = len(state.modes)
    if r == 1:
        return state.means, state.covariances, state.log_mode_probability
    with np.errstate(divide="ignore"):
        log_joint = state.log_mode_probability[..., :, None] + np.log(chain)
    weights, log_c = mixture.normalise(np.swapaxes(log_joint, -1, -2))  # (..., target, source)
    reachable = np.isfinite(log_c)[..., None]
    weight = np.where(reachable, np.exp(weights), np.eye(r))
    means, covariances = [], []
    for j in range(r):
        fill = {
            "birth": None,
            "unbiased": (state.means[j], state.covariances[j]),
            "zero": (np.zeros_like(state.means[j]), np.zeros_like(state.covariances[j])),
        }[mixing]
        parts = [
            apply_lift(state.space.lifts[i][j], state.means[i], state.covariances[i], fill)
            for i in range(r)
        ]
        x, P = mixture.moments(
            weight[..., j, :],
            np.stack([x for x, _ in parts], axis=-2),
            np.stack([P for _, P in parts], axis=-3),
        )
        means.append(x)
        covariances.append(P)
    return tuple(means), tuple(covariances), log_c


def predict(
    models: Sequence[MotionModel],
    means: Sequence[Array],
    covariances: Sequence[Array],
    dt: Array,
    dims: int,
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Predict every mode by `dt` (...) with its own model (§9.1 step 3)."""
    x = tuple(model.propagate(mean, dt) for model, mean in zip(models, means, strict=True))
    P = tuple(
        gaussian.predict_covariance(cov, model.jacobian(mean, dt), model.process_noise(dt, dims))
        for model, mean, cov in zip(models, means, covariances, strict=True)
    )
    return x, P
