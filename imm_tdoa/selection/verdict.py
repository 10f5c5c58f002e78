"""The rule that turns figures into a decision, and the decision into words (ALGORITHMS §11).

Decide by posterior probability; veto by innovations; fall back to the IMM when in doubt:

1. A model whose innovations are larger than it allows is out, whatever its probability.
2. The most probable of the rest is the candidate. Its margin is the log of its posterior odds
   against the most probable of all other models, those that are out included.
3. A margin below the threshold, negative where a model that is out is more probable, decides
   nothing; nor does it where every model is out. The verdict then is ``"imm"``: keep all models
   and let the IMM weigh them from scan to scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.selection.evidence import strength

IMM = "imm"
NOTEWORTHY = 1e-3  # a p-value below it is not called consistent, though it vetoes nothing


class Ruling(NamedTuple):
    """What the rule says.

    Attributes
    ----------
    best : (...) int
        The candidate: the most probable model that is not rejected (of all where all are).
    runner_up : (...) int
        The most probable of the others; the candidate itself where there is no other.
    margin : (...)
        Log of the posterior odds of `best` against `runner_up`; inf where there is no other.
    decided : (...) bool
        Whether `best` is the verdict.
    """

    best: Index
    runner_up: Index
    margin: Array
    decided: Mask


def rule(log_probability: Array, rejected: Mask, threshold: float) -> Ruling:
    """Apply the rule to log posterior probabilities and vetoes (..., r)."""
    r = log_probability.shape[-1]
    none = np.asarray(rejected.all(axis=-1, keepdims=True))
    running = np.where(rejected & ~none, -np.inf, log_probability)
    best = np.argmax(running, axis=-1)
    own = best[..., None] == np.arange(r)
    other = np.where(own, -np.inf, np.maximum(log_probability, -1e300))
    runner_up = np.argmax(other, axis=-1)
    if r == 1:
        margin = np.full(best.shape, np.inf)
    else:
        pair = np.stack([best, runner_up], axis=-1)
        top, next_to = np.moveaxis(np.take_along_axis(log_probability, pair, axis=-1), -1, 0)
        impossible = np.isneginf(next_to)
        margin = np.where(impossible, np.inf, top - np.where(impossible, 0.0, next_to))
    return Ruling(best, runner_up, margin, (margin >= threshold) & ~none[..., 0])


def reason(
    names: Sequence[str],
    best: int,
    runner_up: int,
    margin: float,
    decided: bool,
    p: Sequence[float],
    ratio: Sequence[float],
    rejected: Sequence[bool],
    small: Sequence[bool],
    surprise: str = "",
) -> str:
    """Say in a sentence why one target's verdict is what it is.

    Sequences have one entry per model; `surprise` is what of `best` was not believed beforehand.
    """
    words = _reason(names, best, runner_up, margin, decided, p, ratio, rejected, small)
    return f"{words}; {surprise}" if surprise else words


def _reason(
    names: Sequence[str],
    best: int,
    runner_up: int,
    margin: float,
    decided: bool,
    p: Sequence[float],
    ratio: Sequence[float],
    rejected: Sequence[bool],
    small: Sequence[bool],
) -> str:
    name, other = names[best], names[runner_up]
    if np.isnan(ratio[best]) and not decided:
        return "there is no scan after the first fix to judge by"
    size = f"{ratio[best]:.3g} times their expected size, {_p(p[best])}"
    if all(rejected):
        return (
            f"no model foresees the data: even with {name}, the most probable, the squared "
            f"innovations are {size}; the motion changes, or more noise is there than declared"
            if len(names) > 1
            else f"{name} does not foresee the data: its squared innovations are {size}"
        )
    if small[best]:
        tail = f"though its squared innovations are only {size}: sigma may be declared too large"
    elif np.isnan(ratio[best]):
        tail = "though no innovation is there to test it by"
    elif p[best] < NOTEWORTHY:
        tail = f"and its squared innovations are nearly right, {size}"
    else:
        tail = f"and its innovations are consistent ({_p(p[best])})"
    if decided and len(names) == 1:
        return f"{name} is the only model compared, {tail}"
    word = str(strength(abs(margin)))
    if decided:
        return f"{name} explains the data best: {_nats(margin)} ahead of {other} ({word}), {tail}"
    if margin < 0.0 and rejected[runner_up]:
        return (
            f"the tests disagree: {other} is the most probable, {_nats(-margin)} ahead of {name}, "
            f"but its squared innovations are {ratio[runner_up]:.3g} times their expected size "
            f"({_p(p[runner_up])})"
        )
    return (
        f"{name} and {other} explain the data almost alike: {_nats(margin)} apart ({word}), too "
        f"little to decide"
    )


def _nats(margin: float) -> str:
    if not np.isfinite(margin):
        return "infinitely far"
    return f"{margin:.1f} nats" if margin < 1000.0 else f"{margin:,.0f} nats"


def _p(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6"
