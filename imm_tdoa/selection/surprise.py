"""Does the most likely motion contradict what was believed of it beforehand?

A birth law that is too narrow spoils the evidence of every model that has the component: the
filter forgets the wrong belief only slowly, and its innovations are too large meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imm_tdoa.contract import KINDS, Array
from imm_tdoa.selection.best_fit import MaximumLikelihood
from imm_tdoa.statespace import KIND_OF, StateSpace

FAR = 4.0  # standard deviations from the belief that contradict it
UNITS = {"velocity": "m/s", "acceleration": "m/s²", "turn_rate": "rad/s"}


def surprising(
    fits: Sequence[MaximumLikelihood], space: StateSpace, birth_std: Mapping[str, float]
) -> np.ndarray[Any, np.dtype[np.str_]]:
    """Say for each target and model (..., r) what of its state is far from the birth law.

    Judged is the most likely initial state, which knows no belief, against the standard deviation
    of belief and estimate together. Empty where nothing is.
    """
    result = [
        _of_model(fit, components, birth_std)
        for fit, components in zip(fits, space.modes, strict=True)
    ]
    return np.stack(result, axis=-1)


def _of_model(
    fit: MaximumLikelihood, components: Sequence[str], birth_std: Mapping[str, float]
) -> np.ndarray[Any, np.dtype[np.str_]]:
    words = np.full(fit.converged.shape, "", dtype=object)
    for kind in (k for k in dict.fromkeys(KIND_OF.get(c, c) for c in components) if k != KINDS[0]):
        index = [i for i, c in enumerate(components) if KIND_OF.get(c, c) == kind]
        std = np.array([birth_std.get(components[i], birth_std.get(kind, np.inf)) for i in index])
        x, variance = fit.state[..., index], np.einsum("...ii->...i", fit.covariance)[..., index]
        with np.errstate(invalid="ignore"):
            away: Array = np.abs(x) / np.sqrt(std**2 + variance)
        worst = np.argmax(np.nan_to_num(away), axis=-1)
        for i in np.argwhere(np.max(np.nan_to_num(away), axis=-1) > FAR):
            t = tuple(i)
            value, belief = float(np.abs(x[t][worst[t]])), float(std[worst[t]])
            words[t] = words[t] or (
                f"its most likely {kind.replace('_', ' ')} is {_plain(value)} "
                f"{UNITS.get(kind, '')} where birth_std believes in {_plain(belief)}: a wider "
                f"birth law may change the verdict"
            )
    return words.astype(np.str_)


def _plain(value: float) -> str:
    return f"{float(f'{value:.3g}'):g}"
