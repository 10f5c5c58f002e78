"""One epoch: the Cramér-Rao bound of a fix, and dilution of precision."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import gaussian, registry
from imm_tdoa._validate import array
from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.geometry import ranges
from imm_tdoa.locate.normal import inverse
from imm_tdoa.stations import Stations


def crlb(
    stations: Stations,
    position: Any,
    *,
    toa_sigma: Any = None,
    tdoa_sigma: Any = None,
    pairs: Any = "reference",
    velocity: Any = None,
    range_rate_sigma: Any = None,
    speed: float = 299792458.0,
    time: float = 0.0,
) -> Array:
    """Cramér-Rao lower bound of one epoch's fix (ALGORITHMS §3.6).

    Receiver errors declared in `stations` are included: the bound is then
    (J' (Q + J_s Q_s J_s')^-1 J)^-1 for errors of each epoch's own.

    Parameters
    ----------
    stations : Stations
        The receivers.
    position : (..., d)
        True position, m.
    toa_sigma, tdoa_sigma : float or array
        Exactly one: standard deviation per arrival or per difference, s.
    pairs : "reference", "adjacent" or (m, 2)
        Differences that are measured; with `toa_sigma` every spanning set gives the same.
    velocity : (..., d), optional
        True velocity, m/s; with `range_rate_sigma` the bound covers position and velocity.
    range_rate_sigma : float or (S,), optional
        Standard deviation of the range rate per station, m/s.
    speed : float
        Signal speed, m/s.
    time : float
        When, for moving stations, s.

    Returns
    -------
    (..., d, d) or (..., 2d, 2d)
        Covariance bound, m² (and m²/s, m²/s²).

    Raises
    ------
    ValueError
        Arguments that do not fit; a geometry that determines no position.
    """
    p = array("position", position, (None, stations.dims))
    if (velocity is None) != (range_rate_sigma is None):
        raise ValueError("velocity: give velocity and range_rate_sigma together")
    measurement: MeasurementModel = registry.load("tdoa")(
        stations, toa_sigma=toa_sigma, tdoa_sigma=tdoa_sigma, pairs=pairs, speed=speed
    )
    v = np.zeros_like(p)
    if velocity is not None:
        v = array("velocity", velocity, p.shape)
        fdoa = registry.load("fdoa")(stations, range_rate_sigma=range_rate_sigma, pairs=pairs)
        measurement = registry.load("stack")(measurement, fdoa)
    information = fisher_information(measurement, p, v, time)
    if velocity is None:
        information = information[..., : stations.dims, : stations.dims]
    result, regular = inverse(information)
    if not np.all(regular):
        where = np.broadcast_to(p, (*regular.shape, stations.dims))[~regular][0]
        raise ValueError(
            f"stations: these {len(stations)} stations do not determine the position of an "
            f"emitter at {where.tolist()} (too few of them hear it, or they stand in a line or "
            f"plane with it)"
        )
    return result


def fisher_information(
    measurement: MeasurementModel,
    position: Array,
    velocity: Array,
    time: float | Array,
    present: Mask | None = None,
) -> Array:
    """Information (..., 2d, 2d) that one scan of any measurement model carries.

    About position and velocity; rows of stations not heard then are left out, shared offsets
    are eliminated, redundant rows dropped.

    Parameters
    ----------
    measurement : MeasurementModel
        What is measured.
    position, velocity : (..., d)
        Of the emitter, m and m/s.
    time : float or (...)
        When, s.
    present : (..., m) bool, optional
        Rows that arrive; default all.
    """
    R = measurement.noise_covariance(position, velocity, time)
    H = np.concatenate(measurement.jacobian(position, velocity, time), axis=-1)
    heard = np.asarray(np.isfinite(H).all(axis=-1))
    if present is not None:
        heard = heard & present
    batch = heard.shape[:-1]
    R = np.broadcast_to(R, (*batch, *R.shape[-2:]))
    present = measurement.independent(heard)
    variance = np.einsum("...ii->...i", R)
    T, left = gaussian.offset_contrast(variance, present, measurement.offset_group)
    both = present[..., :, None] & present[..., None, :]
    H = T @ np.where(present[..., None], H, 0.0)
    R = T @ np.where(both, R, 0.0) @ np.swapaxes(T, -1, -2)
    _, H, R = gaussian.mask_rows(np.zeros(left.shape), H, R, left)
    J = np.linalg.solve(gaussian.factor(R, "noise covariance"), H)
    result: Array = np.swapaxes(J, -1, -2) @ J
    return result


def gdop(stations: Stations, positions: Any, *, time: float = 0.0) -> Array:
    """Geometric dilution of precision: position error per range error, dimensionless.

    sqrt(trace C) with C the bound for arrival times of unit standard deviation (in metres) at
    every station, their common emission time unknown. Infinite where the stations determine no
    position.

    Parameters
    ----------
    stations : Stations
        The receivers.
    positions : (..., d)
        Where, m.
    time : float
        When, for moving stations, s.
    """
    p = array("positions", positions, (None, stations.dims))
    s, _ = stations.at(time)
    heard = np.asarray(np.isfinite(s).all(axis=-1))
    _, u = ranges(p, s[heard])
    u = u - np.sum(u, axis=-2, keepdims=True) / max(np.count_nonzero(heard), 1)
    C, regular = inverse(np.swapaxes(u, -1, -2) @ u)
    result: Array = np.sqrt(np.where(regular, np.einsum("...ii->...", C), np.inf))
    return result
