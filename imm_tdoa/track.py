"""What an IMM made of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal

import attrs
import numpy as np

from imm_tdoa._brief import brief
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.readout import Readout, over_time
from imm_tdoa.state import State, combine
from imm_tdoa.statespace import StateSpace


@attrs.frozen(eq=False)
class Track(Readout):
    """Estimates over time; batch axes lead, time is next, components last.

    Attributes
    ----------
    times : (T,) or (..., T)
        Times of the rows, s.
    log_mode_probability : (..., T, r)
        Log-probability of each of `modes`; `mode_probability` has the probabilities.
    log_likelihood : (..., T)
        Cumulative log-likelihood of the measurements taken in, internal units (metres).
    nis, nis_dof : (..., T)
        Normalised innovation squared of each scan and its degrees of freedom; NaN and 0 where
        nothing was taken in.
    mode_log_likelihood, mode_nis : (..., T, r)
        Log-likelihood of each scan under each mode, and its normalised innovation squared
        against the mode's own prediction; 0 and NaN where nothing was taken in.
    mode_means, mode_covariances : tuple of (..., T, n_j), (..., T, n_j, n_j)
        Each mode's own estimate.
    row_weight : (..., T, m)
        Share of its information that each row kept: 1, less where a robust filter trusted it
        less, 0 where the gate left it out; NaN is missing.
    lost : (..., T)
        Whether so many scans were rejected on end that the track does not know where it is.
    reopened : (..., T)
        Whether the track was widened there because it was lost.
    bank : Bank
        The bank that made it.
    space : StateSpace
        What the components of `mean` are, and how those of the modes fit into them.
    modes : tuple of str
        Mode names.
    update : str
        How the modes took in measurements.
    smoothed : bool
        Whether each row knows of later scans (`smooth`).
    engine : str
        What computed it: ``"numpy"`` or ``"compiled"``.
    keep : str
        Which scans it has rows of: ``"all"``, ``"final"``, ``"every k"``.

    In a batch the rows of a target that has not started yet are NaN.
    """

    times: Array
    log_mode_probability: Array
    log_likelihood: Array
    nis: Array
    nis_dof: Index
    mode_log_likelihood: Array
    mode_nis: Array
    mode_means: tuple[Array, ...]
    mode_covariances: tuple[Array, ...]
    row_weight: Array
    lost: Mask
    reopened: Mask
    bank: Bank
    space: StateSpace
    modes: tuple[str, ...]
    update: str = "ekf"
    smoothed: bool = False
    engine: str = "numpy"
    keep: str = "all"

    __repr__ = brief

    @classmethod
    def from_states(
        cls,
        states: Sequence[State],
        times: Array,
        *,
        bank: Bank,
        update: str = "ekf",
        keep: str = "all",
    ) -> Track:
        """Stack the states of successive scans.

        Parameters
        ----------
        states : sequence of State
            T of them, in order.
        times : (T,) or (..., T)
            Their times, s.
        bank, update, keep
            What the track says of how it was made; see `Track`.
        """
        last = states[-1]
        batch = last.log_likelihood.shape

        def stacked(arrays: Sequence[Any], trailing: int) -> Any:
            return over_time(arrays, batch, trailing)

        r = len(last.modes)
        means = tuple(stacked([s.means[j] for s in states], 1) for j in range(r))
        covariances = tuple(stacked([s.covariances[j] for s in states], 2) for j in range(r))
        log_probability = stacked([s.log_mode_probability for s in states], 1)
        taken = [s.taken for s in states]
        return cls(
            times=times,
            log_mode_probability=log_probability,
            log_likelihood=stacked([s.log_likelihood for s in states], 0),
            nis=stacked([t.nis for t in taken], 0),
            nis_dof=stacked([t.nis_dof for t in taken], 0),
            mode_log_likelihood=stacked([t.mode_log_likelihood for t in taken], 1),
            mode_nis=stacked([t.mode_nis for t in taken], 1),
            mode_means=means,
            mode_covariances=covariances,
            row_weight=stacked([t.row_weight for t in taken], 1),
            lost=stacked([s.trust.lost for s in states], 0),
            reopened=stacked([t.reopened for t in taken], 0),
            bank=bank,
            space=last.space,
            modes=last.modes,
            update=update,
            keep=keep,
        )

    def smooth(self, method: Literal["pairwise", "kim"] = "pairwise") -> Track:
        """Return the track with every row estimated from all scans, later ones included (§9.5).

        Parameters
        ----------
        method : "pairwise" or "kim"
            As for `imm_tdoa.smoothing.smooth`, which does it and says more.
        """
        from imm_tdoa.smoothing import smooth

        return smooth(self, method)

    def blanked(self, absent: Mask) -> Track:
        """Return the track with NaN where a target is absent.

        Parameters
        ----------
        absent : (..., T) bool
            The rows to blank.
        """

        def blank(a: Array, trailing: int) -> Array:
            mask = absent.reshape(absent.shape + (1,) * trailing)
            result: Array = np.where(mask, np.nan, a)
            return result

        return attrs.evolve(
            self,
            log_mode_probability=blank(self.log_mode_probability, 1),
            log_likelihood=blank(self.log_likelihood, 0),
            nis=blank(self.nis, 0),
            mode_log_likelihood=blank(self.mode_log_likelihood, 1),
            mode_nis=blank(self.mode_nis, 1),
            row_weight=blank(self.row_weight, 1),
            mode_means=tuple(blank(x, 1) for x in self.mode_means),
            mode_covariances=tuple(blank(P, 2) for P in self.mode_covariances),
        )

    @cached_property
    def _combined(self) -> tuple[Array, Array]:
        return combine(self.space, self.mode_probability, self.mode_means, self.mode_covariances)

    @property
    def mean(self) -> Array:
        """Combined estimate (..., T, n) of all `components`."""
        return self._combined[0]

    @property
    def covariance(self) -> Array:
        """Combined covariance (..., T, n, n), spread between the modes included."""
        return self._combined[1]

    @property
    def mode_probability(self) -> Array:
        """Probability (..., T, r) of each of `modes`."""
        result: Array = np.exp(self.log_mode_probability)
        return result
