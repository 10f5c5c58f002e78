"""What goes wrong with the measurements of a chunk's runs: noise, gross errors, losses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.geometry import difference
from imm_tdoa.simulate import Scenario

if TYPE_CHECKING:
    from imm_tdoa.study.draw import Streams


def errors(plan: Scenario, streams: Streams, times: Array, ends: Index) -> Array:
    """Return the errors (n, T, m) of all rows, in the rows' own units.

    Parameters
    ----------
    plan : Scenario
        Noise and outliers.
    streams : Streams
        Where random numbers come from.
    times : (n, T)
        Times of the scans, s.
    ends : (m, 2) or (n, T, m, 2) int
        Station and reference of each difference.
    """
    n, T = times.shape
    S, noise, outliers = len(plan.stations), plan.noise, plan.outliers
    arrival = np.zeros((n, T, S))
    if noise.toa_sigma_s is not None:
        arrival += noise.toa_sigma_s * streams.normal("arrival", T, S)
    if noise.bias_sigma_s is not None and noise.bias_time_s is not None:
        unit = streams.normal("bias", T, S)
        arrival += noise.bias_sigma_s * gauss_markov(unit, times, noise.bias_time_s)
    size, rate_size = _sizes(plan)
    rated = plan.sampling.range_rate and noise.range_rate_sigma_mps is not None
    rate = np.zeros((n, T, S))
    if rated:
        assert noise.range_rate_sigma_mps is not None
        rate += noise.range_rate_sigma_mps * streams.normal("rate", T, S)
    toa = plan.sampling.rows == "toa"
    m = S if toa else ends.shape[-2]
    wrong = None
    if outliers.row > 0.0 or any(outliers.station.values()):
        wrong = streams.uniform("gross", T, 6, max(S, m))
        p = np.array([outliers.station.get(name, 0.0) for name in plan.station_names])
        arrival += gross(wrong[:, :, 0:3, :S], p, size, outliers.late)
        rate += gross(wrong[:, :, [0, 2, 1], :S], p, rate_size, False)
    rows = arrival if toa else difference(arrival, ends)
    rates = rate if toa else difference(rate, ends)
    if noise.tdoa_sigma_s is not None:
        rows = rows + noise.tdoa_sigma_s * streams.normal("row", T, m)
    if wrong is not None:
        rows = rows + gross(wrong[:, :, 3:6, :m], outliers.row, size, outliers.late)
        rates = rates + gross(wrong[:, :, [3, 5, 4], :m], outliers.row, rate_size, False)
    return np.concatenate([rows, rates], axis=-1) if rated else rows


def gauss_markov(unit: Array, times: Array, time_constant: float) -> Array:
    """Return stationary Gauss-Markov processes (n, T, S) of variance 1 at `times` (n, T)."""
    rho = np.exp(-np.diff(times, axis=-1) / time_constant)[..., None]
    x = np.array(unit)
    for k in range(1, times.shape[-1]):
        step = rho[:, k - 1]
        x[:, k] = step * x[:, k - 1] + np.sqrt(1.0 - step**2) * x[:, k]
    return x


def gross(uniform: Array, p: Array | float, size: float, late: bool) -> Array:
    """Return errors of 0.5 to 1.5 times `size` with probability `p`, else zero.

    Parameters
    ----------
    uniform : (n, T, 3, m)
        Uniform numbers: whether, how large, and to which side.
    p : float or (m,)
        Probability.
    size : float
        Size of an error.
    late : bool
        Whether all are positive.
    """
    hit, large, side = uniform[:, :, 0], uniform[:, :, 1], uniform[:, :, 2]
    sign = np.where(late | (side < 0.5), 1.0, -1.0)
    return np.where(hit < p, sign * size * (0.5 + large), 0.0)


def _sizes(plan: Scenario) -> tuple[float, float]:
    outliers, noise = plan.outliers, plan.noise
    size = outliers.size_s
    if size is None:
        size = (noise.toa_sigma_s or noise.tdoa_sigma_s or 0.0) * (outliers.size_sigmas or 0.0)
    return size, outliers.range_rate_size_mps or 0.0


def missing(plan: Scenario, streams: Streams, times: Array, ends: Index) -> Mask:
    """Return which rows (n, T, m) do not arrive; arguments as for `errors`."""
    n, T = times.shape
    S, drop = len(plan.stations), plan.dropouts
    toa = plan.sampling.rows == "toa"
    m = S if toa else ends.shape[-2]
    repeat = 2 if plan.sampling.range_rate else 1
    if not (drop.row or drop.scan or any(drop.station.values()) or drop.silences):
        return np.zeros((n, T, repeat * m), dtype=bool)
    u = streams.uniform("lost", T, 1 + S + m)
    p = np.array([drop.station.get(name, 0.0) for name in plan.station_names])
    deaf: Mask = (u[:, :, :1] < drop.scan) | (u[:, :, 1 : 1 + S] < p)
    for silence in drop.silences:
        begin = -np.inf if silence.from_s is None else silence.from_s
        end = np.inf if silence.to_s is None else silence.to_s
        deaf[..., plan.station_names.index(silence.station)] |= (times >= begin) & (times <= end)
    lost: Mask = deaf
    if not toa:
        pairs = np.broadcast_to(ends, (n, T, m, 2))
        both = np.take_along_axis(deaf[:, :, None, :], pairs.reshape(n, T, 1, 2 * m), axis=-1)
        lost = np.asarray(both.reshape(n, T, m, 2).any(axis=-1))
    lost = lost | (u[:, :, 1 + S :] < drop.row)
    return np.concatenate([lost] * repeat, axis=-1)
