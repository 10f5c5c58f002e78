"""Frequency differences of arrival, as range-rate differences."""

from __future__ import annotations

from typing import Any

import attrs

from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import difference, range_rates
from imm_tdoa.makeup import RANGE_RATE, Makeup
from imm_tdoa.models.measurement._differences import DifferenceMeasurement
from imm_tdoa.stations import Stations


@attrs.frozen(eq=False)
class FDOA(DifferenceMeasurement):
    """Range-rate differences, rate(station) - rate(reference), in m/s (ALGORITHMS §1.2).

    A frequency difference f_i - f_0 at carrier f is the range-rate difference -(c/f)(f_i - f_0).

    Parameters
    ----------
    stations : Stations
        The receivers; their velocities count.
    range_rate_sigma : float or (S,), optional
        Standard deviation of each station's range rate, m/s; differences that share a station
        are correlated, R = D diag(sigma²) D'.
    difference_sigma : float or (m,), optional
        Standard deviation of each difference, m/s, independent of the others.
    pairs : "reference", "adjacent" or (m, 2) int array
        Station and reference of each row; default every station against station 0.
    sigma_times : (K,), optional
        With it, sigmas are (K, S) or (K, m) and hold at these times.

    Notes
    -----
    Exactly one of the two sigmas. h = u_i'(v - v_i) - u_0'(v - v_0), dh/dp = b_i' - b_0',
    dh/dv = u_i' - u_0', b = (w - (u'w) u)/r with w = v - v_i.
    """

    stations: Stations
    range_rate_sigma: Any = attrs.field(default=None, kw_only=True)
    difference_sigma: Any = attrs.field(default=None, kw_only=True)
    pairs: Any = attrs.field(default="reference", kw_only=True)
    sigma_times: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        self._check("range_rate_sigma", "difference_sigma")

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return range-rate differences (..., m), m/s."""
        rate, _, _ = range_rates(position, velocity, *self.stations.at(time))
        return difference(rate, self.pairs)

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return b_i - b_0 and u_i - u_0, each (..., m, d)."""
        _, b, u = range_rates(position, velocity, *self.stations.at(time))
        return difference(b, self.pairs, axis=-2), difference(u, self.pairs, axis=-2)

    def sensor_covariance(self, time: float | Array) -> Array:
        """Return the covariance (..., m, m) of the differences, (m/s)²."""
        return self._covariance("range_rate_sigma", "difference_sigma", time)

    def error_sources(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the stations' rates as sources with `range_rate_sigma`, else the rows."""
        return self._sources("range_rate_sigma", "difference_sigma", 1.0, position, velocity, time)

    def makeup(self) -> Makeup | None:
        """Return what the rows are made of; None where receiver errors depend on the emitter."""
        return None if self.uncertain else Makeup.of_pairs(RANGE_RATE, self.pairs, self.stations)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions (-b) and velocities (-u), each (..., m, S, d)."""
        _, b, u = range_rates(position, velocity, *self.stations.at(time))
        return self._of_differences(-b), self._of_differences(-u)

    def independent(self, present: Mask) -> Mask:
        """Return `present` (..., m) less the differences that close a loop of shared rates."""
        return self._without_loops(present, self.range_rate_sigma)
