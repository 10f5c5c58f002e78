"""An emitter that nearly shares a coordinate with the reference receiver (trap T15)."""

from __future__ import annotations

from collections.abc import Mapping

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.receiver_errors.sample import Sample, samples
from imm_tdoa.reproduce.receiver_errors.scenario import POSITIONS, SOURCES, Case

VARIANCE = 1e-4  # sigma_d² and sigma_s², m²
AWAY = 10.0 ** np.arange(-3.0, 2.01, 1.0)
COMPARED = ("first-step", "squared", "error-correction", "joint")


@attrs.frozen(eq=False)
class Coordinate:
    """Estimators over the emitter's distance in x from the reference receiver.

    Attributes
    ----------
    away : (L,)
        x of the emitter less x of the reference, m; the rest of it is that of "near".
    bound : (L, 2)
        Cramér-Rao bound, m and m/s.
    samples : tuple of mappings
        The estimators at each distance.
    """

    away: Array
    bound: Array
    samples: tuple[Mapping[str, Sample], ...]

    def rmse(self, name: str) -> Array:
        """Return the root mean square errors (L, 2) of an estimator, m and m/s."""
        return np.array(
            [(s[name].position_rmse_m, s[name].velocity_rmse_mps) for s in self.samples]
        )

    def median(self, name: str) -> Array:
        """Return the median errors (L,) of the velocity of an estimator, m/s."""
        return np.array(
            [np.nanmedian(np.linalg.norm(s[name].velocity, axis=-1)) for s in self.samples]
        )


def shared_coordinate(runs: int = 500, seed: int = 1, away: Array = AWAY) -> Coordinate:
    """Let the near emitter come to the reference receiver's x.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of each distance.
    seed : int
        Seed of the noise, the same draws at every distance.
    away : (L,)
        Distances in x, m.
    """
    cases = [Case((POSITIONS[0, 0] + dx, *SOURCES["near"][1:]), VARIANCE, VARIANCE) for dx in away]
    found = [
        samples(case, case.measured(runs, np.random.default_rng([seed, 200])), which=COMPARED)[0]
        for case in cases
    ]
    return Coordinate(np.asarray(away), np.array([case.bound() for case in cases]), tuple(found))
