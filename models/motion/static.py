"""An emitter that stands still."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, LinearMotion, component_names
from imm_tdoa.models.motion._noise import continuous, exactly_one, piecewise_constant


@attrs.frozen
class Static(LinearMotion):
    """Static: position only, x' = x + w (ALGORITHMS §2).

    Parameters
    ----------
    psd : float, optional
        Density of a random walk of the position, m²/s; 0 for one that truly stands.
    std : float, optional
        Standard deviation of the position's step per scan, m, whatever the scan interval.

    Notes
    -----
    Exactly one of the two. Components: ``x y [z]``. F = I; Q = psd dt I, or std² I for dt > 0.
    """

    psd: float | None = None
    std: float | None = None

    def __attrs_post_init__(self) -> None:
        exactly_one("Static", self.psd, self.std)

    @property
    def composes(self) -> bool:
        """Whether noise over two steps on end is that over one long step: only with `psd`."""
        return self.std is None

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the position's components."""
        return component_names(_validate.dimensions(dims), order=0)

    def transition(self, dt: float | Array, dims: int) -> Array:
        """Return the identity (..., d, d)."""
        dt = _validate.time_step(dt)
        d = _validate.dimensions(dims)
        return np.broadcast_to(np.eye(d), (*dt.shape, d, d))

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return Q (..., d, d), m²."""
        if self.psd is not None:
            return continuous(dt, dims, 0, self.psd)
        assert self.std is not None
        g = np.where(_validate.time_step(dt) > 0.0, 1.0, 0.0)[..., None]
        return piecewise_constant(dt, dims, g, self.std)
