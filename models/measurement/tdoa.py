"""Time differences of arrival."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import difference, incidence, ranges
from imm_tdoa.models.measurement import _sigma
from imm_tdoa.models.measurement._pairs import shared_noise, spanning_rows
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement
from imm_tdoa.stations import Stations, pair_index


@attrs.frozen(eq=False)
class TDOA(ReceiverMeasurement):
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
        if (self.toa_sigma is None) == (self.tdoa_sigma is None):
            raise ValueError(
                f"TDOA: give exactly one of toa_sigma (per arrival) and tdoa_sigma (per "
                f"difference), got toa_sigma={self.toa_sigma!r}, tdoa_sigma={self.tdoa_sigma!r}"
            )
        put = object.__setattr__
        put(self, "pairs", pair_index(self.pairs, self.stations))
        _validate.positive("speed", self.speed)
        name = "toa_sigma" if self.tdoa_sigma is None else "tdoa_sigma"
        rows = len(self.stations) if name == "toa_sigma" else self.size
        value, times = _sigma.checked(name, getattr(self, name), rows, self.sigma_times)
        put(self, name, value)
        put(self, "sigma_times", times)

    @property
    def size(self) -> int:
        """Number of rows m."""
        return int(self.pairs.shape[-2])

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
        if self.tdoa_sigma is not None:
            sigma = _sigma.at("tdoa_sigma", self.tdoa_sigma, self.sigma_times, time, self.size)
            result: Array = (self.speed * sigma[..., None]) ** 2 * np.eye(self.size)
            return result
        S = len(self.stations)
        sigma = _sigma.at("toa_sigma", self.toa_sigma, self.sigma_times, time, S)
        return shared_noise((self.speed * sigma) ** 2, self.pairs)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d station positions, -u_i and +u_0 (..., m, S, d), and zeros."""
        _, u = ranges(position, self.stations.at(time)[0])
        J = -incidence(self.pairs, len(self.stations))[..., None] * u[..., None, :, :]
        return J, np.zeros_like(J)

    def heard(self, present: Mask) -> Mask:
        """Return which stations (..., S) are in a `present` pair (..., m)."""
        D = np.abs(incidence(self.pairs, len(self.stations)))
        heard: Mask = np.einsum("...m,...ms->...s", present.astype(float), D) > 0.0
        return heard

    def independent(self, present: Mask) -> Mask:
        """Return `present` (..., m) less the differences that close a loop of shared arrivals."""
        return present if self.toa_sigma is None else spanning_rows(self.pairs, present)

    def with_pairs(self, pairs: Any) -> TDOA:
        """Return the same measurement between other station pairs (..., m, 2)."""
        return attrs.evolve(self, pairs=pairs)
