"""The state of a Gaussian sum between two scans."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa import mixture
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, Index
from imm_tdoa.mixture import Mixture
from imm_tdoa.statespace import StateSpace


@attrs.frozen(eq=False)
class SumState:
    """Weighted Gaussians at one time; made by `GaussianSum.start` and `GaussianSum.step`.

    Attributes
    ----------
    time : () or (...)
        Time, s.
    means : (..., N, n)
        Mean of each component; a slot of weight zero repeats the heaviest.
    covariances : (..., N, n, n)
        Covariance of each.
    log_weight : (..., N)
        Logs of the weights, -inf for an empty slot.
    log_likelihood : (...)
        Cumulative log-likelihood of all measurements taken in, in internal units.
    nis : (..., N)
        Normalised innovation squared of the last scan, against each component; NaN where the
        scan had no usable row, and for empty slots.
    nis_dof : (...)
        Degrees of freedom of `nis`: usable rows, less one per unknown shared offset.
    space : StateSpace
        What the components of a mean are.
    """

    time: Array
    means: Array
    covariances: Array
    log_weight: Array
    log_likelihood: Array
    nis: Array
    nis_dof: Index
    space: StateSpace

    __repr__ = brief

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components of `mean`."""
        return self.space.components

    @property
    def weight(self) -> Array:
        """Weights (..., N)."""
        return np.asarray(np.exp(self.log_weight))

    @property
    def mean(self) -> Array:
        """Mean (..., n) of the sum."""
        return mixture.moments(self.weight, self.means, self.covariances)[0]

    @property
    def covariance(self) -> Array:
        """Covariance (..., n, n) of the sum, spread of the components included."""
        return mixture.moments(self.weight, self.means, self.covariances)[1]


def padded(components: Mixture) -> Mixture:
    """Return the mixture with the heaviest repeated in empty slots: numbers that do no harm."""
    log_w, x, P = components
    empty = np.isneginf(log_w)
    top = np.argmax(log_w, axis=-1)[..., None]
    first = np.take_along_axis(x, top[..., None], axis=-2)
    spread = np.take_along_axis(P, top[..., None, None], axis=-3)
    x = np.where(empty[..., None], first, x)
    return Mixture(log_w, x, np.where(empty[..., None, None], spread, P))
