"""Tidy tables of a study: one row per figure, in CSV and, where pyarrow is there, Parquet."""

from __future__ import annotations

import csv
import importlib.util
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from imm_tdoa.recording import _atomic
from imm_tdoa.study.results.statistics import share_error

Columns = Mapping[str, NDArray[Any]]


def tables(data: xr.Dataset) -> dict[str, Columns]:
    """Return all tables of a study by name; those without rows are left out."""
    every = {
        "summary": _columns(_summary(data)),
        "pairs": _columns(_pairs(data)),
        "by_time": _by_time(data),
        "modes_by_time": _modes_by_time(data),
        "choices": _columns(_choices(data)),
        "cost": _columns(_cost(data)),
    }
    return {name: columns for name, columns in every.items() if columns}


def _columns(rows: list[dict[str, Any]]) -> Columns:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}


def _point(data: xr.Dataset, scenario: int) -> dict[str, Any]:
    """Name of a scenario and its swept parameters, numbers where all of them are."""
    row: dict[str, Any] = {"scenario": str(data["scenario"].values[scenario])}
    for k, name in enumerate(data["scenario_parameter"].values):
        numeric = bool(np.isfinite(data["scenario_value"].values[:, k]).all())
        column = data["scenario_value" if numeric else "scenario_point"].values
        row[str(name)] = column[scenario, k].item()
    return row


def _summary(data: xr.Dataset) -> list[dict[str, Any]]:
    plain = ("scenario", "bank")
    skipped = {"place", "letters", "seconds_per_step"}
    names = [
        str(name)
        for name, values in data.items()
        if values.dims == plain
        and name not in skipped
        and not str(name).endswith(("_low", "_high"))
    ]
    nothing = np.full(tuple(data.sizes[axis] for axis in plain), np.nan)
    default = xr.DataArray(nothing, dims=plain)
    ends = {
        name: [data.get(name + end, default).values for end in ("_low", "_high")] for name in names
    }
    values = {name: data[name].values for name in names}
    units = {name: str(data[name].attrs["units"]) for name in names}
    place, letters = data["place"].values, data["letters"].values
    rows = []
    for i in range(data.sizes["scenario"]):
        point = _point(data, i)
        for b, bank in enumerate(data["bank"].values):
            for name in names:
                low, high = ends[name]
                rows.append(
                    {
                        **point,
                        "bank": str(bank),
                        "place": int(place[i, b]),
                        "letters": str(letters[i, b]),
                        "metric": name,
                        "unit": units[name],
                        "value": values[name][i, b].item(),
                        "low": low[i, b].item(),
                        "high": high[i, b].item(),
                    }
                )
    return rows


def _pairs(data: xr.Dataset) -> list[dict[str, Any]]:
    banks = data["bank"].values
    figures = {
        "rmse_ratio": data["rmse_ratio"].values,
        "low": data["rmse_ratio_low"].values,
        "high": data["rmse_ratio_high"].values,
        "p": data["p"].values,
        "p_holm": data["p_holm"].values,
        "told_apart": data["different"].values.astype(int),
    }
    rows = []
    for i in range(data.sizes["scenario"]):
        point = _point(data, i)
        for a, bank in enumerate(banks):
            for b in range(a + 1, len(banks)):
                pair = {"bank": str(bank), "other": str(banks[b])}
                found = {name: values[i, a, b].item() for name, values in figures.items()}
                rows.append({**point, **pair, **found})
    return rows


def _by_time(data: xr.Dataset) -> Columns:
    """Errors and NEES at every scan, scenario by scenario and bank by bank."""
    shape = tuple(data.sizes[axis] for axis in ("scenario", "bank", "time"))
    there = np.broadcast_to(np.isfinite(data["time_s"].values)[:, None], shape)

    def column(name: str) -> NDArray[Any]:
        values = data[name].values
        return np.asarray(np.broadcast_to(values if values.ndim == 3 else values[:, None], shape))

    columns = {
        "scenario": np.broadcast_to(data["scenario"].values[:, None, None], shape)[there],
        "bank": np.broadcast_to(data["bank"].values[:, None], shape)[there],
        "time_s": column("time_s")[there],
    }
    for name, source in (
        ("position_rmse_m", "position_rmse_by_time"),
        ("velocity_rmse_mps", "velocity_rmse_by_time"),
        ("nees_ratio", "nees_ratio_by_time"),
    ):
        for end in ("", "_low", "_high"):
            columns[name + end] = column(source + end)[there]
    columns["gdop"] = column("gdop_by_time")[there]
    columns["position_bound_m"] = column("position_bound_by_time")[there]
    return columns


