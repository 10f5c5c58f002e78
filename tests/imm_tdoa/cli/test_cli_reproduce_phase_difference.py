"""``imm-tdoa reproduce phase-difference``."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from cli_cases import run, words

from imm_tdoa.reproduce.phase_difference import whole

PNG = b"\x89PNG\r\n\x1a\n"
FILES = {
    "fixes.csv",
    "hypotheses.csv",
    "observation-time.png",
    "over-time.png",
    "over_time.csv",
    "sector.csv",
    "sector.png",
    "single-run.png",
    "speed.png",
    "summary.json",
    "tables.csv",
}


def test_everything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole, "COUNTS", ((6, 9), (8, 7)))
    monkeypatch.setattr(whole, "SPEEDS_MPS", (100.0, 400.0))
    monkeypatch.setattr(whole, "SECTOR_DEG", (10.0, 50.0))
    out = tmp_path / "out"
    arguments = ["--covariance", "diagonal", "--merging", "mahalanobis", "--no-platform-noise"]
    code, text = run(
        "reproduce", "phase-difference", "--runs", "3", "--seed", "5", "--out", out, *arguments
    )
    assert code == 0
    assert {f.name for f in out.iterdir()} == FILES
    for name in FILES:
        if name.endswith(".png"):
            content = (out / name).read_bytes()
            assert content.startswith(PNG)
            assert len(content) > 20_000
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert (summary["runs"], summary["seed"]) == (3, 5)
    assert set(summary["files"]) == FILES
    assert summary["switches"] == {
        "covariance": "diagonal",
        "merging": "mahalanobis",
        "platform_noise": False,
    }
    assert summary["base"]["paper_s"] == 18.0
    said = words(text)
    for part in (
        "Source C, Table 1",
        "Source C, Table 2",
        "phase alone, paper 25.0 30.0 33.0 34.0",
        "both, paper 16.0 18.0 25.0 -",
        "rate alone, paper 20.0 23.0 - -",
        "Not reproduced: phase errors",
        "Not reproduced: the paper's rate alone",
    ):
        assert part in said
    with (out / "tables.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row, found in zip(rows, summary["tables"], strict=True):
        assert row["use"] == found["use"]
        assert float(row["rms_at_end"]) == found["rms_at_end"]


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--runs", "1"], "Invalid value for '--runs'"),
        (["--runs", "many"], "Invalid value for '--runs'"),
        (["--seed", "-1"], "Invalid value for '--seed'"),
        (["--covariance", "full"], "Invalid value for '--covariance'"),
        (["--merging", "none"], "Invalid value for '--merging'"),
        (["--platform-noise", "no"], "unexpected extra argument"),
        (["--sigma", "3"], "No such option: --sigma"),
    ],
)
def test_bad_options_are_one_line(arguments: list[str], part: str) -> None:
    code, text = run("reproduce", "phase-difference", *arguments)
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert part in text
    assert text.count("\n") == 1


def test_a_file_in_the_way(tmp_path: Path) -> None:
    place = tmp_path / "out"
    place.write_text("mine", "utf-8")
    code, text = run("reproduce", "phase-difference", "--out", place)
    assert code == 2
    assert text == f"imm-tdoa: error: --out: expected a folder, {str(place)!r} is a file\n"
    assert place.read_text("utf-8") == "mine"


def test_help_teaches() -> None:
    code, text = run("reproduce", "phase-difference", "--help")
    assert code == 0
    assert "imm-tdoa reproduce phase-difference --runs 1000 --covariance diagonal" in words(text)
