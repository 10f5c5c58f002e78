"""The state of an IMM between two scans."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

from imm_tdoa import mixture
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.reopening import Trust
from imm_tdoa.statespace import StateSpace, apply_lift


@attrs.frozen(eq=False)
class Taken:
    """What the last scan said, and how it was read.

    Attributes
    ----------
    nis : (...)
        Normalised innovation squared against the whole bank's prediction; NaN where the scan had
        no usable row.
    nis_dof : (...)
        Degrees of freedom of `nis`: usable rows, less one per unknown shared offset.
    mode_log_likelihood : (..., r)
        Log-likelihood of the scan under each mode; 0 where there was nothing to take in.
    mode_nis : (..., r)
        Normalised innovation squared against each mode's own prediction.
    row_weight : (..., m)
        Share of its information that each row kept: 0 where the gate left it out; NaN missing.
    reopened : (...)
        Whether the prediction was widened because the track had rejected scans for too long.
    """

    nis: Array
    nis_dof: Index
    mode_log_likelihood: Array
    mode_nis: Array
    row_weight: Array
    reopened: Mask

    __repr__ = brief

    @classmethod
    def nothing(cls, batch: tuple[int, ...], modes: int, rows: int) -> Taken:
        """No scan."""
        return cls(
            nis=np.full(batch, np.nan),
            nis_dof=np.zeros(batch, dtype=np.int64),
            mode_log_likelihood=np.zeros((*batch, modes)),
            mode_nis=np.full((*batch, modes), np.nan),
            row_weight=np.full((*batch, rows), np.nan),
            reopened=np.zeros(batch, dtype=bool),
        )


@attrs.frozen(eq=False)
class State:
    """Every mode's Gaussian with its probability; made by `IMM.start` and `IMM.step`.

    Attributes
    ----------
    time : () or (...)
        Time, s.
    means : tuple of (..., n_j)
        Each mode's mean in its own components (``space.modes[j]``).
    covariances : tuple of (..., n_j, n_j)
        Each mode's covariance.
    log_mode_probability : (..., r)
        Logs of the mode probabilities; -inf is legal.
    log_likelihood : (...)
        Cumulative log-likelihood of all measurements taken in, in internal units (metres).
    taken : Taken
        What the last scan said.
    trust : Trust
        Whether the track is lost; only robust filters reject scans.
    space : StateSpace
        How the modes' components fit together.
    modes : tuple of str
        Mode names.
    """

    time: Array
    means: tuple[Array, ...]
    covariances: tuple[Array, ...]
    log_mode_probability: Array
    log_likelihood: Array
    taken: Taken
    trust: Trust
    space: StateSpace
    modes: tuple[str, ...]

    __repr__ = brief

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components of `mean`."""
        return self.space.components

    @property
    def nis(self) -> Array:
        """Normalised innovation squared (...) of the last scan; see `Taken`."""
        return self.taken.nis

    @property
    def nis_dof(self) -> Index:
        """Degrees of freedom (...) of `nis`."""
        return self.taken.nis_dof

    @property
    def mode_probability(self) -> Array:
        """Mode probabilities (..., r)."""
        result: Array = np.exp(self.log_mode_probability)
        return result

    @property
    def mean(self) -> Array:
        """Combined mean (..., n) of all components."""
        return combine(self.space, self.mode_probability, self.means, self.covariances)[0]

    @property
    def covariance(self) -> Array:
        """Combined covariance (..., n, n), spread between the modes included."""
        return combine(self.space, self.mode_probability, self.means, self.covariances)[1]


def combine(
    space: StateSpace, probability: Array, means: Sequence[Array], covariances: Sequence[Array]
) -> tuple[Array, Array]:
    """Moment-match the modes on the union of their components (§9.1 step 5).

    For output only: a mode without a component says that it is zero (a static emitter has no
    velocity), so it is lifted with zeros, whatever the bank's mixing rule.

    Parameters
    ----------
    space : StateSpace
        How the modes' components fit together.
    probability : (..., r)
        Mode probabilities.
    means, covariances : sequence of (..., n_j), (..., n_j, n_j)
        Each mode's own estimate.

    Returns
    -------
    (..., n), (..., n, n)
        Mean and covariance, spread between the modes included.
    """
    n = len(space.components)
    zero = np.zeros(n), np.zeros((n, n))
    parts = [
        apply_lift(lift, x, P, zero)
        for lift, x, P in zip(space.to_union, means, covariances, strict=True)
    ]
    return mixture.moments(
        probability,
        np.stack([x for x, _ in parts], axis=-2),
        np.stack([P for _, P in parts], axis=-3),
    )
