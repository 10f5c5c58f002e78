"""Phase difference of one interferometer on a moving observer, and its rate."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Self, get_args

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Mask
from imm_tdoa.gaussian import wrap
from imm_tdoa.models.measurement._receiver import ReceiverMeasurement
from imm_tdoa.stations import Stations

Use = Literal["both", "phase", "rate"]
NAMES = ("phase", "rate")
USES: dict[str, list[int]] = {"both": [0, 1], "phase": [0], "rate": [1]}


class _Sight(NamedTuple):
    """The line from observer to emitter; angles in rad, rates in rad/s."""

    beta: Array  # (...), bearing less baseline azimuth
    turn: Array  # (...), rate of `beta`
    bearing_p: Array  # (..., 2), gradient of the bearing in the emitter's position
    rate_p: Array  # (..., 2), gradient of the bearing's rate in it


@attrs.frozen(eq=False)
class PhaseDifference(ReceiverMeasurement):
    """Ambiguous phase difference of two antennas and its rate, in rad and rad/s (§1.3).

    A baseline of L metres at azimuth a sees an emitter at bearing θ with the phase difference
    K cos(θ - a), K = 2 pi f L / c, known only up to whole turns, and its rate
    -K sin(θ - a)(dθ/dt - da/dt), which is not ambiguous. Azimuths and bearings count from the
    x axis towards the y axis. Two dimensions.

    Parameters
    ----------
    stations : Stations
        The observer: one station, moving or fixed. Its position and velocity covariances, errors
        that are independent from scan to scan, enter R (§1.4, §7.3).
    baseline : float
        Distance L of the antennas, m.
    frequency : float
        Frequency f of the signal, Hz.
    baseline_azimuth : float or (K,)
        Direction from the first antenna to the second, rad; with `azimuth_times` sampled, and
        interpolated the short way round.
    azimuth_rate : float or (K,), optional
        Rate of `baseline_azimuth`, rad/s; default zero, or the slope between samples.
    azimuth_times : (K,), optional
        Sample times of the azimuth, s. Before the first and after the last nothing is measured.
    sigma_phase, sigma_rate : float, optional
        Standard deviations, rad and rad/s; needed for the rows in use.
    azimuth_sigma, azimuth_rate_sigma, frequency_sigma : float
        Standard deviations of errors of the azimuth (rad), its rate (rad/s) and the frequency
        (Hz), independent from scan to scan; they enter R too.
    use : "both", "phase" or "rate"
        Which rows there are.
    propagation_speed : float
        Speed of the signal, m/s.

    Raises
    ------
    ValueError
        More than one station, other than two dimensions, a length, frequency or standard
        deviation that is not positive, sampled azimuths that do not fit together.
    """

    stations: Stations
    baseline: float = attrs.field(kw_only=True)
    frequency: float = attrs.field(kw_only=True)
    baseline_azimuth: Any = attrs.field(default=0.0, kw_only=True)
    azimuth_rate: Any = attrs.field(default=None, kw_only=True)
    azimuth_times: Any = attrs.field(default=None, kw_only=True)
    sigma_phase: float | None = attrs.field(default=None, kw_only=True)
    sigma_rate: float | None = attrs.field(default=None, kw_only=True)
    azimuth_sigma: float = attrs.field(default=0.0, kw_only=True)
    azimuth_rate_sigma: float = attrs.field(default=0.0, kw_only=True)
    frequency_sigma: float = attrs.field(default=0.0, kw_only=True)
    use: Use = attrs.field(default="both", kw_only=True)
    propagation_speed: float = attrs.field(default=299792458.0, kw_only=True)

    def __attrs_post_init__(self) -> None:
        if not isinstance(self.stations, Stations):
            raise ValueError(f"stations: expected Stations, got {self.stations!r}")
        if self.stations.dims != 2 or len(self.stations) != 1:
            raise ValueError(
                f"stations: expected one observer in 2 dimensions, got {len(self.stations)} in "
                f"{self.stations.dims}"
            )
        for name in ("baseline", "frequency", "propagation_speed"):
            _validate.positive(name, getattr(self, name))
        for name in ("azimuth_sigma", "azimuth_rate_sigma", "frequency_sigma"):
            _validate.non_negative(name, getattr(self, name))
        _validate.one_of("use", self.use, get_args(Use))
        for i in USES[self.use]:
            name = f"sigma_{NAMES[i]}"
            if getattr(self, name) is None:
                raise ValueError(f"{name}: the {NAMES[i]} is in use; give its standard deviation")
            _validate.positive(name, getattr(self, name))
        self._check_azimuth()

    def _check_azimuth(self) -> None:
        put, shape = object.__setattr__, []
        if self.azimuth_times is not None:
            times = _validate.array("azimuth_times", self.azimuth_times, ("K",))
            if len(times) < 2 or np.any(np.diff(times) <= 0.0):
                raise ValueError("azimuth_times: expected two or more strictly increasing times")
            put(self, "azimuth_times", times)
            shape = [len(times)]
        azimuth = _validate.array("baseline_azimuth", self.baseline_azimuth, shape)
        put(self, "baseline_azimuth", np.unwrap(azimuth) if shape else azimuth)
        if self.azimuth_rate is not None:
            put(self, "azimuth_rate", _validate.array("azimuth_rate", self.azimuth_rate, shape))
            if not shape and self.azimuth_rate != 0.0:
                raise ValueError("azimuth_rate: a baseline that turns needs azimuth_times")

    @classmethod
    def specimen(cls) -> Self:
        """Return an instance to check."""
        observer = Stations(np.zeros((1, 2)), velocities=np.array([[50.0, 0.0]]))
        settings: dict[str, Any] = {"baseline": 1.0, "frequency": 1e9, "baseline_azimuth": 0.3}
        return cls(observer, sigma_phase=0.2, sigma_rate=0.01, **settings)

    @property
    def size(self) -> int:
        """Number of rows in use, 1 or 2."""
        return len(USES[self.use])

    @property
    def angular(self) -> Mask:
        """The phase is an angle, its rate is none."""
        return np.array([NAMES[i] == "phase" for i in USES[self.use]])

    @property
    def electrical_length(self) -> float:
        """The phase K = 2 pi f L / c along the baseline, rad."""
        return float(2.0 * np.pi * self.frequency * self.baseline / self.propagation_speed)

    def azimuth_at(self, time: float | Array) -> tuple[Array, Array]:
        """Return the baseline's azimuth (...), rad, and its rate (...), rad/s.

        Parameters
        ----------
        time : float or (...)
            When, s; NaN comes back outside the times for which the azimuth was sampled.
        """
        time = np.asarray(time, dtype=float)
        stamps, azimuth = self.azimuth_times, self.baseline_azimuth
        if stamps is None:
            return np.broadcast_to(azimuth, time.shape), np.zeros(time.shape)
        here = np.interp(time, stamps, azimuth, left=np.nan, right=np.nan)
        if self.azimuth_rate is not None:
            return here, np.interp(time, stamps, self.azimuth_rate, left=np.nan, right=np.nan)
        k = np.clip(np.searchsorted(stamps, time, side="right") - 1, 0, len(stamps) - 2)
        slope = np.diff(azimuth)[k] / np.diff(stamps)[k]
        return here, np.where(np.isnan(here), np.nan, slope)

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the phase in [-pi, pi), rad, and its rate, rad/s: those in use, (..., m)."""
        sight = self._sight(position, velocity, time)
        K = self.electrical_length
        phase = wrap(K * np.cos(sight.beta))
        rows = np.stack([phase, -K * np.sin(sight.beta) * sight.turn], axis=-1)
        return rows[..., USES[self.use]]

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the derivatives in position and velocity (..., m, 2) (§1.3).

        The bearing's rate depends on the emitter's velocity as the bearing on its position.
        """
        sight = self._sight(position, velocity, time)
        K = self.electrical_length
        sine = (K * np.sin(sight.beta))[..., None]
        cosine = (K * np.cos(sight.beta) * sight.turn)[..., None]
        phase = -sine * sight.bearing_p
        rate = -cosine * sight.bearing_p - sine * sight.rate_p
        rows = USES[self.use]
        Hp = np.stack([phase, rate], axis=-2)[..., rows, :]
        return Hp, np.stack([np.zeros_like(phase), phase], axis=-2)[..., rows, :]

    def sensor_covariance(self, time: float | Array) -> Array:
        """Return the diagonal covariance (m, m) of the phase and rate measured."""
        sigma = [getattr(self, f"sigma_{NAMES[i]}") for i in USES[self.use]]
        return np.diag(np.array(sigma, dtype=float) ** 2)

    def station_jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d observer's position and velocity, each (..., m, 1, 2)."""
        Hp, Hv = self.jacobian(position, velocity, time)
        return -Hp[..., None, :], -Hv[..., None, :]

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return R (..., m, m): sensor, observer, azimuth and frequency errors."""
        R = super().noise_covariance(position, velocity, time)
        if self.azimuth_sigma == self.azimuth_rate_sigma == self.frequency_sigma == 0.0:
            return R
        sight = self._sight(position, velocity, time)
        K, zero = self.electrical_length, np.zeros_like(sight.beta)
        sine, cosine = K * np.sin(sight.beta), K * np.cos(sight.beta)
        by = (  # derivatives of phase and rate by azimuth, its rate, frequency
            (self.azimuth_sigma, (sine, cosine * sight.turn)),
            (self.azimuth_rate_sigma, (zero, sine)),
            (self.frequency_sigma / self.frequency, (cosine, -sine * sight.turn)),
        )
        for sigma, rows in by:
            J = sigma * np.stack(rows, axis=-1)[..., USES[self.use]]
            R = R + J[..., :, None] * J[..., None, :]
        return R

    def _sight(self, position: Array, velocity: Array, time: float | Array) -> _Sight:
        s, vs = self.stations.at(time)
        azimuth, azimuth_rate = self.azimuth_at(time)
        d, w = position - s[..., 0, :], velocity - vs[..., 0, :]
        x, y = d[..., 0], d[..., 1]
        square = x * x + y * y
        square = np.where(square > 0.0, square, 1.0)
        rate = (x * w[..., 1] - y * w[..., 0]) / square
        bearing_p = np.stack([-y, x], axis=-1) / square[..., None]
        across = np.stack([w[..., 1], -w[..., 0]], axis=-1)
        rate_p = (across - 2.0 * rate[..., None] * d) / square[..., None]
        beta = np.arctan2(y, x) - azimuth
        return _Sight(beta, rate - azimuth_rate, bearing_p, rate_p)
