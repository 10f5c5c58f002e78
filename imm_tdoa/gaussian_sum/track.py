"""What a Gaussian sum makes of a recording, and which of its estimates to report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, mixture
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, Index
from imm_tdoa.gaussian_sum.state import SumState
from imm_tdoa.readout import Readout, over_time
from imm_tdoa.statespace import StateSpace


@attrs.frozen(eq=False)
class SumTrack(Readout):
    """The Gaussian sum after every scan.

    Attributes
    ----------
    times : (T,) or (..., T)
        Times of the scans, s.
    mean, covariance : (..., T, n), (..., T, n, n)
        Moments of the sum, spread of the components included.
    log_weight : (..., T, N)
        Logs of the weights; -inf for a slot that is empty, merged into another or dropped.
    means, covariances : (..., T, N, n), (..., T, N, n, n)
        The components; an empty slot repeats the heaviest.
    log_likelihood : (..., T)
        Cumulative log-likelihood, in internal units.
    nis : (..., T, N)
        Normalised innovation squared against each component, before it was merged.
    nis_dof : (..., T)
        Its degrees of freedom.
    space : StateSpace
        What the components of a mean are.
    """

    times: Array
    mean: Array
    covariance: Array
    log_weight: Array
    means: Array
    covariances: Array
    log_likelihood: Array
    nis: Array
    nis_dof: Index
    space: StateSpace

    __repr__ = brief

    @classmethod
    def from_states(cls, states: Sequence[SumState], times: Array) -> SumTrack:
        """Stack the states of successive scans.

        Parameters
        ----------
        states : sequence of SumState
            T of them, in order.
        times : (T,) or (..., T)
            Their times, s.
        """
        batch = states[-1].log_likelihood.shape

        def stacked(arrays: Sequence[Any], trailing: int) -> Any:
            return over_time(arrays, batch, trailing)

        log_weight = stacked([s.log_weight for s in states], 1)
        means = stacked([s.means for s in states], 2)
        covariances = stacked([s.covariances for s in states], 3)
        mean, covariance = mixture.moments(np.exp(log_weight), means, covariances)
        return cls(
            times=times,
            mean=mean,
            covariance=covariance,
            log_weight=log_weight,
            means=means,
            covariances=covariances,
            log_likelihood=stacked([s.log_likelihood for s in states], 0),
            nis=stacked([s.nis for s in states], 1),
            nis_dof=stacked([s.nis_dof for s in states], 0),
            space=states[-1].space,
        )

    @property
    def weight(self) -> Array:
        """Weights (..., T, N)."""
        return np.asarray(np.exp(self.log_weight))


def settled(position: Any, origin: Any) -> Index:
    """Return the scan (...) whose estimate Source C reports: where the range has settled.

    The range of successive estimates from `origin` changes least there (ALGORITHMS §7.1-7). The
    rule looks back over the whole run, and a change can be small by chance: compare filters by
    their error over time, not by the error at this scan.

    Parameters
    ----------
    position : (..., T, d)
        Estimates, m, T at least 2.
    origin : (d,) or (T, d)
        Where ranges count from, m: one place, or the observer at each scan.

    Raises
    ------
    ValueError
        Shapes that do not fit, or fewer than two estimates.
    """
    p = _validate.array("position", position, (None, "T", "d"))
    T, d = p.shape[-2:]
    if T < 2:
        raise ValueError(f"position: expected two or more estimates, got {T}")
    shape = (T, d) if np.ndim(origin) == 2 else (d,)
    o = _validate.array("origin", origin, shape)
    r = np.linalg.norm(p - o, axis=-1)
    return np.asarray(np.argmin(np.abs(np.diff(r, axis=-1)), axis=-1) + 1, dtype=np.int64)
