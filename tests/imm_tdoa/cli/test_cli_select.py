"""``imm-tdoa select``, end to end."""

from __future__ import annotations

import json
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
from cli_cases import assert_drawn, run, table, words, write_recording

BANK = """mean_sojourn_s = 30
[birth_std]
velocity = 20.0
acceleration = 2.0
[[modes]]
model = "static"
psd = 0.0
[[modes]]
model = "constant-velocity"
name = "straight"
psd = 0.0
[[modes]]
model = "constant-acceleration"
psd = 0.0
"""


@pytest.fixture
def bank(tmp_path: Path) -> Path:
    file = tmp_path / "bank.toml"
    file.write_text(BANK, "utf-8")
    return file


def test_sample(tmp_path: Path) -> None:
    """Without arguments: the shipped recording; table, summary and picture agree."""
    with chdir(tmp_path):
        code, text = run("select")
    assert code == 0
    out = tmp_path / "imm-tdoa-out" / "sample-select"
    assert {f.name for f in out.iterdir()} == {"select.csv", "summary.json", "evidence.png"}
    assert_drawn(out / "evidence.png")
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    (target,) = summary["targets"].values()
    rows = table(out / "select.csv")
    assert [row["model"] for row in rows] == summary["models"]
    for row in rows:
        found = target["models"][row["model"]]
        for key in ("log_evidence", "probability", "aic", "bic", "nis_p"):
            assert float(row[key]) == pytest.approx(found[key])
        assert row["verdict"] == target["verdict"]
    assert target["verdict"] in (*summary["models"], "imm")
    assert summary["birth_std"] == {"velocity": 100.0, "acceleration": 5.0}
    assert f"verdict: {target['verdict']}. {target['reason']}." in words(text)
    assert "birth standard deviations: velocity 100, acceleration 5" in words(text)
    assert "written to imm-tdoa-out/sample-select: evidence.png, select.csv" in words(text)


def test_ships_that_move_straight_on(tmp_path: Path, bank: Path) -> None:
    """Two targets: a picture of each, and the right verdict on both; the last scans alone too."""
    folder = write_recording(tmp_path / "rec", targets=("one", "two/2"))
    out = tmp_path / "out"
    code, text = run("select", folder, "--bank", bank, "--out", out)
    assert code == 0
    assert {f.name for f in out.iterdir()} == {
        "select.csv",
        "summary.json",
        "evidence.png",
        "evidence-one.png",
        "evidence-two_2.png",
    }
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["overall"]["verdicts"] == {
        "static": 0,
        "straight": 2,
        "constant-acceleration": 0,
        "imm": 0,
    }
    assert summary["targets"]["one"]["verdict"] == "straight"
    assert summary["targets"]["one"]["rows"] == 15 * 4
    assert summary["targets"]["one"]["models"]["static"]["accepted"] is False
    assert "target two/2" in text
    assert "straight explains the data best" in words(text)
    options = ["--window", "5", "--robust", "student-t", "--target", "one"]
    assert run("select", folder, "--bank", bank, "--out", out, *options)[0] == 0
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert list(summary["targets"]) == ["one"]
    assert summary["targets"]["one"]["rows"] == 5 * 4
    assert (summary["window"], summary["robust"]) == (5, "student-t")


def test_what_is_believed_beforehand(tmp_path: Path, bank: Path) -> None:
    """The birth law from the command line reaches the evidence."""
    folder = write_recording(tmp_path / "rec")
    found = []
    for std in ("20", "200"):
        out = tmp_path / std
        options = ["--velocity-std", std, "--acceleration-std", "3", "--out", out]
        assert run("select", folder, "--bank", bank, *options)[0] == 0
        summary = json.loads((out / "summary.json").read_text("utf-8"))
        assert summary["birth_std"] == {"velocity": float(std), "acceleration": 3.0}
        (target,) = summary["targets"].values()
        found.append(target["models"]["straight"])
    assert found[0]["log_evidence"] - found[1]["log_evidence"] == pytest.approx(
        2.0 * np.log(10.0), abs=0.3
    )
    assert found[0]["aic"] == pytest.approx(found[1]["aic"], abs=1e-5)


def test_many_targets_are_counted(tmp_path: Path, bank: Path) -> None:
    folder = write_recording(tmp_path / "rec", targets=[f"ship-{i}" for i in range(8)])
    out = tmp_path / "out"
    code, text = run("select", folder, "--bank", bank, "--out", out)
    assert code == 0
    assert {f.name for f in out.iterdir()} == {"select.csv", "summary.json", "evidence.png"}
    assert "straight 8" in words(text)
    assert "target scans verdict best margin over NIS p of the best" in words(text)


def test_too_little_to_judge_by(tmp_path: Path, bank: Path) -> None:
    """One scan: no verdict, no criterion, and the reasons."""
    folder = write_recording(tmp_path / "rec", times=(0.0,))
    code, text = run("select", folder, "--bank", bank, "--out", tmp_path / "out")
    assert code == 0
    assert "no scan after the first fix to judge by" in words(text)
    assert "no AIC and BIC of constant-acceleration: 6 unknowns need at least 6 rows" in words(text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--window", "0"], "--window: expected a number of scans, 1 or more, got 0"),
        (["--velocity-std", "0"], "--velocity-std: expected a number above 0, got 0"),
        (["--bank", "submarine"], "submarine"),
        (["--target", "x"], "--target: no target 'x' in the recording; there are: ship"),
        (["--robust", "hope"], "'hope' is not one of"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, options: list[str], message: str) -> None:
    folder = write_recording(tmp_path / "rec")
    code, text = run("select", folder, "--out", tmp_path / "out", *options)
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert text.count("\n") == 1
    assert message in text
    assert not (tmp_path / "out").exists()


def test_a_recording_that_fixes_nothing(tmp_path: Path) -> None:
    rows = "time_s,emission,station,toa_s,target\n0,e,a,0.1,ship\n0,e,b,0.1,ship\n"
    folder = write_recording(tmp_path / "rec", files={"toa.csv": rows})
    code, text = run("select", folder, "--out", tmp_path / "out")
    assert code == 2
    assert "no target can be judged: target 'ship'" in text
