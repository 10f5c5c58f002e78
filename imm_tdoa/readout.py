"""What every track has: positions and velocities, read off its estimates by component name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imm_tdoa.contract import AXES, Array, Index, component_names
from imm_tdoa.statespace import StateSpace


class Readout:
    """Positions and velocities of estimates over time; a subclass has what they are read off."""

    __slots__ = ()

    @property
    def mean(self) -> Array:
        """Combined estimate (..., T, n) of all `components`."""
        raise NotImplementedError

    @property
    def covariance(self) -> Array:
        """Combined covariance (..., T, n, n)."""
        raise NotImplementedError

    @property
    def space(self) -> StateSpace:
        """What the components of `mean` are."""
        raise NotImplementedError

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
        """Velocities (..., T, d), m/s; zero where no motion model has one."""
        d = self.space.dims
        names = component_names(d, 1)[d:]
        if names[0] not in self.components:
            return np.zeros_like(self.position)
        return self.mean[..., self._indices(names)]

    def _indices(self, names: Sequence[str]) -> Index:
        return np.array([self.components.index(name) for name in names], dtype=np.int64)


def over_time(arrays: Sequence[Any], batch: tuple[int, ...], trailing: int) -> Any:
    """Return what successive states hold as one array with a time axis.

    Parameters
    ----------
    arrays : sequence of (..., own axes)
        One per scan.
    batch : tuple of int
        The batch axes, to which all are broadcast; time comes after them.
    trailing : int
        How many axes are an array's own.
    """
    shapes = [batch + a.shape[a.ndim - trailing :] for a in arrays]
    full = [np.broadcast_to(a, s) for a, s in zip(arrays, shapes, strict=True)]
    return np.stack(full, axis=len(batch))
