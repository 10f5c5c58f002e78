"""A small recording as text files, and running the command on it."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from imm_tdoa.cli import app
from imm_tdoa.contract import Array

SPEED = 299792458.0
STATIONS = {
    "a": (0.0, 0.0),
    "b": (4000.0, 300.0),
    "c": (-1500.0, 3500.0),
    "d": (-2500.0, -2800.0),
    "e": (2000.0, -3000.0),
}
TIMES = tuple(2.0 * k for k in range(15))
HEAD = """format = 1
title = "A small one"
speed_mps = 299792458.0
dims = 2
labelled = true

[frame]
kind = "enu"
origin_lat_deg = 47.0
origin_lon_deg = 8.0
origin_height_m = 400.0

[noise]
toa_sigma_s = 1e-9
"""


def run(*arguments: str | Path) -> tuple[int, str]:
    """Return the exit code of ``imm-tdoa arguments`` and all that it printed."""
    result = CliRunner().invoke(app, [str(a) for a in arguments], prog_name="imm-tdoa")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def words(text: str) -> str:
    """Return printed text with white space as single blanks, frames and colours left out."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", text)
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", text).split())


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def assert_drawn(path: Path) -> None:
    """A picture in PNG with something on it."""
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert len(content) > 20_000, f"{path.name}: {len(content)} bytes"


def summary_of(out: Path, files: set[str]) -> dict[str, Any]:
    """Return summary.json of a folder that holds just `files`, as it says; pictures are drawn."""
    assert {f.name for f in out.iterdir()} == files
    for name in files:
        if name.endswith(".png"):
            assert_drawn(out / name)
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text("utf-8"))
    assert set(summary["files"]) == files
    return summary


def path_at(t: Array) -> Array:
    """True positions (T, 2) of the recording's only emitter, m."""
    return np.stack([500.0 + 12.0 * t, -200.0 + 5.0 * t], axis=-1)


def write_recording(
    folder: Path,
    *,
    targets: Sequence[str] = ("ship",),
    times: Sequence[float] = TIMES,
    files: Mapping[str, str] | None = None,
) -> Path:
    """Write a recording of noise-free arrival times; `files` replace or add some."""
    folder.mkdir(parents=True)
    t = np.array(times)
    places = np.array(list(STATIONS.values()))
    toa: list[tuple[float, str]] = []
    truth: list[tuple[float, str]] = []
    for i, name in enumerate(targets):
        for k, (time, p) in enumerate(zip(t + 0.1 * i, path_at(t + 0.1 * i), strict=True)):
            arrival = np.linalg.norm(p - places, axis=-1) / SPEED
            rows = zip(STATIONS, arrival, strict=True)
            toa += [(time, f"{name}{k},{s},{float(a)!r},{name}") for s, a in rows]
            truth.append((time, f"{name},{p[0]},{p[1]},12.0,5.0"))
    stations = ["station,x_m,y_m", *(f"{s},{x},{y}" for s, (x, y) in STATIONS.items())]
    content = {
        "recording.toml": HEAD,
        "stations.csv": "\n".join(stations) + "\n",
        "toa.csv": _table("time_s,emission,station,toa_s,target", toa),
        "truth.csv": _table("time_s,target,x_m,y_m,vx_mps,vy_mps", truth),
        **(files or {}),
    }
    for name, text in content.items():
        if text:
            (folder / name).write_text(text, encoding="utf-8")
    return folder


def _table(header: str, rows: list[tuple[float, str]]) -> str:
    """Rows in the order of their times."""
    ordered = sorted(rows, key=lambda row: row[0])
    return "\n".join([header, *(f"{time},{rest}" for time, rest in ordered)]) + "\n"
