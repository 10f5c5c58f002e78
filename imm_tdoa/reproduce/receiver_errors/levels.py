"""Errors against noise, beside the bound: in the manner of the literature's figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.locate.linear_steps import Weights
from imm_tdoa.reproduce.receiver_errors.sample import ESTIMATORS, Sample, samples
from imm_tdoa.reproduce.receiver_errors.scenario import SOURCES, Case

Varied = Literal["receivers", "measurement"]
LEVELS: dict[Varied, Array] = {
    "receivers": 10.0 ** np.arange(-5.5, 0.1, 0.5),
    "measurement": 10.0 ** np.arange(-5.0, 0.6, 0.5),
}
HELD = 1e-4  # the other variance, m²
DRAWN = ("near", "far")


@attrs.frozen(eq=False)
class Curve:
    """Estimators over noise levels at one emitter.

    Attributes
    ----------
    source : str
        Which emitter.
    varied : "receivers" or "measurement"
        What varies: sigma_s², with sigma_d² at 1e-4 m², or the other way about.
    levels : (L,)
        Variances, m².
    bound, trusting : (L, 2)
        Cramér-Rao bound, and theory's error of trusting the receivers, m and m/s.
    samples : tuple of mappings
        The estimators at each level.
    """

    source: str
    varied: Varied
    levels: Array
    bound: Array
    trusting: Array
    samples: tuple[Mapping[str, Sample], ...]

    def rmse(self, name: str) -> Array:
        """Return the root mean square errors (L, 2) of an estimator, m and m/s."""
        return np.array(
            [(s[name].position_rmse_m, s[name].velocity_rmse_mps) for s in self.samples]
        )


def sweep(
    runs: int = 200,
    seed: int = 1,
    weights: Weights = "both",
    tell: Callable[[str], None] = lambda _: None,
    levels: Mapping[Varied, Array] = LEVELS,
) -> tuple[Curve, ...]:
    """Compute the curves: near and far emitter, receiver errors and measurement noise varied.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of each level.
    seed : int
        Seed of the noise, the same draws at every level.
    weights : "both", "first" or "none"
        Which steps' weights know of the receiver errors.
    tell : callable
        Is told each curve.
    levels : mapping
        Variances to take, m².
    """
    curves = []
    for varied, variances in levels.items():
        for source in DRAWN:
            tell(f"{source} emitter, {varied}")
            cases = [
                Case(
                    SOURCES[source],
                    HELD if varied == "receivers" else float(variance),
                    float(variance) if varied == "receivers" else HELD,
                )
                for variance in variances
            ]
            found = []
            for case in cases:
                measured = case.measured(runs, np.random.default_rng([seed, 100]))
                found.append(samples(case, measured, weights, ESTIMATORS)[0])
            curves.append(
                Curve(
                    source,
                    varied,
                    np.asarray(variances),
                    np.array([case.bound() for case in cases]),
                    np.array([case.trusting() for case in cases]),
                    tuple(found),
                )
            )
    return tuple(curves)
