"""What an IMM made of a recording."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

from imm_tdoa.contract import AXES, Array, Index, component_names
from imm_tdoa.state import State, combine
from imm_tdoa.statespace import StateSpace


@attrs.frozen(eq=False)
class Track:
    """Estimates over time; batch axes lead, time is next, components last.

    Attributes
    ----------
    times : (T,) or (..., T)
        Times of the rows, s.
    mean, covariance : (..., T, n), (..., T, n, n)
        Combined estimate of all `components`.
    mode_probability : (..., T, r)
        Probability of each of `modes`.
    log_likelihood : (..., T)
        Cumulative log-likelihood of the measurements taken in, internal units (metres).
    nis, nis_dof : (..., T)
        Normalised innovation squared of each scan and its degrees of freedom; NaN and 0 where
        nothing was taken in.
    mode_means, mode_covariances : tuple of (..., T, n_j), (..., T, n_j, n_j)
        Each mode's own estimate.
    modes : tuple of str
        Mode names.
    engine : str
        What computed it.

    In a batch the rows of a target that has not started yet are NaN.
    """

    times: Array
    mean: Array
    covariance: Array
    mode_probability: Array
    log_likelihood: Array
    nis: Array
    nis_dof: Index
    mode_means: tuple[Array, ...]
    mode_covariances: tuple[Array, ...]
    space: StateSpace
    modes: tuple[str, ...]
    engine: str = "numpy"

    @classmethod
    def from_states(cls, states: Sequence[State], times: Array) -> Track:
        """Stack the states of successive scans at `times` (T,) or (..., T)."""
        first = states[-1]
        batch = first.log_likelihood.shape

        def stacked(arrays: Sequence[Array], trailing: int) -> Array:
            shapes = [batch + a.shape[a.ndim - trailing :] for a in arrays]
            full = [np.broadcast_to(a, s) for a, s in zip(arrays, shapes, strict=True)]
            return np.stack(full, axis=len(batch))

        r = len(first.modes)
        means = tuple(stacked([s.means[j] for s in states], 1) for j in range(r))
        covariances = tuple(stacked([s.covariances[j] for s in states], 2) for j in range(r))
        probability = np.exp(stacked([s.log_mode_probability for s in states], 1))
        mean, covariance = combine(first.space, probability, means, covariances)
        return cls(
            times=times,
            mean=mean,
            covariance=covariance,
            mode_probability=probability,
            log_likelihood=stacked([s.log_likelihood for s in states], 0),
            nis=stacked([s.nis for s in states], 0),
            nis_dof=np.stack([np.broadcast_to(s.nis_dof, batch) for s in states], axis=-1),
            mode_means=means,
            mode_covariances=covariances,
            space=first.space,
            modes=first.modes,
        )

    def blanked(self, absent: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Track:
        """Return the track with NaN where `absent` (..., T)."""

        def blank(a: Array, trailing: int) -> Array:
            mask = absent.reshape(absent.shape + (1,) * trailing)
            result: Array = np.where(mask, np.nan, a)
            return result

        return attrs.evolve(
            self,
            mean=blank(self.mean, 1),
            covariance=blank(self.covariance, 2),
            mode_probability=blank(self.mode_probability, 1),
            log_likelihood=blank(self.log_likelihood, 0),
            nis=blank(self.nis, 0),
            mode_means=tuple(blank(x, 1) for x in self.mode_means),
            mode_covariances=tuple(blank(P, 2) for P in self.mode_covariances),
        )

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components of `mean`."""
        return self.space.components

    @property
    def position(self) -> Array:
        """Positions (..., T, d), m."""
        return self.mean[..., self._indices(AXES[: self.space.dims])]

    @property
    def position_covariance(self) -> Array:
        """Covariances of the position (..., T, d, d), m²."""
        i = self._indices(AXES[: self.space.dims])
        return self.covariance[..., i[:, None], i]

    @property
    def velocity(self) -> Array:
        """Velocities (..., T, d), m/s; zero where no mode has one."""
        d = self.space.dims
        names = component_names(d, 1)[d:]
        if names[0] not in self.components:
            return np.zeros_like(self.position)
        return self.mean[..., self._indices(names)]

    def _indices(self, names: Sequence[str]) -> Index:
        return np.array([self.components.index(name) for name in names], dtype=np.int64)
