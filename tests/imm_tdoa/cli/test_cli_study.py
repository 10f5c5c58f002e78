"""``imm-tdoa study``: what it prints and writes, how it goes on, and what it refuses."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cli_cases import run, words

from imm_tdoa.study import Store, shipped

STUDY = """
title = "Two banks on a road"
question = "Which?"
seed = 1
runs = 12
chunk = 6
metrics = ["position"]

[[scenarios]]
name = "road"
scenario = "sample"
replace.dropouts = {}
replace.sampling = { interval_s = 60.0 }

[[banks]]
name = "vehicle"
bank = "vehicle"

[[banks]]
name = "straight on"
modes = [{ model = "constant-velocity", psd = 1.0 }]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A small study."""
    path = tmp_path / "road.toml"
    path.write_text(STUDY, "utf-8")
    return path


@pytest.fixture(autouse=True)
def alone() -> Iterator[None]:
    """Leave the folder of the tests alone."""
    yield
    assert not Path("imm-tdoa-out").exists()


def test_without_a_study_the_shipped_ones_are_listed() -> None:
    code, text = run("study")
    assert code == 0
    for name in shipped():
        assert name in text
    assert "Is it seen that constant velocity is the wrong model" in words(text)
    assert "6 scenarios × 4 banks × 1000 runs" in words(text)


def test_a_study_is_run_written_and_told(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, text = run("study", file, "--out", out, "--workers", 1)
    assert code == 0, text
    shown = words(text)
    assert "Two banks on a road (12 runs)" in shown
    assert "µs per filter step" in shown
    assert "12 runs of 2 banks, 192 filter steps; this time" in shown
    assert f"report: {out / 'report.html'}" in text.replace("\n", "")
    for name in ("study.toml", "results.nc", "summary.csv", "report.html", "chunks"):
        assert (out / name).exists(), name
    assert len(Store(out).chunks("road")) == 2

    before = {path.name: path.stat().st_mtime_ns for path in (out / "chunks").iterdir()}
    code, text = run("study", file, "--out", out, "--workers", 1)
    assert code == 0
    assert before == {path.name: path.stat().st_mtime_ns for path in (out / "chunks").iterdir()}

    code, text = run("study", file, "--out", out, "--seed", 2)
    assert code == 2
    assert words(text) == (
        f"imm-tdoa: error: {out}: holds results of another study: seed: was 1, is 2; "
        f"give another folder, or --restart to delete these results"
    )


def test_the_folder_itself_holds_the_study(file: Path, tmp_path: Path) -> None:
    from imm_tdoa import study

    store = study.run(study.load(file), tmp_path / "out", workers=1)
    again = study.run(study.load(store.folder / "study.toml"), tmp_path / "again", workers=1)
    for a, b in zip(store.chunks("road"), again.chunks("road"), strict=True):
        assert a.read_bytes() == b.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["discriminatio"], "study: no shipped study and no file is called 'discriminatio'"),
        (["no/such.toml"], "study: there is no file 'no/such.toml'"),
        (["FILE", "--workers", "0"], "--workers: expected a whole number of at least 1, got 0"),
        (["FILE", "--cluster", "host:1"], "--cluster: expected dask://host:port, got 'host:1'"),
        (["FILE", "--runs", "0"], "Invalid value for '--runs'"),
        (["FILE", "--out", "FILE"], "--out: expected a folder"),
    ],
)
def test_errors_are_one_line(file: Path, arguments: list[str], message: str) -> None:
    given = [str(file) if word == "FILE" else word for word in arguments]
    out = [] if "--out" in given else ["--out", str(file.parent / "out")]
    code, text = run("study", *given, *out)
    assert code == 2
    assert text.count("\n") == 1
    assert message in words(text)
    assert not (file.parent / "out").exists()


def test_a_full_disk_says_what_is_kept(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    savez, count = np.savez, 0

    def full(target: object, **arrays: object) -> None:
        nonlocal count
        count += 1
        if count > 1:
            raise OSError(28, "No space left on device")
        savez(target, **arrays)  # type: ignore[arg-type]

    monkeypatch.setattr(np, "savez", full)
    code, text = run("study", file, "--out", tmp_path / "out", "--workers", 1)
    assert code == 2
    assert "road-00000006.npz: No space left on device: 1 of 2 chunks are kept in" in words(text)
    assert "run the same command again" in words(text)


def test_the_command_line_starts_without_what_only_studies_need() -> None:
    import subprocess

    code = "import imm_tdoa.cli.app, sys; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    names = {name.partition(".")[0] for name in loaded.stdout.split()}
    assert not names & {"xarray", "joblib", "numba", "matplotlib"}
