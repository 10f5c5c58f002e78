"""Where an emitter may be after a first measurement, as weighted Gaussians."""

from __future__ import annotations

from typing import NamedTuple

from imm_tdoa.contract import Array


class Hypotheses(NamedTuple):
    """Places an emitter may be at; ``GaussianSum.start(time, *hypotheses)`` begins from them.

    Attributes
    ----------
    means : (..., N, d)
        Positions, m.
    covariances : (..., N, d, d)
        Their covariances, m².
    weights : (..., N)
        Weights, sum one; zero is an empty slot.
    """

    means: Array
    covariances: Array
    weights: Array