def _modes_by_time(data: xr.Dataset) -> Columns:
    """Mode probabilities at every scan, of banks of several modes."""
    axes = ("scenario", "bank", "time", "mode")
    shape = tuple(data.sizes[axis] for axis in axes)
    modes = data["mode_name"].values
    several = (modes != "").sum(axis=1) > 1
    named = (modes != "") & several[:, None]
    known = np.isfinite(data["time_s"].values)
    there = known[:, None, :, None] & named[None, :, None, :]
    if not there.any():
        return {}
    names = data["scenario"].values[:, None, None, None], data["bank"].values[:, None, None]
    return {
        "scenario": np.broadcast_to(names[0], shape)[there],
        "bank": np.broadcast_to(names[1], shape)[there],
        "time_s": np.broadcast_to(data["time_s"].values[:, None, :, None], shape)[there],
        "mode": np.broadcast_to(modes[:, None, :], shape)[there],
        "probability": data["mode_probability"].values[there],
    }


def _choices(data: xr.Dataset) -> list[dict[str, Any]]:
    """Which mode had most of the probability, and which model each criterion chose."""
    rows = []
    for i in range(data.sizes["scenario"]):
        for b, bank in enumerate(data["bank"].values):
            for j, mode in enumerate(data["mode_name"].values[b]):
                if mode and np.isfinite(data["selected"].values[i, b, j]):
                    rows.append(_choice(data, "selected", (i, b, j), f"{bank}", f"{mode}"))
        for c, criterion in enumerate(data["criterion"].values if "chosen" in data else ()):
            for m, bank in enumerate(data["candidate_name"].values[c]):
                if bank:
                    rows.append(_choice(data, "chosen", (i, c, m), f"{criterion}", f"{bank}"))
    return rows


def _choice(
    data: xr.Dataset, name: str, at: tuple[int, int, int], by: str, what: str
) -> dict[str, Any]:
    share, runs = data[name].values[at].item(), data["runs_done"].values[at[0]]
    return {
        **_point(data, at[0]),
        "by": by,
        "kind": "mode of a bank" if name == "selected" else "criterion",
        "chosen": what,
        "share": share,
        "low": data[f"{name}_low"].values[at].item(),
        "high": data[f"{name}_high"].values[at].item(),
        "standard_error": float(share_error(share * runs, runs)),
    }


def _cost(data: xr.Dataset) -> list[dict[str, Any]]:
    return [
        {
            "scenario": str(scenario),
            "bank": str(bank),
            "seconds_per_step": data["seconds_per_step"].values[i, b].item(),
        }
        for i, scenario in enumerate(data["scenario"].values)
        for b, bank in enumerate(data["bank"].values)
    ]


def write(folder: Path, name: str, columns: Columns) -> list[str]:
    """Write one table; return the names of its files."""
    return stream(folder, name, [columns])


def stream(folder: Path, name: str, parts: Iterable[Columns]) -> list[str]:
    """Write a table that comes in parts, each part in memory at a time; return its files.

    Numbers are written so that they read back exactly, a missing one as nothing.
    """
    files = [f"{name}.csv"]
    with ExitStack() as stack:
        draft = stack.enter_context(_atomic.file(folder / files[0]))
        text = stack.enter_context(draft.open("w", encoding="utf-8", newline=""))
        out = csv.writer(text, lineterminator="\n")
        parquet: Any = None
        if importlib.util.find_spec("pyarrow") is not None:
            files.append(f"{name}.parquet")
            parquet = stack.enter_context(_atomic.file(folder / files[1]))
        writer: Any = None
        for number, columns in enumerate(parts):
            if number == 0:
                out.writerow(columns)
            out.writerows(zip(*(_cells(values) for values in columns.values()), strict=True))
            if parquet is not None:
                writer = _append(stack, parquet, writer, columns)
    return files


def _cells(values: NDArray[Any]) -> list[Any]:
    cells: list[Any] = values.tolist()
    if values.dtype.kind == "f":
        return ["" if cell != cell else repr(cell) for cell in cells]
    return cells


def _append(stack: ExitStack, path: Path, writer: Any, columns: Columns) -> Any:
    import pyarrow
    from pyarrow import parquet

    table = pyarrow.table(
        {
            name: pyarrow.array(values, mask=np.isnan(values))
            if values.dtype.kind == "f"
            else pyarrow.array(values.tolist())
            for name, values in columns.items()
        }
    )
    if writer is None:
        writer = stack.enter_context(parquet.ParquetWriter(path, table.schema))
    writer.write_table(table)
    return writer
