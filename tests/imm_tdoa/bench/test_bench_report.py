"""Tables and pictures of what was measured."""

from __future__ import annotations

import csv
import json

import pytest

from imm_tdoa.bench import machine, report
from imm_tdoa.bench.measured import Figure, Goal, Measured, Point

COSTS = Measured(
    "batch",
    "a batch",
    (
        Figure("filterpy", 600.0, "µs per target-step", 590.0, 640.0, 5),
        Figure("one thread", 0.5, "µs per target-step", 0.45, 0.6, 5),
        Figure("times filterpy", 1200.0, "", 1100.0, 1300.0, 5, Goal(1000.0, "at least")),
        Figure("two threads over one", 1.5, "", 1.4, 1.6, 5, Goal(1.8, "at least")),
        Figure("largest difference", 1e-12, "σ", 1e-12, 1e-12, 1, Goal(1e-6)),
    ),
    notes=("A note.",),
)
GROWTH = Measured(
    "scaling",
    "as it grows",
    (),
    (
        *(Point("targets", x, 0.5, 0.4, 0.6, "one thread") for x in (1e3, 1e6)),
        *(Point("threads", x, 0.5 / x, 0.4 / x, 0.6 / x, "keep='all'") for x in (1, 2)),
    ),
)


def read(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_everything_is_written(tmp_path):
    about = machine.describe()
    files = report.write([COSTS, GROWTH], about, tmp_path / "new" / "folder")
    place = tmp_path / "new" / "folder"
    assert files == sorted(path.name for path in place.iterdir())
    assert files == [
        "bench.json", "costs.png", "figures.csv", "goals.png", "points.csv", "scaling.png",
    ]  # fmt: skip
    rows = read(place / "figures.csv")
    assert [row["verdict"] for row in rows] == ["", "", "met", "missed", "met"]
    assert (rows[0]["value"], rows[0]["unit"]) == ("600.0", "µs per target-step")
    assert (rows[2]["goal"], rows[2]["limit"]) == ("at least", "1000.0")
    points = read(place / "points.csv")
    assert [row["against"] for row in points] == ["targets"] * 2 + ["threads"] * 2
    whole = json.loads((place / "bench.json").read_text(encoding="utf-8"))
    assert whole["machine"]["versions"]["numpy"] == about["versions"]["numpy"]
    assert whole["measurements"][0]["figures"][3]["verdict"] == "missed"
    assert whole["measurements"][0]["notes"] == ["A note."]


@pytest.mark.parametrize(
    ("found", "pictures"),
    [([GROWTH], ["scaling.png"]), ([COSTS], ["costs.png", "goals.png"])],
)
def test_what_was_not_measured_is_not_drawn(tmp_path, found, pictures):
    files = report.write(found, machine.describe(), tmp_path)
    assert [name for name in files if name.endswith(".png")] == pictures
    assert ("points.csv" in files) == bool(found[0].points)


def test_the_machine_in_words():
    about = machine.describe()
    line = machine.in_words(about)
    assert about["versions"]["numba"] in line
    assert about["date"][:10] in line
    assert machine.processors() >= 1
    assert "\n" not in line
