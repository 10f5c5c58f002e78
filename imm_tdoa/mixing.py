"""What the modes of a bank know of each other before a scan, and after it (ALGORITHMS §9).

How hypotheses about the past are merged tells the multiple-model filters apart:

* ``"imm"``: mixed before prediction, one Gaussian per mode (§9.1);
* ``"gpb1"``: all merged into one Gaussian, from which every mode begins (§9.4);
* ``"gpb2"``: one Gaussian per pair of modes, merged after the update (§9.4);
* ``"autonomous"``: nothing is merged, no mode switches: models in parallel, whose probabilities
  are those of the models.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import attrs
import numpy as np

from imm_tdoa import mixture
from imm_tdoa.contract import Array, Mask
from imm_tdoa.state import State
from imm_tdoa.statespace import apply_lift

Merging = Literal["imm", "gpb1", "gpb2", "autonomous"]
MERGING: tuple[str, ...] = get_args(Merging)


@attrs.frozen(eq=False)
class Hypotheses:
    """Gaussians that await a scan.

    Attributes
    ----------
    mode : tuple of int
        Whose model each hypothesis follows.
    means, covariances : tuple of (..., n), (..., n, n)
        Each hypothesis in its mode's components.
    log_weight : (..., N)
        Log-probabilities.
    """

    mode: tuple[int, ...]
    means: tuple[Array, ...]
    covariances: tuple[Array, ...]
    log_weight: Array


def hypotheses(
    state: State, chain: Array, moved: Mask, mixing: str, merging: Merging
) -> Hypotheses:
    """Return what the scan will be compared with, before prediction.

    Parameters
    ----------
    state : State
        The modes after the last scan.
    chain : (..., r, r)
        Transition probabilities over the step; rows sum to one.
    moved : (...)
        Where time has passed; elsewhere nothing is merged, whatever the strategy.
    mixing : "birth", "unbiased" or "zero"
        What fills the components a mode lacks.
    merging : "imm", "gpb1", "gpb2" or "autonomous"
        The strategy.
    """
    r = len(state.modes)
    every = tuple(range(r))
    if merging == "autonomous" or r == 1:
        return Hypotheses(every, state.means, state.covariances, state.log_mode_probability)
    if merging == "gpb2":
        return _pairs(state, chain, mixing)
    alike = moved if merging == "gpb1" else None
    return Hypotheses(every, *mix(state, chain, mixing, alike))


def merge(
    hypotheses: Hypotheses, means: Sequence[Array], covariances: Sequence[Array], log_joint: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
    """Return one Gaussian per mode and its log-weight (..., r), not normalised.

    A mode of no weight keeps its first hypothesis.

    Parameters
    ----------
    hypotheses : Hypotheses
        Whose model each follows.
    means, covariances : sequence of (..., n), (..., n, n)
        Each after the scan.
    log_joint : (..., N)
        Log of each one's probability times the scan's likelihood.
    """
    r = max(hypotheses.mode) + 1
    if len(hypotheses.mode) == r:
        return tuple(means), tuple(covariances), log_joint
    xs, Ps, logs = [], [], []
    for j in range(r):
        own = [h for h, mode in enumerate(hypotheses.mode) if mode == j]
        share, total = mixture.normalise(log_joint[..., own])
        weight = np.where(np.isfinite(total)[..., None], np.exp(share), np.arange(len(own)) == 0)
        x, P = mixture.moments(
            weight,
            np.stack([means[h] for h in own], axis=-2),
            np.stack([covariances[h] for h in own], axis=-3),
        )
        xs.append(x)
        Ps.append(P)
        logs.append(total)
    return tuple(xs), tuple(Ps), np.stack(logs, axis=-1)


def mix(
    state: State, chain: Array, mixing: str, alike: Mask | None = None
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
    alike : (...), optional
        Where every mode gets the same mixture of all modes, by their probabilities (GPB1).

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
    if alike is not None:
        now = np.exp(state.log_mode_probability)[..., None, :]
        weight = np.where(np.asarray(alike)[..., None, None], now, weight)
    means, covariances = [], []
    for j in range(r):
        parts = [_lifted(state, i, j, mixing) for i in range(r)]
        x, P = mixture.moments(
            weight[..., j, :],
            np.stack([x for x, _ in parts], axis=-2),
            np.stack([P for _, P in parts], axis=-3),
        )
        means.append(x)
        covariances.append(P)
    return tuple(means), tuple(covariances), log_c


def _pairs(state: State, chain: Array, mixing: str) -> Hypotheses:
    """Every mode before with every mode after; a mode's first pair is with itself."""
    r = len(state.modes)
    pairs = [(i, j) for j in range(r) for i in sorted(range(r), key=lambda i: i != j)]
    parts = [_lifted(state, i, j, mixing) for i, j in pairs]
    with np.errstate(divide="ignore"):
        log_joint = state.log_mode_probability[..., :, None] + np.log(chain)
    log_joint = np.broadcast_to(log_joint, (*log_joint.shape[:-2], r, r))
    return Hypotheses(
        mode=tuple(j for _, j in pairs),
        means=tuple(x for x, _ in parts),
        covariances=tuple(P for _, P in parts),
        log_weight=np.stack([log_joint[..., i, j] for i, j in pairs], axis=-1),
    )


def _lifted(state: State, i: int, j: int, mixing: str) -> tuple[Array, Array]:
    """Mode i's Gaussian in mode j's components."""
    fill = {
        "birth": None,
        "unbiased": (state.means[j], state.covariances[j]),
        "zero": (np.zeros_like(state.means[j]), np.zeros_like(state.covariances[j])),
    }[mixing]
    return apply_lift(state.space.lifts[i][j], state.means[i], state.covariances[i], fill)
