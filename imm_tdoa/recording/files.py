"""Recording folders: reading and writing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import attrs

from imm_tdoa import _structure
from imm_tdoa.recording import _atomic, _csv, _parquet, receivers, schema, settings
from imm_tdoa.recording.recording import Recording
from imm_tdoa.recording.settings import FILE
from imm_tdoa.recording.table import Table

FORMATS: dict[str, ModuleType] = {"csv": _csv, "parquet": _parquet}
STATIONS = "stations"
ORIGIN = ("lat_deg", "lon_deg", "height_m")


def read(folder: str | Path) -> Recording:
    """Read a recording folder.

    Parameters
    ----------
    folder : path
        Holds ``recording.toml``, ``stations.csv`` and at least one of ``tdoa.csv``, ``toa.csv``,
        ``fdoa.csv`` and ``range_rate.csv``; ``height.csv`` and ``truth.csv`` where there are
        any. Each table may be ``.parquet`` instead. Other files and ``extra/`` are ignored.

    Raises
    ------
    ValueError
        ``file:line: column: what``: what breaks the format, and where. In Parquet tables the
        line is the row, counted from 1.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"folder: expected a recording folder, there is none at {str(folder)!r}")
    try:
        return _read(folder)
    except OSError as error:
        name = Path(error.filename).name if error.filename else str(folder)
        raise ValueError(f"{name}: cannot be read: {error.strerror or error}") from error


def _read(folder: Path) -> Recording:
    if not (folder / FILE).exists():
        raise ValueError(f"{FILE}: missing in {str(folder)!r}")
    given = settings.parse(_structure.read(folder / FILE))
    frame = given.frame.axes()
    station_rows = _table(folder, STATIONS, schema.station_columns)
    if station_rows is None:
        raise ValueError(f"{STATIONS}.csv: missing in {str(folder)!r} (or {STATIONS}.parquet)")
    stations = receivers.from_table(station_rows, given.dims, frame)
    axes = given.truth.axes
    flat = axes is not None and "z" not in axes

    def columns(name: str) -> Callable[[Iterable[str]], Any]:
        return lambda _: schema.columns(name, stations.dims, flat_truth=flat)

    tables = {name: _table(folder, name, columns(name)) for name in schema.TABLES}
    if all(tables[name] is None for name in schema.MEASURED):
        expected = ", ".join(f"{name}.csv" for name in schema.MEASURED)
        raise ValueError(
            f"recording: nothing measured in {str(folder)!r}; expected at least one of {expected}"
        )
    return Recording(
        stations,
        title=given.title,
        speed_mps=given.speed_mps,
        labelled=given.labelled,
        frame=frame,
        noise=given.noise,
        truth_scoring=given.truth,
        source=given.source,
        notes=given.notes,
        **tables,
    )


def _table(folder: Path, name: str, wanted: Callable[[Iterable[str]], Any]) -> Table | None:
    paths = {kind: folder / f"{name}.{kind}" for kind in FORMATS}
    there = [kind for kind, path in paths.items() if path.exists()]
    if len(there) > 1:
        both = " and ".join(paths[kind].name for kind in there)
        raise ValueError(f"{both}: expected one of them, not both")
    if not there:
        return None
    table: Table = FORMATS[there[0]].read(paths[there[0]], wanted)
    return table


def write(
    recording: Recording,
    folder: str | Path,
    *,
    tables: Literal["csv", "parquet"] = "csv",
    overwrite: bool = False,
) -> None:
    """Write a recording folder, whole or not at all, that `read` reads back exactly.

    Parameters
    ----------
    recording : Recording
        What to write.
    folder : path
        Where; it is made where it does not exist.
    tables : "csv" or "parquet"
        Format of the tables; Parquet needs pyarrow.
    overwrite : bool
        Whether an older recording in the folder may be replaced. Its other files stay.

    Raises
    ------
    ValueError
        A folder that is not empty (with `overwrite`: that is no recording), stations or notes
        that the format has no place for.
    """
    if tables not in FORMATS:
        raise ValueError(f"tables: expected 'csv' or 'parquet', got {tables!r}")
    folder = Path(folder)
    _refuse_occupied(folder, overwrite)
    text = settings.dumps(_settings(recording))
    found = {name: getattr(recording, name) for name in schema.TABLES}
    found = {STATIONS: receivers.to_table(recording.stations), **found}
    with _atomic.folder(folder, _is_ours) as draft:
        (draft / FILE).write_text(text, encoding="utf-8", newline="\n")
        for name, table in found.items():
            if table is not None:
                FORMATS[tables].write(draft / f"{name}.{tables}", table)


def _refuse_occupied(folder: Path, overwrite: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder: expected a folder, {str(folder)!r} is a file")
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not overwrite:
        raise ValueError(f"folder: {str(folder)!r} is not empty; overwrite=True replaces it")
    if not (folder / FILE).exists():
        raise ValueError(
            f"folder: {str(folder)!r} is not empty and no recording: it has no {FILE}; it is "
            f"left as it is"
        )


def _is_ours(name: str) -> bool:
    return name == FILE or name in {f"{t}.{k}" for t in (STATIONS, *schema.TABLES) for k in FORMATS}


def _settings(recording: Recording) -> dict[str, Any]:
    """What ``recording.toml`` says of a recording."""
    data: dict[str, Any] = {
        "format": settings.FORMAT,
        "title": recording.title,
        "speed_mps": recording.speed_mps,
        "dims": recording.dims,
        "labelled": recording.labelled,
        "frame": {"kind": "local"},
    }
    if recording.frame is not None:
        origin = {name: getattr(recording.frame, name) for name in ORIGIN}
        data["frame"] = {"kind": "enu"} | {f"origin_{k}": v for k, v in origin.items()}
    sections = {
        "noise": attrs.asdict(recording.noise),
        "truth": attrs.asdict(recording.truth_scoring),
    }
    for key, section in sections.items():
        given = {k: v for k, v in section.items() if v is not None}
        data |= {key: given} if given else {}
    free = {"source": recording.source, "notes": recording.notes}
    return data | {key: dict(value) for key, value in free.items() if value}
