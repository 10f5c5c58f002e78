"""An emitter under constant acceleration, itself disturbed at random."""

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
class ConstantAcceleration(LinearMotion):
    """Constant acceleration, CA: p' = p + v dt + a dt²/2, v' = v + a dt, a' = a (ALGORITHMS §2).

    Parameters
    ----------
    psd : float, optional
        Density of continuous white jerk, m²/s⁵. Composes over any time steps.
    std : float, optional
        Standard deviation of the acceleration's step per scan, m/s², held over the scan.

    Notes
    -----
    Exactly one of the two. Components: ``x y [z] vx vy [vz] ax ay [az]``. Per axis

        F = [1 dt dt²/2; 0 1 dt; 0 0 1],
        Q = psd [dt⁵/20 dt⁴/8 dt³/6; dt⁴/8 dt³/3 dt²/2; dt³/6 dt²/2 dt]
        or std² g g', g = [dt²/2, dt, 1] for dt > 0.
    """

    psd: float | None = None
    std: float | None = None

    def __attrs_post_init__(self) -> None:
        exactly_one("ConstantAcceleration", self.psd, self.std)

    @property
    def composes(self) -> bool:
        """Whether noise over two steps on end is that over one long step: only with `psd`."""
        return self.std is None

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the components of position, velocity and acceleration."""
        return component_names(_validate.dimensions(dims), order=2)

    def transition(self, dt: float | Array, dims: int) -> Array:
        """Return F (..., 3d, 3d)."""
        return polynomial_transition(dt, dims, order=2)

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return Q (..., 3d, 3d)."""
        if self.psd is not None:
            return continuous(dt, dims, 2, self.psd)
        assert self.std is not None
        dt = _validate.time_step(dt)
        g = np.stack([dt**2 / 2, dt, np.where(dt > 0.0, 1.0, 0.0)], axis=-1)
        return piecewise_constant(dt, dims, g, self.std)
