"""Spots: how far fixes of a target that stands scatter, and how far from it."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.sequence_filter import scenario
from imm_tdoa.sequence_filter import FilteredSequence


@attrs.frozen(eq=False)
class Spots:
    """The spot of each run before and after the filter, over the last epochs.

    Attributes
    ----------
    raw_radius_m, radius_m : (runs,)
        Rms distance of the fixes from their own middle.
    raw_error_m, error_m : (runs,)
        Rms distance of the fixes from the target.
    """

    raw_radius_m: Array
    radius_m: Array
    raw_error_m: Array
    error_m: Array

    @classmethod
    def of(cls, result: FilteredSequence, truth: Array) -> Spots:
        """Judge the runs (runs, T, d) of a target that stands at (T, d)."""
        last = slice(-scenario.LAST, None)
        raw, after, place = result.raw_position[:, last], result.position[:, last], truth[last]
        return cls(radius(raw), radius(after), _rms(raw - place), _rms(after - place))

    @property
    def shrink(self) -> float:
        """Median over runs of raw over filtered radius."""
        return float(np.median(self.raw_radius_m / self.radius_m))

    @property
    def gain(self) -> float:
        """Rms error of the raw fixes over that of the filtered, each over all runs."""
        return together(self.raw_error_m) / together(self.error_m)


def radius(position: Array) -> Array:
    """Return the rms distance (...) of positions (..., T, d) from their middle, m."""
    return _rms(position - position.mean(axis=-2, keepdims=True))


def together(rms: Array) -> float:
    """Return the rms over all runs of rms values (runs,) of runs of one length."""
    return float(np.sqrt(np.mean(rms**2)))


def _rms(error: Array) -> Array:
    square = np.einsum("...td,...td->...t", error, error)
    result: Array = np.sqrt(square.mean(axis=-1))
    return result
