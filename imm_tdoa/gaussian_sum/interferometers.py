"""One ambiguous phase and its rate as a Gaussian sum (Source C; ALGORITHMS §7.1-1 to 7.1-4)."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.gaussian import wrap
from imm_tdoa.gaussian_sum.hypotheses import Hypotheses
from imm_tdoa.stations import Stations

Shape = Literal["correlated", "diagonal"]
TURN = 2.0 * np.pi


class Interferometer(Protocol):
    """What is asked of a measurement of phase and rate (``phase-difference`` of the registry)."""

    @property
    def stations(self) -> Stations:
        """The observer, one station."""
        ...

    @property
    def size(self) -> int:
        """Two rows, phase (rad) and rate (rad/s)."""
        ...

    @property
    def electrical_length(self) -> float:
        """Phase K along the baseline, rad."""
        ...

    @property
    def frequency(self) -> float:
        """Frequency of the signal, Hz."""
        ...

    @property
    def azimuth_sigma(self) -> float:
        """Standard deviation of the azimuth's error, rad."""
        ...

    @property
    def azimuth_rate_sigma(self) -> float:
        """Standard deviation of the azimuth rate's error, rad/s."""
        ...

    @property
    def frequency_sigma(self) -> float:
        """Standard deviation of the frequency's error, Hz."""
        ...

    @property
    def sigma_rate(self) -> float | None:
        """Standard deviation of the rate's error, rad/s."""
        ...

    def azimuth_at(self, time: float | Array) -> tuple[Array, Array]:
        """Azimuth of the baseline, rad, and its rate, rad/s."""
        ...

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """R (..., 2, 2)."""
        ...


class Ranging(NamedTuple):
    """Ranges that a phase rate gives along bearings (ALGORITHMS §7.1-2, 3).

    Attributes
    ----------
    range : (..., N)
        m; not positive where the rate does not fit the bearing.
    by_bearing : (..., N)
        Derivative of the range in the bearing, m/rad.
    variance : (..., N)
        Variance of the range at a known bearing, m².
    parts : dict of (..., N)
        The variance's shares: ``"rate"``, ``"velocity"``, ``"azimuth"``, ``"azimuth_rate"``,
        ``"frequency"``.
    """

    range: Array
    by_bearing: Array
    variance: Array
    parts: dict[str, Array]


def lobes(
    interferometer: Interferometer,
    time: float,
    values: Any,
    bearing: Any,
    bearing_sigma: float,
    *,
    every: int = 1,
    count: int | None = None,
    lobe_sigma: float | None = None,
    covariance: Shape = "correlated",
    window: float = 2.0,
) -> Hypotheses:
    """Return a hypothesis for each whole number of turns that the phase may lack.

    The bearing is known roughly, to ±`window` sigmas; within it each ambiguity integer gives a
    bearing, and the phase rate a range along it. Of the integers every `every`-th is taken,
    `count` of them about the middle; one then stands for its neighbours too.

    Parameters
    ----------
    interferometer : Interferometer
        A `PhaseDifference` with both rows in use.
    time : float
        Time of the scan, s.
    values : (..., 2)
        Phase, rad, and its rate, rad/s; both must be there.
    bearing : float or (...)
        Rough bearing, rad, on the emitter's side of the baseline.
    bearing_sigma : float
        Its standard deviation, rad.
    every : int
        Step between the integers taken (Source C: 9).
    count : int, optional
        How many are taken (Source C: 6); default all in the window.
    lobe_sigma : float, optional
        Standard deviation of a hypothesis' bearing, rad (Source C: 1°). Default what phase error
        and the integers it stands for amount to, (R_phase + (2 pi)² (every² - 1)/12)^1/2 / (K
        sin(bearing - azimuth)).
    covariance : "correlated" or "diagonal"
        Whether the range is taken for a function of the bearing, or for independent of it as in
        the source (§7.1-4).
    window : float
        Half the width of the window, sigmas.

    Returns
    -------
    Hypotheses
        Equal weights; zero where there are fewer integers than slots, or where the rate gives no
        range.

    Raises
    ------
    ValueError
        Rows missing, an observer that is not there at this time, no integer in the window, or no
        bearing along which the rate gives a range.
    """
    z, about = _checked(interferometer, values, bearing)
    sigma = _validate.positive("bearing_sigma", bearing_sigma)
    every = _whole("every", every)
    _validate.one_of("covariance", covariance, get_args(Shape))
    time = float(_validate.array("time", time, ()))
    s = interferometer.stations.at(time)[0][0]
    azimuth, _ = interferometer.azimuth_at(time)
    if not (np.all(np.isfinite(s)) and np.isfinite(azimuth)):
        raise ValueError(f"time: the observer or its baseline is not known at {time:g} s")
    K = interferometer.electrical_length
    beta = wrap(about - azimuth)
    reach = _validate.positive("window", window) * sigma
    turns, there = _integers(z[..., 0], np.abs(beta), reach, K, every, count)
    cosine = np.clip((z[..., :1] + TURN * turns) / K, -1.0, 1.0)
    theta = azimuth + np.where(beta < 0.0, -1.0, 1.0)[..., None] * np.arccos(cosine)
    ranging = ranges_along(interferometer, theta, z[..., 1:], time)
    there &= np.isfinite(ranging.range) & (ranging.range > 0.0) & np.isfinite(ranging.variance)
    if not np.all(np.any(there, axis=-1)):
        raise ValueError(
            "values: the phase rate gives no range along any bearing of the window; expected a "
            "bearing on the emitter's side of the baseline"
        )
    r = np.where(there, ranging.range, 1.0)
    u = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    place = s + r[..., None] * u
    if lobe_sigma is None:
        R = interferometer.noise_covariance(place, np.zeros_like(place), time)[..., 0, 0]
        spread = np.sqrt(R + TURN**2 * (every**2 - 1) / 12.0)
        width = spread / np.where(there, K * np.abs(np.sin(theta - azimuth)), 1.0)
    else:
        width = np.full(theta.shape, _validate.positive("lobe_sigma", lobe_sigma))
    P = np.where(there[..., None, None], _spread(u, r, ranging, width, covariance), np.eye(2))
    weights = there / np.count_nonzero(there, axis=-1)[..., None]
    return Hypotheses(place, P, weights)


