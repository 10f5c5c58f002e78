"""What fixes with uncertain receivers are given: checked, named where wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import registry
from imm_tdoa._validate import array
from imm_tdoa.contract import MeasurementModel
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations


def checked(
    stations: Stations,
    tdoa: Any,
    *,
    toa_sigma: Any,
    tdoa_sigma: Any,
    pairs: Any,
    speed: float,
    range_rate: Any,
    range_rate_sigma: Any,
    time: Any,
) -> Scans:
    """Return the fixes (...) that the arguments ask for as scans, one each: values (..., 1, m).

    Parameters
    ----------
    stations, tdoa, toa_sigma, tdoa_sigma, pairs, speed, range_rate, range_rate_sigma, time
        As of `joint`.

    Raises
    ------
    ValueError
        Arguments that do not fit, named.
    """
    measurement: MeasurementModel = registry.load("tdoa")(
        stations, toa_sigma=toa_sigma, tdoa_sigma=tdoa_sigma, pairs=pairs, speed=speed
    )
    values = array("tdoa", tdoa, (None, measurement.size), finite=False)
    if (range_rate is None) != (range_rate_sigma is None):
        raise ValueError("range_rate: give range_rate and range_rate_sigma together")
    if range_rate is not None:
        rates = array("range_rate", range_rate, values.shape, finite=False)
        other = registry.load("fdoa")(stations, range_rate_sigma=range_rate_sigma, pairs=pairs)
        measurement = registry.load("stack")(measurement, other)
        values = np.concatenate([values, rates], axis=-1)
    times = array("time", time)
    try:
        times = np.broadcast_to(times, values.shape[:-1])
    except ValueError:
        raise ValueError(
            f"time: expected one time, or as many as there are fixes, {values.shape[:-1]}; "
            f"got {times.shape}"
        ) from None
    if values.size == 0:
        raise ValueError("tdoa: expected at least one fix, got a batch of none")
    return Scans(measurement, times[..., None], values[..., None, :])


def refuse_too_few(stations: Stations, needed: int, method: str) -> None:
    """Refuse fewer stations than a method can ever locate with.

    Parameters
    ----------
    stations : Stations
        The receivers.
    needed : int
        The fewest.
    method : str
        What the message calls it.

    Raises
    ------
    ValueError
        There are fewer.
    """
    if len(stations) < needed:
        raise ValueError(
            f"stations: {method} needs at least {needed} in {stations.dims} dimensions, "
            f"got {len(stations)}"
        )
