"""``imm-tdoa reproduce sequence-filter``."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_cases import run, summary_of, table, words

from imm_tdoa.reproduce.sequence_filter import CASES, geometries, moving, scenario

FILES = {
    "band.png",
    "cases.csv",
    "geometries.csv",
    "jump.csv",
    "kappa.png",
    "moving.csv",
    "spot.png",
    "summary.json",
}


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer epochs and geometries than the command takes."""
    monkeypatch.setattr(scenario, "EPOCHS", 20)
    monkeypatch.setattr(scenario, "LAST", 8)
    monkeypatch.setattr(moving, "EPOCHS", 20)
    monkeypatch.setattr(moving, "JUMP_EPOCH", 6)
    monkeypatch.setattr(moving, "JUMP_EPOCHS", 28)
    monkeypatch.setattr(geometries, "COUNT", 2)


@pytest.mark.usefixtures("short")
def test_sequence_filter(tmp_path: Path) -> None:
    out = tmp_path / "out"
    switches = ["--rule", "proj", "--test", "innovation", "--reset-on-gate"]
    arguments = ["--runs", "3", "--seed", "2", *switches, "--out", str(out)]
    code, text = run("reproduce", "sequence-filter", *arguments)
    assert code == 0
    summary = summary_of(out, FILES)
    said = words(text)
    assert "The source gives no figures, only the claims" in said
    assert "the spot of a target that stands shrinks to a point" in said
    assert "A small spot is not a small error" in said
    assert "paid with a lag of" in said
    assert (summary["runs"], summary["seed"]) == (3, 2)
    assert summary["switches"] == {"rule": "proj", "test": "innovation", "reset_on_gate": True}
    rows = table(out / "cases.csv")
    assert [row["case"] for row in rows] == [case.name for case in CASES for _ in range(2)]
    for row, found in zip(rows, summary["cases"], strict=True):
        assert float(row["radius_ratio"]) == found["radius_ratio"]
        assert float(row["error_m"]) == found["error_m"]
        assert (row["reference_radius_ratio"] == "") == (row["weights"] == "full")
    for figure in ("26.5", "13.4", "53.6", "46.1", "22.8", "49.6", "58.6"):
        assert f"({figure})" in said
    assert len(table(out / "moving.csv")) == 6
    assert len(table(out / "jump.csv")) == len(moving.JUMPS)
    assert len(table(out / "geometries.csv")) == summary["kappa"]["geometries"] == 2
    assert f"{summary['kappa']['predicted_right']} of 2" in said
