"""Five estimators on the same runs, and how far they were off."""

from __future__ import annotations

from typing import Any, get_args

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Mask
from imm_tdoa.locate import Fix, JointFix, joint, two_step
from imm_tdoa.locate.linear_steps import Weights
from imm_tdoa.reproduce.receiver_errors.scenario import POSITIONS, VELOCITY, Case, Measured

ESTIMATORS = ("first-step", "squared", "error-correction", "joint", "trusted")
_STEPS: dict[str, Any] = {
    "first-step": "none",
    "squared": "squared",
    "error-correction": "error-correction",
}


@attrs.frozen(eq=False)
class Sample:
    """Errors of an estimator over runs.

    Attributes
    ----------
    position, velocity : (N, 3)
        Estimate minus truth, m and m/s; NaN where none was found.
    converged : (N,) bool
        Which runs the estimator itself vouches for.
    """

    position: Array
    velocity: Array
    converged: Mask

    @property
    def position_rmse_m(self) -> float:
        """Root mean square error of the position, m."""
        return _rms(self.position)

    @property
    def velocity_rmse_mps(self) -> float:
        """Root mean square error of the velocity, m/s."""
        return _rms(self.velocity)

    @property
    def bias_m(self) -> float:
        """Length of the mean error of the position, m."""
        return float(np.linalg.norm(np.nanmean(self.position, axis=0)))

    @property
    def standard_error_m(self) -> float:
        """Standard error of `position_rmse_m`, m."""
        squares = np.sum(self.position**2, axis=-1)
        squares = squares[np.isfinite(squares)]
        spread = float(np.std(squares, ddof=1) / np.sqrt(len(squares)))
        return spread / (2.0 * self.position_rmse_m)

    @property
    def fallback_share(self) -> float:
        """Share of the runs that the estimator does not vouch for."""
        return float(1.0 - np.mean(self.converged))


def samples(
    case: Case, measured: Measured, weights: Weights = "both", which: Any = ESTIMATORS
) -> tuple[dict[str, Sample], float]:
    """Return the errors of each estimator, and the receivers' own after over before `joint`.

    "trusted" is least squares that takes the receivers to be where they say. The ratio is that
    of the root mean square errors of the receivers' positions; NaN without `joint`.
    """
    _validate.one_of("weights", weights, get_args(Weights))
    arguments: dict[str, Any] = {
        "range_rate": measured.range_rate,
        "time": measured.stations.times,
        **case.sigmas,
    }
    trusted = attrs.evolve(measured.stations, position_covariance=None)
    found, gain = {}, float("nan")
    for name in which:
        fix: Fix
        if name in _STEPS:
            step = _STEPS[name]
            fix = two_step(
                measured.stations,
                measured.tdoa,
                second_step=step,
                receiver_weights=weights,
                **arguments,
            )
        elif name == "joint":
            fix = joint(measured.stations, measured.tdoa, **arguments)
            gain = _gain(fix, measured)
        else:
            fix = joint(trusted, measured.tdoa, **arguments)
        assert fix.velocity is not None
        found[name] = Sample(fix.position - case.source, fix.velocity - VELOCITY, fix.converged)
    return found, gain


def _gain(fix: JointFix, measured: Measured) -> float:
    before = measured.stations.positions - POSITIONS
    return float(np.sqrt(np.sum((fix.stations - POSITIONS) ** 2) / np.sum(before**2)))


def _rms(error: Array) -> float:
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))
