"""The table: five estimators at six points of geometry and noise (ALGORITHMS §8.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import attrs
import numpy as np

from imm_tdoa.locate.linear_steps import Weights
from imm_tdoa.reproduce.receiver_errors.sample import Sample, samples
from imm_tdoa.reproduce.receiver_errors.scenario import SOURCES, Case

# source, sigma_d², sigma_s², and what an independent program found in 400 runs: the bound's and
# the estimators' position errors, m; of velocity, m/s, where it is known too.
REFERENCE: tuple[tuple[str, float, float, Mapping[str, float], Mapping[str, float]], ...] = (
    (
        "near",
        1e-4,
        1e-4,
        {
            "bound": 0.0896,
            "first-step": 0.0951,
            "squared": 0.0913,
            "error-correction": 0.0911,
            "joint": 0.0911,
            "trusted": 0.169,
            "trusted-theory": 0.174,
        },
        {"bound": 0.0306},
    ),
    (
        "near",
        1e-4,
        1e-2,
        {
            "bound": 0.788,
            "first-step": 0.753,
            "squared": 0.757,
            "error-correction": 0.732,
            "joint": 0.733,
            "trusted": 1.69,
            "trusted-theory": 1.72,
        },
        {"bound": 0.234},
    ),
    (
        "mid",
        1e-4,
        1e-2,
        {
            "bound": 3.46,
            "first-step": 6.29,
            "squared": 3.36,
            "error-correction": 3.35,
            "joint": 3.34,
            "trusted": 14.6,
            "trusted-theory": 15.2,
        },
        {"bound": 1.18},
    ),
    (
        "far",
        1e-4,
        1e-4,
        {
            "bound": 12.5,
            "first-step": 16.3,
            "squared": 12.2,
            "error-correction": 12.2,
            "joint": 12.2,
            "trusted": 22.6,
            "trusted-theory": 22.9,
        },
        {"bound": 1.95},
    ),
    (
        "far",
        1e-4,
        1e-2,
        {
            "bound": 84.6,
            "first-step": 140.0,
            "squared": 88.1,
            "error-correction": 87.8,
            "joint": 87.7,
            "trusted": 216.0,
            "trusted-theory": 224.0,
        },
        {"bound": 4.96, "squared": 5.82, "error-correction": 5.46, "joint": 5.25},
    ),
    (
        "far",
        1.0,
        1e-4,
        {
            "bound": 475.0,
            "first-step": 610.0,
            "squared": 539.0,
            "error-correction": 482.0,
            "joint": 486.0,
        },
        {},
    ),
)
EFFICIENT_BELOW = 1.0  # sigma_d², m²; from here on the estimators have a bias


@attrs.frozen(eq=False)
class Point:
    """One row of the table.

    Attributes
    ----------
    source : str
        Which emitter.
    case : Case
        It and the sizes of the errors.
    bound, trusting : (float, float)
        Cramér-Rao bound, and theory's error of trusting the receivers, m and m/s.
    samples : mapping of str to Sample
        The estimators.
    receiver_gain : float
        Error of the receivers' positions after over before the joint estimation.
    reference_m, reference_mps : mapping of str to float
        What an independent program found.
    """

    source: str
    case: Case
    bound: tuple[float, float]
    trusting: tuple[float, float]
    samples: Mapping[str, Sample]
    receiver_gain: float
    reference_m: Mapping[str, float]
    reference_mps: Mapping[str, float]

    @property
    def efficient(self) -> bool:
        """Whether the noise is low or moderate: the bound is what one can expect."""
        return self.case.range_variance < EFFICIENT_BELOW


@attrs.frozen(eq=False)
class Table:
    """All points, the runs of each and the seed.

    Attributes
    ----------
    points : tuple of Point
        One per emitter and noise.
    runs, seed : int
        Of each point; the seed of the noise.
    weights : str
        What the weights of the two steps know of the receivers' errors.
    """

    points: tuple[Point, ...]
    runs: int
    seed: int
    weights: Weights


def table(
    runs: int = 2000,
    seed: int = 1,
    weights: Weights = "both",
    tell: Callable[[str], None] = lambda _: None,
) -> Table:
    """Compute the table.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of each point, at least 2.
    seed : int
        Seed of the noise.
    weights : "both", "first" or "none"
        Which steps' weights know of the receiver errors (D1 and D2, D1, neither).
    tell : callable
        Is told each point.

    Raises
    ------
    ValueError
        Too few runs.
    """
    if runs < 2:
        raise ValueError(f"runs: expected at least 2, got {runs}")
    points = []
    for i, (source, range_variance, receiver_variance, metres, rates) in enumerate(REFERENCE):
        tell(f"{source}, {range_variance:g}, {receiver_variance:g}")
        case = Case(SOURCES[source], range_variance, receiver_variance)
        measured = case.measured(runs, np.random.default_rng([seed, i]))
        found, gain = samples(case, measured, weights)
        points.append(
            Point(source, case, case.bound(), case.trusting(), found, gain, metres, rates)
        )
    return Table(tuple(points), runs, seed, weights)
