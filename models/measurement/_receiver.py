"""What station-based measurement models share: receivers that are not exactly where they say."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Mask, Measurement
from imm_tdoa.stations import Stations


class ReceiverMeasurement(Measurement):
    """A measurement made by `stations`, each with its own independent position error.

    The errors enter the noise to first order, R + H_s Q_s H_s' (ALGORITHMS §1.4), which is right
    where they are independent from scan to scan. A subclass supplies `sensor_covariance` and
    `station_jacobian`.
    """

    stations: Stations

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return self.stations.dims

    def sensor_covariance(self, time: float | Array) -> Array:
        """Return the covariance (..., m, m) of the measurement alone, internal units."""
        raise NotImplementedError

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions and velocities, each (..., m, S, d)."""
        raise NotImplementedError

    def heard(self, present: Mask) -> Mask:
        """Return which stations (..., S) are behind the `present` rows (..., m)."""
        return present

    def anchors(self, time: float | Array, present: Mask) -> Array:
        """Return the positions (..., S, d) of the stations heard, NaN for the others."""
        where = self.stations.at(time)[0]
        return np.where(self.heard(present)[..., None], where, np.nan)

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return R (..., m, m): the sensor's covariance and the receivers' errors."""
        R = self.sensor_covariance(time)
        if self.uncertain:
            J = self.station_jacobian(position, velocity, time)
            R = R + receiver_covariance(self.stations, J, J)
        return R

    @property
    def uncertain(self) -> bool:
        """Whether the stations have position or velocity errors."""
        s = self.stations
        return s.position_covariance is not None or s.velocity_covariance is not None


def receiver_covariance(
    stations: Stations, left: tuple[Array, Array], right: tuple[Array, Array]
) -> Array:
    """Return H_s Q_s H_s' (..., m, k) between two sets of rows of the same stations (§1.4)."""
    total: Array | float = 0.0
    errors = (stations.position_covariance, stations.velocity_covariance)
    for Q, J, K in zip(errors, left, right, strict=True):
        if Q is not None:
            # A station not heard has no direction; it must not spoil the rows of the others.
            J, K = np.where(np.isfinite(J), J, 0.0), np.where(np.isfinite(K), K, 0.0)
            total = total + np.einsum("...isa,sab,...jsb->...ij", J, Q, K)
    return np.asarray(total)
