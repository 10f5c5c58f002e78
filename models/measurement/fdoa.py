"""Frequency differences of arrival, as range-rate differences."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import difference, incidence, range_rates
from imm_tdoa.models.measurement import _sigma
from imm_tdoa.models.measurement._pairs import shared_noise, spanning_rows
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement
from imm_tdoa.stations import Stations, pair_index


@attrs.frozen(eq=False)
class FDOA(ReceiverMeasurement):
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
        if (self.range_rate_sigma is None) == (self.difference_sigma is None):
            raise ValueError(
                f"FDOA: give exactly one of range_rate_sigma (per station) and difference_sigma "
                f"(per difference), got range_rate_sigma={self.range_rate_sigma!r}, "
                f"difference_sigma={self.difference_sigma!r}"
            )
        put = object.__setattr__
        put(self, "pairs", pair_index(self.pairs, self.stations))
        name = "range_rate_sigma" if self.difference_sigma is None else "difference_sigma"
        rows = len(self.stations) if name == "range_rate_sigma" else self.size
        value, times = _sigma.checked(name, getattr(self, name), rows, self.sigma_times)
        put(self, name, value)
        put(self, "sigma_times", times)

    @property
    def size(self) -> int:
        """Number of rows m."""
        return int(self.pairs.shape[-2])

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
        if self.difference_sigma is not None:
            value, times = self.difference_sigma, self.sigma_times
            sigma = _sigma.at("difference_sigma", value, times, time, self.size)
            result: Array = sigma[..., None] ** 2 * np.eye(self.size)
            return result
        S = len(self.stations)
        sigma = _sigma.at("range_rate_sigma", self.range_rate_sigma, self.sigma_times, time, S)
        return shared_noise(sigma**2, self.pairs)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions (-b) and velocities (-u), each (..., m, S, d)."""
        _, b, u = range_rates(position, velocity, *self.stations.at(time))
        D = -incidence(self.pairs, len(self.stations))[..., None]
        return D * b[..., None, :, :], D * u[..., None, :, :]

    def heard(self, present: Mask) -> Mask:
        """Return which stations (..., S) are in a `present` pair (..., m)."""
        D = np.abs(incidence(self.pairs, len(self.stations)))
        heard: Mask = np.einsum("...m,...ms->...s", present.astype(float), D) > 0.0
        return heard

    def independent(self, present: Mask) -> Mask:
        """Return `present` (..., m) less the differences that close a loop of shared rates."""
        return present if self.range_rate_sigma is None else spanning_rows(self.pairs, present)

    def with_pairs(self, pairs: Any) -> FDOA:
        """Return the same measurement between other station pairs (..., m, 2)."""
        return attrs.evolve(self, pairs=pairs)
