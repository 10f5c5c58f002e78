"""What the sequence filter made of measured time differences."""

from __future__ import annotations

import warnings
from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.scans import Scans

COLOURED = (
    "filtered time differences are coloured: errors of successive epochs are alike, and a moving "
    "target's lag. A tracker that takes them for fresh measurements is over-confident; give it "
    "the measured ones (ALGORITHMS §6.4)"
)
TEMPTING = ("values", "tdoa", "measurements")


@attrs.frozen(eq=False, repr=False)
class FilteredSequence:
    """Filtered time differences of adjacent stations and the positions from them.

    These are no measurements: their errors are correlated over time, and lag behind a target
    that moves (ALGORITHMS §6.4). Nothing here is called ``values``; ``scans`` warns.

    Attributes
    ----------
    times : (T,) or (..., T)
        Epochs, s.
    coloured_tdoa : (..., T, m)
        The differences that the positions were made of, s: filtered, or measured where the gate
        failed; where nothing was measured, the prediction. NaN before a sequence begins.
    variance : (..., T, m)
        What the scalar filters hold their own variance to be, s². It knows nothing of lag.
    gain : (..., T, m)
        Kalman gain; 1 where a sequence begins, 0 where nothing was measured.
    process_noise : (..., T, m)
        Q that the next prediction adds, s².
    gated : (..., T, m) bool
        Where the gate failed and the measured difference was taken instead.
    measured : (..., T, m) bool
        Where something was measured; only these rows enter the position.
    multiplier : (..., T)
        Factor on the process noise.
    position : (..., T, d)
        From the filtered differences, m; NaN where an epoch's rows determine none.
    covariance : (..., T, d, d)
        Of the position, m², from `variance` and the correlation of adjacent differences: right
        as far as the scalar filters' random walk is.
    raw_position : (..., T, d)
        From the measured differences of each epoch alone, m.
    """

    times: Array
    coloured_tdoa: Array
    variance: Array
    gain: Array
    process_noise: Array
    gated: Mask
    measured: Mask
    multiplier: Array
    position: Array
    covariance: Array
    raw_position: Array
    _measurement: MeasurementModel

    def __repr__(self) -> str:
        *batch, T, m = self.coloured_tdoa.shape
        runs = f"{'x'.join(str(n) for n in batch)} runs, " if batch else ""
        return (
            f"FilteredSequence({runs}{T} epochs, {m} differences; coloured, no measurements for "
            f"a tracker)"
        )

    def __getattr__(self, name: str) -> Any:
        if name in TEMPTING:
            raise AttributeError(
                f"FilteredSequence has no {name!r}: {COLOURED}. They are in coloured_tdoa"
            )
        raise AttributeError(f"'FilteredSequence' object has no attribute {name!r}")

    def scans(self) -> Scans:
        """Return the filtered differences as scans for a tracker, with a UserWarning.

        Their noise is that of the measured differences. Of an exponential smoother with gain K
        the variance K/(2-K) R and the correlation 1-K per epoch come to just that in the long
        run; the lag behind a moving target is in no covariance.
        """
        warnings.warn(COLOURED, UserWarning, stacklevel=2)
        values = np.where(self.measured, self.coloured_tdoa, np.nan)
        return Scans.checked(self._measurement, self.times, values)
