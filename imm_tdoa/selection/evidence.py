"""How strongly the data speak for one model against another: sums of log-likelihoods, and words."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import mixture
from imm_tdoa.contract import Array

WORDS = ("barely worth mentioning", "positive", "strong", "very strong")
STEPS = (2.0, 6.0, 10.0)  # of twice the difference of log-evidences (Kass & Raftery 1995; §11)


def cumulative(log_likelihood: Array) -> Array:
    """Return the log-evidence (..., T, r) after each scan from its increments (..., T, r).

    Increments that are NaN (a target that has not started) stay NaN and count as nothing.
    """
    total = np.cumsum(np.nan_to_num(log_likelihood), axis=-2)
    return np.where(np.isnan(log_likelihood), np.nan, total)


def windowed(log_likelihood: Array, width: int) -> Array:
    """Return the sum (..., T, r) of the last `width` increments at every scan."""
    total = np.cumsum(np.nan_to_num(log_likelihood), axis=-2)
    before = np.zeros_like(total)
    before[..., width:, :] = total[..., :-width, :]
    return np.where(np.isnan(log_likelihood), np.nan, total - before)


def posterior(log_evidence: Array, prior: Array) -> Array:
    """Return the log-probability (..., r) of each model, Pr(j | Z) in proportion to prior e^L."""
    with np.errstate(divide="ignore"):
        return mixture.normalise(log_evidence + np.log(prior))[0]


def strength(margin: Any) -> np.ndarray[Any, np.dtype[np.str_]]:
    """Return how strong evidence is, in the words of §11.

    Parameters
    ----------
    margin : (...)
        Log-odds, nats. Twice the margin above 2 is positive, above 6 strong, above 10 very strong.
    """
    return np.array(WORDS)[np.searchsorted(STEPS, 2.0 * np.asarray(margin, dtype=float))]
