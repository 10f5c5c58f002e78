"""``imm-tdoa reproduce motion-form``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_cases import run, summary_of, table, words

from imm_tdoa.reproduce.motion_form import switching_target

FILES = {
    "imm.csv",
    "scenario-1.png",
    "scenario-2.png",
    "scenario-3.png",
    "summary.json",
    "sweep.csv",
    "sweep.png",
    "switching.csv",
    "switching.png",
    "table1.csv",
}


def few(model: str, per_decade: int = 3) -> list[float]:
    """Fewer noise levels than the command sweeps."""
    return [0.0, 0.01]


def test_motion_form(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(switching_target, "levels", few)
    out = tmp_path / "out"
    code, text = run("reproduce", "motion-form", "--runs", "5", "--seed", "2", "--out", out)
    assert code == 0
    summary = summary_of(out, FILES)
    said = words(text)
    assert "Geometry and noise are our reconstruction; the paper gives neither." in said
    assert "5 runs of three targets" in said
    assert (summary["runs"], summary["seed"]) == (5, 2)
    for row in table(out / "table1.csv"):
        found = summary["table1"][row["row"]]
        assert float(row["mean_km"]) == found["mean_km"]
        assert f"{found['mean_km']:.3f}" in said
    for paper in ("0.982", "0.591", "10.618", "0.781"):
        assert paper in said
    best = min(table(out / "sweep.csv"), key=lambda row: float(row["mean_km"]))
    assert summary["switching"]["best_single"]["model"] == best["model"]
    assert float(best["mean_km"]) == summary["switching"]["best_single"]["mean_km"]
    assert {row["estimator"] for row in table(out / "imm.csv")} >= {"imm-birth", "static"}


def test_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(switching_target, "levels", few)
    switches = "--tdoa-sign eq8 --jacobian dt-scaled --noise-covariance diagonal --mixing zero"
    arguments = [*switches.split(), "--static", "recursive", "--process-noise", "1e-4"]
    code, text = run("reproduce", "motion-form", "--runs", "2", "--out", tmp_path, *arguments)
    assert code == 0
    said = words(text)
    assert "diverges" in said
    assert "doubles each time: 1.000, 2.003, 4.016" in said
    assert "makes a difference with --noise correlated" in said
    assert "computed with the right sign and Jacobian" in said
    assert "IMM zero / matched" in said
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert summary["switches"] == {
        "tdoa_sign": "eq8",
        "jacobian": "dt-scaled",
        "noise": "independent",
        "noise_covariance": "diagonal",
        "process_noise": 1e-4,
        "static": "recursive",
        "mixing": "zero",
    }
    assert summary["table1"]["static-per-epoch"]["mean_km"] is None
    assert summary["table1"]["static-recursive"]["paper_km"] == 0.982
