"""``imm-tdoa reproduce receiver-errors``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_cases import run, summary_of, table, words

from imm_tdoa.reproduce.receiver_errors import levels

FILES = {
    "measurement-noise.png",
    "noise.csv",
    "receiver-errors.png",
    "shared-coordinate.png",
    "shared_coordinate.csv",
    "summary.json",
    "table.csv",
}


def test_receiver_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {"receivers": np.array([1e-4, 1e-3]), "measurement": np.array([1e-4, 1e-3])}
    monkeypatch.setattr(levels.sweep, "__defaults__", (*levels.sweep.__defaults__[:-1], few))
    out = tmp_path / "out"
    code, text = run("reproduce", "receiver-errors", "--runs", "20", "--seed", "2", "--out", out)
    assert code == 0
    summary = summary_of(out, FILES)
    said = words(text)
    assert "Source D prints no simulation" in said
    assert "20 runs" in said
    for reference in ("0.788", "84.6", "0.0896", "475", "224"):
        assert reference in said
    assert (summary["runs"], summary["seed"], summary["receiver_weights"]) == (20, 2, "both")
    rows = table(out / "table.csv")
    assert len(rows) == 30
    first = summary["points"][0]["estimators"]["first-step"]
    assert float(rows[0]["rmse_m"]) == first["rmse_m"]
    assert rows[4]["estimator"] == "trusted"
    assert float(rows[4]["theory_m"]) == summary["points"][0]["trusting_theory_m"]
    shared = summary["shared_coordinate"]
    assert shared["squared_mps"] > 30.0 * shared["error_correction_mps"]
