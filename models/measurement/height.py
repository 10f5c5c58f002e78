"""The emitter's height, as it reports it itself."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Measurement
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.makeup import HEIGHT, Makeup
from imm_tdoa.models.measurement import _sigma


@attrs.frozen(eq=False)
class Height(Measurement):
    """Height of the emitter, one row, m: z in a local frame, above WGS84 in an ENU frame.

    Parameters
    ----------
    sigma : float
        Standard deviation, m.
    frame : EastNorthUp, optional
        With it, the height is that above the WGS84 ellipsoid; without, the coordinate z.
    sigma_times : (K,), optional
        With it, sigma is (K, 1) and holds at these times.
    """

    sigma: Any = attrs.field(default=10.0)
    frame: EastNorthUp | None = attrs.field(default=None, kw_only=True)
    sigma_times: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        value, times = _sigma.checked("sigma", self.sigma, 1, self.sigma_times)
        object.__setattr__(self, "sigma", value)
        object.__setattr__(self, "sigma_times", times)

    @property
    def dims(self) -> int:
        """Three: a height needs a z."""
        return 3

    @property
    def size(self) -> int:
        """One row."""
        return 1

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the height (..., 1), m."""
        if self.frame is None:
            return position[..., 2:3]
        return self.frame.height(position)[0][..., None]

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the upward direction (..., 1, 3), and zeros for the velocity."""
        if self.frame is None:
            H = np.broadcast_to(np.array([[0.0, 0.0, 1.0]]), (*position.shape[:-1], 1, 3))
        else:
            H = self.frame.height(position)[1][..., None, :]
        return H, np.zeros_like(H)

    def makeup(self) -> Makeup:
        """Return what the row is made of."""
        return Makeup(np.array([HEIGHT]), np.array([2]), np.array([-1]), frame=self.frame)

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the variance (..., 1, 1), m²."""
        sigma = _sigma.at("sigma", self.sigma, self.sigma_times, time, 1)
        result: Array = sigma[..., None] ** 2
        return result
