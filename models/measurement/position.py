"""Direct fixes of the position."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Measurement
from imm_tdoa.makeup import AXIS, Makeup
from imm_tdoa.models.measurement import _sigma


@attrs.frozen(eq=False)
class Position(Measurement):
    """The emitter's position itself, one row per axis, m.

    Parameters
    ----------
    sigma : float or (d,)
        Standard deviation per axis, m; errors of the axes are independent.
    dims : int
        Number of space dimensions d, 1 to 3.
    sigma_times : (K,), optional
        With it, sigma is (K, d) and holds at these times.
    """

    sigma: Any = attrs.field(default=10.0)
    dims: int = 2
    sigma_times: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        d = _validate.dimensions(self.dims)
        value, times = _sigma.checked("sigma", self.sigma, d, self.sigma_times)
        object.__setattr__(self, "sigma", value)
        object.__setattr__(self, "sigma_times", times)

    @property
    def size(self) -> int:
        """One row per axis."""
        return self.dims

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the position (..., d), m."""
        return position

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the identity (..., d, d), and zeros for the velocity."""
        d = self.dims
        H = np.broadcast_to(np.eye(d), (*position.shape[:-1], d, d))
        return H, np.zeros_like(H)

    def makeup(self) -> Makeup:
        """Return what the rows are made of."""
        d = self.dims
        return Makeup(np.full(d, AXIS), np.arange(d), np.full(d, -1))

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the diagonal covariance (..., d, d), m²."""
        sigma = _sigma.at("sigma", self.sigma, self.sigma_times, time, self.dims)
        result: Array = sigma[..., None] ** 2 * np.eye(self.dims)
        return result
