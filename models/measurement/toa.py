"""Arrival times of one emission, its own time unknown."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index
from imm_tdoa.geometry import ranges
from imm_tdoa.makeup import RANGE, Makeup
from imm_tdoa.models.measurement import _sigma
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement
from imm_tdoa.stations import Stations


@attrs.frozen(eq=False)
class TOA(ReceiverMeasurement):
    """Arrival times (..., S) in seconds with an unknown common emission time.

    The emission time is eliminated exactly (ALGORITHMS §1.1, "reference-free information"), so
    any station may be missing and none is special. The same information as `TDOA` with
    `toa_sigma`, whatever the reference.

    Parameters
    ----------
    stations : Stations
        The receivers.
    sigma : float or (S,)
        Standard deviation of each arrival time, s.
    speed : float
        Speed of the signal, m/s.
    sigma_times : (K,), optional
        With it, sigma is (K, S) and holds at these times.
    """

    stations: Stations
    sigma: Any = attrs.field(kw_only=True)
    speed: float = attrs.field(default=299792458.0, kw_only=True)
    sigma_times: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        _validate.positive("speed", self.speed)
        value, times = _sigma.checked("sigma", self.sigma, len(self.stations), self.sigma_times)
        object.__setattr__(self, "sigma", value)
        object.__setattr__(self, "sigma_times", times)

    @property
    def size(self) -> int:
        """Number of rows, one per station."""
        return len(self.stations)

    @property
    def scale(self) -> Array:
        """Metres per second of arrival time."""
        return np.full(self.size, float(self.speed))

    @property
    def offset_group(self) -> Index:
        """All rows share the unknown emission time."""
        return np.zeros(self.size, dtype=np.int64)

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return ranges (..., S), m."""
        return ranges(position, self.stations.at(time)[0])[0]

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return unit vectors (..., S, d), and zeros for the velocity."""
        _, u = ranges(position, self.stations.at(time)[0])
        return u, np.zeros_like(u)

    def sensor_covariance(self, time: float | Array) -> Array:
        """Return the diagonal covariance (..., S, S) of the arrivals, m²."""
        sigma = self.speed * _sigma.at("sigma", self.sigma, self.sigma_times, time, self.size)
        result: Array = sigma[..., None] ** 2 * np.eye(self.size)
        return result

    def makeup(self) -> Makeup | None:
        """Return what the rows are made of; None where receiver errors depend on the emitter."""
        return None if self.uncertain else Makeup.of_stations(RANGE, self.stations)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions (..., S, S, d), -u on the diagonal, and zeros."""
        _, u = ranges(position, self.stations.at(time)[0])
        J = -np.eye(self.size)[..., None] * u[..., None, :, :]
        return J, np.zeros_like(J)
