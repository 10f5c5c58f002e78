"""An emitter that moves straight on, disturbed by random accelerations."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, LinearMotion, component_names
from imm_tdoa.models.motion._noise import (
    continuous,
    exactly_one,
    piecewise_constant,
    polynomial_transition,
)


@attrs.frozen
class ConstantVelocity(LinearMotion):
    """Constant velocity, CV: p' = p + v dt, v' = v, plus acceleration noise (ALGORITHMS §2).

    Parameters
    ----------
    psd : float, optional
        Density of continuous white acceleration, m²/s³. Composes over any time steps.
    std : float, optional
        Standard deviation of an acceleration held constant over each step, m/s².

    Notes
    -----
    Exactly one of the two. Components: ``x y [z] vx vy [vz]``. Per axis

        F = [1 dt; 0 1],   Q = psd [dt³/3 dt²/2; dt²/2 dt]   or   std² g g',  g = [dt²/2, dt].
    """

    psd: float | None = None
    std: float | None = None

    def __attrs_post_init__(self) -> None:
        exactly_one("ConstantVelocity", self.psd, self.std)

    @property
    def composes(self) -> bool:
        """Whether noise over two steps on end is that over one long step: only with `psd`."""
        return self.std is None

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the components of position and velocity."""
        return component_names(_validate.dimensions(dims), order=1)

    def transition(self, dt: float | Array, dims: int) -> Array:
        """Return F (..., 2d, 2d)."""
        return polynomial_transition(dt, dims, order=1)

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return Q (..., 2d, 2d); m², m²/s, m²/s² by blocks."""
        if self.psd is not None:
            return continuous(dt, dims, 1, self.psd)
        assert self.std is not None
        dt = _validate.time_step(dt)
        return piecewise_constant(dt, dims, np.stack([dt**2 / 2, dt], axis=-1), self.std)
