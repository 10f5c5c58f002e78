"""``imm-tdoa reproduce phase-difference``."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_cases import run, summary_of, table, words

from imm_tdoa.reproduce.phase_difference import whole

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
    summary = summary_of(out, FILES)
    assert (summary["runs"], summary["seed"]) == (3, 5)
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
    for row, found in zip(table(out / "tables.csv"), summary["tables"], strict=True):
        assert row["use"] == found["use"]
        assert float(row["rms_at_end"]) == found["rms_at_end"]
