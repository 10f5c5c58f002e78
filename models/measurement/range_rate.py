"""Range rates of one emission, their common offset unknown."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.geometry import range_rates
from imm_tdoa.makeup import RANGE_RATE, Makeup
from imm_tdoa.models.measurement import _sigma
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement
from imm_tdoa.stations import Stations


@attrs.frozen(eq=False)
class RangeRate(ReceiverMeasurement):
    """Range rates (..., S) in m/s with an unknown common offset (carrier or clock drift).

    The un-differenced form of `FDOA`, as `TOA` is of `TDOA`: the offset is eliminated exactly
    and any station may be missing.

    Parameters
    ----------
    stations : Stations
        The receivers; their velocities count.
    sigma : float or (S,)
        Standard deviation of each range rate, m/s.
    sigma_times : (K,), optional
        With it, sigma is (K, S) and holds at these times.
    """

    stations: Stations
    sigma: Any = attrs.field(kw_only=True)
    sigma_times: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        value, times = _sigma.checked("sigma", self.sigma, len(self.stations), self.sigma_times)
        object.__setattr__(self, "sigma", value)
        object.__setattr__(self, "sigma_times", times)

    @property
    def size(self) -> int:
        """Number of rows, one per station."""
        return len(self.stations)

    @property
    def offset_group(self) -> Index:
        """All rows share the unknown offset."""
        return np.zeros(self.size, dtype=np.int64)

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return range rates (..., S), m/s."""
        return range_rates(position, velocity, *self.stations.at(time))[0]

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return b and u, each (..., S, d) (ALGORITHMS §1.2)."""
        _, b, u = range_rates(position, velocity, *self.stations.at(time))
        return b, u

    def sensor_covariance(self, time: float | Array) -> Array:
        """Return the diagonal covariance (..., S, S) of the range rates, (m/s)²."""
        sigma = _sigma.at("sigma", self.sigma, self.sigma_times, time, self.size)
        result: Array = sigma[..., None] ** 2 * np.eye(self.size)
        return result

    def makeup(self) -> Makeup | None:
        """Return what the rows are made of; None where receiver errors depend on the emitter."""
        return None if self.uncertain else Makeup.of_stations(RANGE_RATE, self.stations)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions (-b) and velocities (-u), each (..., S, S, d)."""
        _, b, u = range_rates(position, velocity, *self.stations.at(time))
        D = -np.eye(self.size)[..., None]
        return D * b[..., None, :, :], D * u[..., None, :, :]
