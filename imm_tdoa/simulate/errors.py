"""What goes wrong with a measurement: lasting errors, gross errors, rows that do not arrive."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.simulate.faults import Clock, Dropouts
from imm_tdoa.simulate.streams import Streams


def gauss_markov(unit: Array, times: Array, sigma: float, time_constant: float) -> Array:
    """Return a stationary first-order Gauss-Markov process at `times`, exact for any steps.

    x_k = rho x_(k-1) + sigma sqrt(1 - rho²) w_k with rho = exp(-dt / time_constant), so that
    E[x(t) x(t + h)] = sigma² exp(-|h| / time_constant).

    Parameters
    ----------
    unit : (K, S)
        Standard normal numbers w.
    times : (K,)
        Times, s, not decreasing.
    sigma, time_constant : float
        Standard deviation, and correlation time, s.
    """
    rho = np.exp(-np.diff(times) / time_constant)
    x = sigma * unit
    for k in range(1, len(times)):
        x[k] = rho[k - 1] * x[k - 1] + np.sqrt(1.0 - rho[k - 1] ** 2) * x[k]
    return x


def between(unit: Array, before: Array, after: Array, a: Array, b: Array) -> Array:
    """Return a Gauss-Markov process of variance 1 between two of its values, drawn at random.

    Given the values a time `a` before and a time `b` after, it is normal with mean
    (rho_a (1 - rho_b²) before + rho_b (1 - rho_a²) after) / (1 - rho_a² rho_b²) and variance
    (1 - rho_a²) (1 - rho_b²) / (1 - rho_a² rho_b²), rho = exp(-time).

    Parameters
    ----------
    unit, before, after : (T, S)
        Standard normal numbers; the process before and after.
    a, b : (T, 1)
        Times to those, in correlation times; not both zero.
    """
    rho_a, rho_b = np.exp(-a), np.exp(-b)
    left, right, both = -np.expm1(-2.0 * a), -np.expm1(-2.0 * b), -np.expm1(-2.0 * (a + b))
    mean = (rho_a * right * before + rho_b * left * after) / both
    result: Array = mean + np.sqrt(left * right / both) * unit
    return result


def gross(rng: np.random.Generator, count: int, p: float, size: float, late: bool) -> Array:
    """Return `count` errors: `size` times 0.5 to 1.5 with probability `p`, else zero."""
    hit = rng.random(count) < p
    magnitude = size * (0.5 + rng.random(count))
    sign = np.where(late | (rng.random(count) < 0.5), 1.0, -1.0)
    result: Array = np.where(hit, sign * magnitude, 0.0)
    return result


def heard(
    dropouts: Dropouts, streams: Streams, who: str, stations: tuple[str, ...], times: Array
) -> Mask:
    """Return which stations (T, S) receive the emissions of target `who` at `times` (T,)."""
    n = len(times)
    lost = streams.of("dropouts", "scan", who).random(n) < dropouts.scan
    mask = np.broadcast_to(~lost[:, None], (n, len(stations))).copy()
    for i, station in enumerate(stations):
        p = dropouts.station.get(station, 0.0)
        if p > 0.0:
            mask[:, i] &= streams.of("dropouts", "station", who, station).random(n) >= p
        mask[:, i] &= ~silent(dropouts, station, times)
    return mask


def silent(dropouts: Dropouts, station: str, times: Array) -> Mask:
    """Return at which of `times` (T,) a station hears nothing."""
    mask = np.zeros(len(times), dtype=bool)
    for silence in dropouts.silences:
        if silence.station == station:
            begin = -np.inf if silence.from_s is None else silence.from_s
            end = np.inf if silence.to_s is None else silence.to_s
            mask |= (times >= begin) & (times <= end)
    return mask


def clock_offsets(clock: Clock, streams: Streams, who: str, elapsed: Array) -> tuple[Array, Array]:
    """Return what the clock adds to arrival times, s, and to range rates, m/s, (T,) each."""

    def offset(kind: str, constant: float, drift: float, spread: float) -> Array:
        drawn = streams.of("clock", kind, who).random(len(elapsed)) - 0.5
        result: Array = constant + drift * elapsed + spread * drawn
        return result

    return (
        offset("time", clock.offset_s, clock.drift, clock.spread_s),
        offset(
            "rate",
            clock.range_rate_offset_mps,
            clock.range_rate_drift_mps2,
            clock.range_rate_spread_mps,
        ),
    )
