"""Time differences of arrival."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import difference, ranges
from imm_tdoa.makeup import RANGE, Makeup
from imm_tdoa.models.measurement._differences import DifferenceMeasurement
from imm_tdoa.stations import Stations


@attrs.frozen(eq=False)
class TDOA(DifferenceMeasurement):
    """Differences of arrival times, tdoa = arrival(station) - arrival(reference), in seconds.

    Parameters
    ----------
    stations : Stations
        The receivers.
    toa_sigma : float or (S,), optional
        Standard deviation of each station's arrival time, s. Differences that share a station
        are correlated and R is full, R = D diag(sigma²) D' (ALGORITHMS §1.1): then no result
        depends on the choice of reference. Pairs that only repeat others (a closed loop) add
        nothing and are left out.
    tdoa_sigma : float or (m,), optional
        Standard deviation of each difference, s, independent of the others.
    pairs : "reference", "adjacent" or (m, 2) int array
        Station and reference of each row; default every station against station 0.
    speed : float
        Speed of the signal, m/s.
    sigma_times : (K,), optional
        With it, sigmas are (K, S) or (K, m) and hold at these times.

    Notes
    -----
    Exactly one of the two sigmas. Internally range differences in metres: h = r_i - r_0,
    dh/dp = u_i' - u_0', dh/dv = 0.
    """

    stations: Stations
    toa_sigma: Any = attrs.field(default=None, kw_only=True)
    tdoa_sigma: Any = attrs.field(default=None, kw_only=True)
    pairs: Any = attrs.field(default="reference", kw_only=True)
    speed: float = attrs.field(default=299792458.0, kw_only=True)
    sigma_times: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        self._check("toa_sigma", "tdoa_sigma")
        _validate.positive("speed", self.speed)

    @property
    def scale(self) -> Array:
        """Metres per second of difference."""
        return np.full(self.size, float(self.speed))

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return range differences (..., m), m."""
        r, _ = ranges(position, self.stations.at(time)[0])
        return difference(r, self.pairs)

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return u_i - u_0 (..., m, d), and zeros for the velocity."""
        _, u = ranges(position, self.stations.at(time)[0])
        H = difference(u, self.pairs, axis=-2)
        return H, np.zeros_like(H)

    def sensor_covariance(self, time: float | Array) -> Array:
        """Return the covariance (..., m, m) of the differences, m²."""
        return self.speed**2 * self._covariance("toa_sigma", "tdoa_sigma", time)

    def error_sources(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the arrivals as sources of error with `toa_sigma`, the rows with `tdoa_sigma`."""
        return self._sources("toa_sigma", "tdoa_sigma", self.speed, position, velocity, time)

    def makeup(self) -> Makeup | None:
        """Return what the rows are made of; None where receiver errors depend on the emitter."""
        return None if self.uncertain else Makeup.of_pairs(RANGE, self.pairs, self.stations)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions, -u_i and +u_0 (..., m, S, d), and zeros."""
        _, u = ranges(position, self.stations.at(time)[0])
        J = self._of_differences(-u)
        return J, np.zeros_like(J)

    def independent(self, present: Mask) -> Mask:
        """Return `present` (..., m) less the differences that close a loop of shared arrivals."""
        return self._without_loops(present, self.toa_sigma)
