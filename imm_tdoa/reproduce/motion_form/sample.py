"""Position errors of many runs, and what is said of them."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.motion_form.scenario import KM


@attrs.frozen(eq=False)
class Sample:
    """Position errors of one estimator.

    Attributes
    ----------
    errors_km : (runs, 3, K)
        Distance from the truth of each run and target at the K epochs after the first, km.
    """

    errors_km: Array

    @classmethod
    def of(cls, positions: Array, truth: Array) -> Sample:
        """Compare positions (runs, 3, K + 1, 2) with the truth (3, K + 1, 6 or 2), m."""
        distance = np.linalg.norm(positions - truth[..., :2], axis=-1)
        return cls(distance[..., 1:] / KM)

    @property
    def each_run_km(self) -> Array:
        """Mean error (runs,) over targets and epochs, km."""
        result: Array = self.errors_km.mean(axis=(1, 2))
        return result

    @property
    def mean_km(self) -> float:
        """Mean error over runs, targets and epochs, km."""
        return float(self.errors_km.mean())

    @property
    def standard_error_km(self) -> float:
        """Standard error of `mean_km`, from the runs, km."""
        return _standard_error(self.each_run_km)

    @property
    def last_km(self) -> float:
        """Mean error at the last epoch, km."""
        return float(self.errors_km[..., -1].mean())

    @property
    def over_time_km(self) -> Array:
        """Mean error (K,) over runs and targets, km."""
        result: Array = self.errors_km.mean(axis=(0, 1))
        return result

    def ratio(self, other: Sample) -> tuple[float, float]:
        """Return mean error over `other`'s on the same noise, and its paired standard error."""
        ours, theirs = self.each_run_km, other.each_run_km
        ratio = float(ours.mean() / theirs.mean())
        return ratio, _standard_error(ours - ratio * theirs) / float(theirs.mean())


def _standard_error(values: Array) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values)))