def ranges_along(interferometer: Interferometer, bearing: Any, rate: Any, time: float) -> Ranging:
    """Return the ranges of a fixed emitter that a phase rate gives along bearings (§7.1-2).

    Parameters
    ----------
    interferometer : Interferometer
        A `PhaseDifference`.
    bearing : (..., N)
        Bearings, rad.
    rate : float or (..., N)
        Phase rate, rad/s.
    time : float
        s.
    """
    theta, rate = np.asarray(bearing, dtype=float), np.asarray(rate, dtype=float)
    v = interferometer.stations.at(time)[1][0]
    azimuth, azimuth_rate = interferometer.azimuth_at(time)
    K, beta = interferometer.electrical_length, theta - azimuth
    sin, cos = np.sin(theta), np.cos(theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        N = v[0] * sin - v[1] * cos
        D = azimuth_rate - rate / (K * np.sin(beta))
        r = N / D
        by_azimuth = N / D**2 * rate * np.cos(beta) / (K * np.sin(beta) ** 2)
        by_bearing = (v[0] * cos + v[1] * sin) / D - by_azimuth
        by_velocity = np.stack([sin, -cos], axis=-1) / D[..., None]
        by_rate = r / (D * K * np.sin(beta))
        relative = interferometer.frequency_sigma / interferometer.frequency
        Q = interferometer.stations.velocity_covariance
        Q = np.zeros((2, 2)) if Q is None else Q[0]
        parts = {
            "rate": (by_rate * (interferometer.sigma_rate or 0.0)) ** 2,
            "velocity": np.einsum("...a,ab,...b->...", by_velocity, Q, by_velocity),
            "azimuth": (by_azimuth * interferometer.azimuth_sigma) ** 2,
            "azimuth_rate": (N / D**2 * interferometer.azimuth_rate_sigma) ** 2,
            "frequency": (by_rate * rate * relative) ** 2,
        }
    return Ranging(r, by_bearing, np.asarray(sum(parts.values())), parts)


def _spread(u: Array, r: Array, ranging: Ranging, width: Array, shape: Shape) -> Array:
    """Covariances (..., N, 2, 2) of places at ranges r along u, bearings wrong by `width`."""
    across = r[..., None] * np.stack([-u[..., 1], u[..., 0]], axis=-1)
    variance, slope = ranging.variance, ranging.by_bearing
    if shape == "diagonal":
        variance = variance + (slope * width) ** 2
    else:
        across = across + slope[..., None] * u
    P = variance[..., None, None] * u[..., :, None] * u[..., None, :]
    return P + (width**2)[..., None, None] * across[..., :, None] * across[..., None, :]


def _integers(
    phase: Array, beta: Array, reach: float, K: float, every: int, count: int | None
) -> tuple[Index, Mask]:
    """Ambiguity integers (..., N) of bearings within beta ± reach, and which slots have one."""
    last = (K * np.cos(np.maximum(beta - reach, 0.0)) - phase) / TURN
    first = (K * np.cos(np.minimum(beta + reach, np.pi)) - phase) / TURN
    low, high = np.ceil(first).astype(np.int64), np.floor(last).astype(np.int64)
    if np.any(high < low):
        raise ValueError(
            "bearing: no ambiguity integer fits the window of bearings; expected a longer "
            "baseline, a wider window or a bearing further from the baseline's direction"
        )
    if count is None:
        count = int(np.max(high - low) // every + 1)
    count = _whole("count", count)
    middle = 0.5 * (low + high)[..., None]
    steps = every * (np.arange(count) - 0.5 * (count - 1))
    turns = np.ceil(middle + steps - 0.5).astype(np.int64)
    return turns, (turns >= low[..., None]) & (turns <= high[..., None])


def _checked(interferometer: Interferometer, values: Any, bearing: Any) -> tuple[Array, Array]:
    if not hasattr(interferometer, "electrical_length") or interferometer.size != 2:
        raise ValueError(
            "interferometer: expected a measurement of phase and rate, PhaseDifference(..., "
            "use='both')"
        )
    z = _validate.array("values", values, (None, 2))
    about = _validate.array("bearing", bearing)
    try:
        batch = np.broadcast_shapes(z.shape[:-1], about.shape)
    except ValueError:
        raise ValueError(
            f"bearing: batch axes {about.shape} do not fit those of values, {z.shape[:-1]}"
        ) from None
    return np.broadcast_to(z, (*batch, 2)), np.broadcast_to(about, batch)


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")
    return value
