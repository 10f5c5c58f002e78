"""Tables and pictures of what was measured, as files."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from imm_tdoa.bench import machine, pictures
from imm_tdoa.bench.measured import Measured
from imm_tdoa.recording import _atomic

FIGURES = ("measurement", "what", "value", "unit", "low", "high", "repetitions", "again")
GOALS = ("goal", "limit", "verdict")
POINTS = ("against", "x", "cost_us", "low_us", "high_us", "curve")


def write(found: Sequence[Measured], about: Mapping[str, Any], folder: Path) -> list[str]:
    """Write ``figures.csv``, ``points.csv``, ``bench.json`` and the pictures; return their names.

    Parameters
    ----------
    found : sequence of Measured
        What was measured.
    about : mapping
        The machine, as `machine.describe` tells it.
    folder : Path
        Where to; made where it is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = [
        (m.name, f.what, f.value, f.unit, f.low, f.high, f.repetitions, f.again)
        + (("", "", "") if f.goal is None else (f.goal.sense, f.goal.limit, f.verdict))
        for m in found
        for f in m.figures
    ]
    _table(folder / "figures.csv", (*FIGURES, *GOALS), rows)
    files = ["figures.csv", "bench.json"]
    points = [attrs.astuple(p) for m in found for p in m.points]
    if points:
        _table(folder / "points.csv", POINTS, points)
        files.append("points.csv")
    whole = {
        "format": 1,
        "machine": dict(about),
        "measurements": [_plain(m) for m in found],
    }
    with _atomic.file(folder / "bench.json") as draft:
        text = json.dumps(whole, indent=2, ensure_ascii=False, allow_nan=False)
        draft.write_text(text + "\n", encoding="utf-8", newline="\n")
    stamp = machine.in_words(dict(about))
    drawn = {"goals.png": pictures.goals, "costs.png": pictures.costs}
    for name, draw in {**drawn, "scaling.png": pictures.scaling}.items():
        if draw(found, stamp, folder / name):
            files.append(name)
    return sorted(files)


def _plain(measured: Measured) -> dict[str, Any]:
    result = attrs.asdict(measured)
    for row, figure in zip(result["figures"], measured.figures, strict=True):
        row["verdict"] = figure.verdict or None
    return result


def _table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    with _atomic.file(path) as draft, draft.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
