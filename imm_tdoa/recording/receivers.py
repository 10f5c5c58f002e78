"""The stations table: fixed, moving, or in latitude and longitude."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.recording import checks, schema
from imm_tdoa.recording.settings import FILE
from imm_tdoa.recording.table import Table
from imm_tdoa.stations import Stations


def from_table(table: Table, dims: int | None, frame: EastNorthUp | None) -> Stations:
    """Return the stations of a table, in the order in which they first appear.

    Parameters
    ----------
    table : Table
        With the columns of `schema.station_columns`.
    dims : int or None
        Number of space dimensions that the recording says it has.
    frame : EastNorthUp or None
        The frame that latitudes and longitudes are turned into.

    Raises
    ------
    ValueError
        A station twice (moving: twice at one time, or times that decrease), coordinates that
        are no finite numbers or do not fit `dims`, latitudes without a frame, stations in one
        place.
    """
    columns = schema.station_columns(table)
    table = schema.check_values(table, columns)
    if "time_s" in table:
        checks.check_increasing(table, "station")
    else:
        checks.refuse_repeated(table, [table["station"].tolist()], "station", "this station")
    position = _positions(table, dims, frame)
    d = position.shape[1]
    speed = [name for name in schema.velocities(d) if name in table]
    velocity = np.stack([table[name] for name in speed], axis=-1) if speed else None
    names = tuple(dict.fromkeys(table["station"].tolist()))
    try:
        if "time_s" not in table:
            return Stations(position, names=names)
        times, k = np.unique(table["time_s"], return_inverse=True)
        number = {name: i for i, name in enumerate(names)}
        s = np.array([number[name] for name in table["station"].tolist()])
        positions = np.full((len(times), len(names), d), np.nan)
        positions[k, s] = position
        velocities = None if velocity is None else np.full_like(positions, np.nan)
        if velocities is not None:
            velocities[k, s] = velocity
        return Stations(positions, velocities=velocities, times=times, names=names)
    except ValueError as error:
        raise ValueError(f"{table.file}: {error}") from error


def _positions(table: Table, dims: int | None, frame: EastNorthUp | None) -> Array:
    if "lat_deg" in table:
        if frame is None:
            raise ValueError(
                f"{table.file}: lat_deg: latitudes need an ENU frame; {FILE} has none "
                f"([frame] kind = 'enu')"
            )
        bad = np.abs(table["lat_deg"]) > 90.0
        if np.any(bad):
            row = int(np.argmax(bad))
            raise ValueError(
                f"{table.place(row, 'lat_deg')}: expected a latitude within ±90, "
                f"got {float(table['lat_deg'][row])!r}"
            )
        enu = frame.from_geodetic(*(table[name] for name in schema.GEODETIC))
        return enu[:, : dims or 3]
    d = 3 if "z_m" in table else 2
    if dims is not None and d != dims:
        wrong = f"z_m: {'a' if d == 3 else 'missing'} column"
        raise ValueError(f"{table.file}: {wrong}, where {FILE} says dims = {dims}")
    return np.stack([table[name] for name in schema.positions(d)], axis=-1)


def to_table(stations: Stations) -> Table:
    """Return the table of `stations`, as `from_table` reads it.

    Raises
    ------
    ValueError
        Receiver errors, velocities of fixed stations: a recording has no columns for them.
    """
    for name in ("position_covariance", "velocity_covariance"):
        if getattr(stations, name) is not None:
            raise ValueError(f"stations: a recording has no columns for their {name}")
    names = np.array(stations.names, dtype=str)
    d = stations.dims
    if stations.times is None:
        if stations.velocities is not None:
            raise ValueError("stations: a recording has no velocities of stations without times")
        place = dict(zip(schema.positions(d), stations.positions.T, strict=True))
        return _checked({"station": names, **place})
    k, s = np.nonzero(np.isfinite(stations.positions).all(axis=-1))
    unsampled = sorted(set(range(len(stations))) - set(s.tolist()))
    if unsampled:
        raise ValueError(f"stations: {stations.names[unsampled[0]]!r} is nowhere at any time")
    place = dict(zip(schema.positions(d), stations.positions[k, s].T, strict=True))
    columns = {"time_s": stations.times[k], "station": names[s], **place}
    if stations.velocities is not None:
        columns |= dict(zip(schema.velocities(d), stations.velocities[k, s].T, strict=True))
    return _checked(columns)


def _checked(columns: dict[str, Any]) -> Table:
    return schema.check_values(Table(columns, file="stations"), schema.station_columns(columns))
