"""Writing tracks: as a table, and as lines on a map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import AXES, Array
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.recording import _atomic, geo
from imm_tdoa.recording.files import FORMATS
from imm_tdoa.recording.table import Table
from imm_tdoa.track import Track


def write_track(
    path: str | Path, tracks: Mapping[str, Track], frame: EastNorthUp | None = None
) -> None:
    """Write tracks as one table, target by target.

    Columns: ``time_s, target, x_m, y_m[, z_m]``, the velocity ``vx_mps …`` where the bank has
    one, standard deviations of both ``sx_m … svx_mps …``, ``p_<mode>`` per mode, ``nis`` (empty
    where nothing was taken in), and ``lat_deg, lon_deg, height_m`` with a `frame`.

    Parameters
    ----------
    path : path
        A ``.csv`` or ``.parquet`` file; replaced whole or not at all.
    tracks : mapping of str to Track
        One track, without batch axes, per target. Rows before its start (NaN) are left out.
    frame : EastNorthUp, optional
        Where on the Earth the axes are; a track in two dimensions runs at z = 0.

    Raises
    ------
    ValueError
        No tracks, tracks of different banks or dimensions, batches, another suffix.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise ValueError(f"path: expected a name that ends in .csv or .parquet, got {path.name!r}")
    table = track_table(tracks, frame)
    with _atomic.file(path) as draft:
        FORMATS[kind].write(draft, table)


def track_table(tracks: Mapping[str, Track], frame: EastNorthUp | None = None) -> Table:
    """Return what `write_track` writes."""
    _check(tracks)
    parts = [_columns(name, track, frame) for name, track in tracks.items()]
    return Table({key: np.concatenate([part[key] for part in parts]) for key in parts[0]})


def write_geojson(path: str | Path, tracks: Mapping[str, Track], frame: EastNorthUp) -> None:
    """Write tracks as GeoJSON (RFC 7946): a line per target, its times in the properties.

    Coordinates are longitude and latitude, degrees, and the height above the WGS84 ellipsoid, m;
    a line is cut at the 180th meridian. A track in two dimensions runs at z = 0.

    Parameters
    ----------
    path : path
        File to write; replaced whole or not at all.
    tracks : mapping of str to Track
        One track, without batch axes, per target.
    frame : EastNorthUp
        Where on the Earth the axes are.

    Raises
    ------
    ValueError
        No frame, no tracks, batches.
    """
    _write_map(path, tracks, frame, geo.geojson)


def write_kml(path: str | Path, tracks: Mapping[str, Track], frame: EastNorthUp) -> None:
    """Write tracks as KML: a line per target.

    A track in three dimensions has its heights above the WGS84 ellipsoid as absolute altitudes;
    programs that count altitudes from the sea draw it off by the geoid's height there (up to
    100 m). A track in two dimensions lies on the ground.

    Parameters
    ----------
    path : path
        File to write; replaced whole or not at all.
    tracks : mapping of str to Track
        One track, without batch axes, per target.
    frame : EastNorthUp
        Where on the Earth the axes are.

    Raises
    ------
    ValueError
        No frame, no tracks, batches.
    """
    _write_map(path, tracks, frame, geo.kml)


def _write_map(
    path: str | Path, tracks: Mapping[str, Track], frame: EastNorthUp, render: Any
) -> None:
    if not isinstance(frame, EastNorthUp):
        raise ValueError(f"frame: a map needs an EastNorthUp frame, got {frame!r}")
    _check(tracks)
    paths = []
    for name, track in tracks.items():
        rows = _rows(track)
        place = np.stack(_geodetic(track.position[rows], frame), axis=-1)
        paths.append(geo.Path(name, track.times[rows], place, track.space.dims == 3))
    with _atomic.file(Path(path)) as draft:
        draft.write_text(render(paths), encoding="utf-8", newline="\n")


def _check(tracks: Mapping[str, Track]) -> None:
    if not tracks:
        raise ValueError("tracks: expected at least one track, got none")
    first = next(iter(tracks.values()))
    for name, track in tracks.items():
        if track.mean.ndim != 2 or track.times.ndim != 1:
            raise ValueError(
                f"tracks: expected one track per target, that of {name!r} is a batch of shape "
                f"{track.mean.shape[:-2]}"
            )
        if (track.modes, track.components) != (first.modes, first.components):
            raise ValueError(
                f"tracks: expected tracks of one bank, that of {name!r} has modes "
                f"{', '.join(track.modes)} of {', '.join(track.components)}, the first "
                f"{', '.join(first.modes)} of {', '.join(first.components)}"
            )


def _rows(track: Track) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(track.mean).all(axis=-1))


def _geodetic(position: Array, frame: EastNorthUp) -> tuple[Array, Array, Array]:
    """Latitude, longitude and height; axes that a track does not have are zero."""
    lacking = np.zeros((len(position), 3 - position.shape[1]))
    return frame.to_geodetic(np.concatenate([position, lacking], axis=1))


def _columns(name: str, track: Track, frame: EastNorthUp | None) -> dict[str, NDArray[Any]]:
    rows = _rows(track)
    axes = AXES[: track.space.dims]
    units = {axis: f"{axis}_m" for axis in axes}
    if f"v{axes[0]}" in track.components:
        units |= {f"v{axis}": f"v{axis}_mps" for axis in axes}
    index = {c: track.components.index(c) for c in units}
    columns: dict[str, NDArray[Any]] = {
        "time_s": track.times[rows],
        "target": np.full(np.count_nonzero(rows), name),
    }
    columns |= {units[c]: track.mean[rows, i] for c, i in index.items()}
    columns |= {f"s{units[c]}": np.sqrt(track.covariance[rows, i, i]) for c, i in index.items()}
    for j, mode in enumerate(track.modes):
        columns[f"p_{mode}"] = track.mode_probability[rows, j]
    columns["nis"] = track.nis[rows]
    if frame is not None:
        place = _geodetic(track.position[rows], frame)
        columns |= dict(zip(("lat_deg", "lon_deg", "height_m"), place, strict=True))
    return columns
