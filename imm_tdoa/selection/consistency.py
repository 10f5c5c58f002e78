"""Does a model foresee the data as well as it says it does? (ALGORITHMS §11, NIS consistency)"""

from __future__ import annotations

import attrs
import numpy as np
from scipy.special import chdtr, chdtrc

from imm_tdoa.contract import Array, Index, Mask


@attrs.frozen(eq=False)
class Consistency:
    """Normalised innovations squared of each model, summed, against their chi-square law.

    Attributes
    ----------
    total : (..., r)
        Sum over the scans judged.
    dof : (...) int
        Its degrees of freedom: scalar rows, shared offsets eliminated.
    significance : float
        Probability of rejecting a model that is right.
    tolerance : float
        Share by which the sum may miss its expectation, significant or not: sigma is never known
        exactly, and over thousands of scans any error of it is significant.
    """

    total: Array
    dof: Index
    significance: float
    tolerance: float

    @property
    def ratio(self) -> Array:
        """Sum over its expectation (..., r): 1 is ideal; NaN where nothing was judged."""
        dof = np.where(self.dof > 0, self.dof, 1)[..., None]
        return np.where(self.dof[..., None] > 0, self.total / dof, np.nan)

    @property
    def p(self) -> Array:
        """Two-sided p-value (..., r): how likely a right model misses the expectation as far."""
        low, high = self._tails()
        return np.where(np.isnan(self.ratio), np.nan, np.minimum(2.0 * np.minimum(low, high), 1.0))

    @property
    def rejected(self) -> Mask:
        """Whether a model's innovations are too large (..., r) to be its own: the veto.

        Innovations that are too large say that the emitter does what the model cannot. Those that
        are too small say only that sigma or process noise are declared larger than they are,
        which makes no other model better: `small` tells, and nothing is vetoed.
        """
        _, high = self._tails()
        with np.errstate(invalid="ignore"):
            result: Mask = (high < self.significance) & (self.ratio > 1.0 + self.tolerance)
        return result

    @property
    def small(self) -> Mask:
        """Whether a model's innovations are too small (..., r): it expects more noise than is."""
        low, _ = self._tails()
        with np.errstate(invalid="ignore"):
            result: Mask = (low < self.significance) & (self.ratio < 1.0 / (1.0 + self.tolerance))
        return result

    def _tails(self) -> tuple[Array, Array]:
        dof = np.maximum(self.dof, 1)[..., None].astype(float)
        return chdtr(dof, self.total), chdtrc(dof, self.total)


def consistency(nis: Array, dof: Index, significance: float, tolerance: float) -> Consistency:
    """Sum the innovations squared `nis` (..., T, r) of scans of `dof` (..., T) each."""
    heard = np.asarray(np.isfinite(nis).all(axis=-1))
    return Consistency(
        total=np.sum(np.where(heard[..., None], nis, 0.0), axis=-2),
        dof=np.sum(np.where(heard, dof, 0), axis=-1),
        significance=significance,
        tolerance=tolerance,
    )
