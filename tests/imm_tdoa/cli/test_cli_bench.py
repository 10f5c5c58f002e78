"""``imm-tdoa bench``: what it prints, writes and refuses."""

from __future__ import annotations

import json

import pytest
from cli_cases import run, words

from imm_tdoa import bench
from imm_tdoa.bench import Figure, Goal, Measured, Point

FOUND = Measured(
    "streaming",
    "one target",
    (
        Figure("a step", 12.5, "µs per step", 12.0, 14.0, 5),
        Figure("times filterpy", 45.0, "", 44.0, 46.0, 5, Goal(40.0, "at least")),
        Figure("a run", 0.2, "ms", 0.19, 0.21, 5, Goal(0.15)),
    ),
    (Point("targets", 1e6, 0.5, 0.4, 0.6, "one thread"),),
    ("Members: [Extended].",),
)


@pytest.fixture
def measured(monkeypatch):
    """Nothing is measured; what would have been is listed."""
    asked = []

    def instead(only, quick, tell):
        asked.append((tuple(only), quick))
        tell(0, "it")
        yield FOUND

    monkeypatch.setattr(bench, "run", instead)
    return asked


def test_prints_and_writes(tmp_path, measured):
    code, text = run("bench", "--only", "streaming", "--quick", "--out", tmp_path / "out")
    assert code == 0
    assert measured == [(("streaming",), True)]
    said = words(text)
    assert "streaming: one target" in said
    assert "times filterpy 45.0 44.0 46.0 5 at least 40 met" in said
    assert "a run 0.200 ms 0.190 0.210 5 at most 0.15 missed" in said
    assert "1e+06 0.500" in said
    assert "Members: [Extended]." in said
    assert "1 of 2 goals met" in said
    written = json.loads((tmp_path / "out" / "bench.json").read_text(encoding="utf-8"))
    assert written["machine"]["quick"] is True
    assert {"figures.csv", "points.csv", "goals.png", "scaling.png"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }


def test_measures_everything_by_default(tmp_path, measured):
    assert run("bench", "--out", tmp_path)[0] == 0
    assert measured == [((), False)]


def test_what_was_measured_before_a_failure_is_written(tmp_path, monkeypatch):
    def breaks(only, quick, tell):
        yield FOUND
        raise ValueError("a fresh process failed")

    monkeypatch.setattr(bench, "run", breaks)
    code, text = run("bench", "--out", tmp_path)
    assert code != 0
    assert "a fresh process failed" in words(text)
    written = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert [m["name"] for m in written["measurements"]] == [FOUND.name]


def test_a_folder_that_cannot_be_made_is_refused_before_measuring(tmp_path, measured):
    (tmp_path / "file").touch()
    code, text = run("bench", "--out", tmp_path / "file" / "out")
    assert code != 0
    assert "out" in words(text)
    assert measured == []


def test_says_when_others_compute(tmp_path, measured, monkeypatch):
    from imm_tdoa.bench import machine

    monkeypatch.setattr(machine, "load", lambda: 100.0)
    assert "others are computing" in run("bench", "--out", tmp_path)[1]
    monkeypatch.setattr(machine, "load", lambda: 0.0)
    assert "others are computing" not in run("bench", "--out", tmp_path)[1]


def test_every_part_can_be_asked_for(tmp_path, measured):
    every = [part for name in bench.MEASUREMENTS for part in ("--only", name)]
    assert run("bench", *every, "--out", tmp_path)[0] == 0
    assert measured == [(tuple(bench.MEASUREMENTS), False)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--only", "speed"), "'--only': 'speed' is not one of 'batch', 'streaming'"),
        (("--out", "{file}"), "expected a folder"),
    ],
)
def test_refuses(tmp_path, measured, arguments, message):
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    code, text = run("bench", *(a.format(file=file) for a in arguments))
    assert code == 2
    assert message in words(text)
    assert text.strip().startswith("imm-tdoa: error:")
    assert len(text.strip().splitlines()) == 1
    assert not measured


def test_help_teaches():
    code, text = run("bench", "--help")
    assert code == 0
    for name in bench.MEASUREMENTS:
        assert name in text
    assert "imm-tdoa bench --only batch" in words(text)
