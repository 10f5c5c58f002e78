"""``imm-tdoa simulate``."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from cli_cases import run, words

from imm_tdoa import bankfile
from imm_tdoa.cycle import ROBUST
from imm_tdoa.recording import read
from imm_tdoa.simulate import load, scenarios, simulate_labelled


def files(folder: Path) -> dict[str, bytes]:
    return {f.name: f.read_bytes() for f in folder.iterdir() if f.suffix != ".png"}


def test_same_seed_same_recording(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b", "c")]
    for folder, seed in zip(folders, ("7", "7", "8"), strict=True):
        code, text = run("simulate", "source-a", "--out", folder, "--seed", seed)
        assert code == 0
        assert (folder / "scene.png").stat().st_size > 10_000
    assert "targets 3" in words(text)
    assert files(folders[0]) == files(folders[1])
    assert files(folders[0]) != files(folders[2])
    recording = read(folders[0])
    assert recording.truth is not None
    assert len(recording.targets) == 3


def test_what_hides_whose_the_rows_are_is_counted(tmp_path: Path) -> None:
    code, text = run("simulate", "crossing", "--out", tmp_path / "rec", "--seed", "3")
    assert code == 0
    made = simulate_labelled(load("crossing"), seed=3)
    false = made.origins["tdoa"].count(())
    assert false > 100
    for line in (
        "targets 2",
        f"rows of tdoa {len(made.origins['tdoa'])}",
        f"of them false alarms {false}",
        "of them of several targets 0",
    ):
        assert line in words(text)
    assert (tmp_path / "rec" / "differences.png").stat().st_size > 10_000
    assert not read(tmp_path / "rec").labelled


@pytest.mark.parametrize("name", scenarios())
def test_how_to_track_it_is_said_and_exists(name: str) -> None:
    options = shlex.split(load(name).track_with)
    given = dict(zip(options[::2], options[1::2], strict=True))
    assert set(given) <= {"--bank", "--robust"}
    assert given.get("--bank", "static-cv-ca") in bankfile.presets()
    assert given.get("--robust", "gate") in ROBUST


def test_the_next_command_is_printed(tmp_path: Path) -> None:
    code, text = run("simulate", "two-ships", "--out", tmp_path / "my ships")
    assert code == 0
    assert text.endswith(f"\ntrack it: imm-tdoa track '{tmp_path / 'my ships'}' --bank ship\n")


def test_help_names_every_shipped_scenario() -> None:
    code, text = run("simulate", "--help")
    assert code == 0
    assert all(name in words(text).replace("- ", "-") for name in scenarios())


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    folder = tmp_path / "rec"
    assert run("simulate", "source-a", "--out", folder)[0] == 0
    before = files(folder)
    code, text = run("simulate", "source-a", "--out", folder, "--seed", "9")
    assert (code, text) == (
        2,
        f"imm-tdoa: error: --out: {str(folder)!r} is not empty; give --force to replace a "
        f"recording\n",
    )
    assert files(folder) == before
    assert run("simulate", "source-a", "--out", folder, "--seed", "9", "--force")[0] == 0
    assert files(folder) != before


def test_force_does_not_touch_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear", "utf-8")
    code, text = run("simulate", "source-a", "--out", tmp_path, "--force")
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert [f.name for f in tmp_path.iterdir()] == ["letter.txt"]


@pytest.mark.parametrize("wrong", ["sampel", "nowhere/scenario.toml"])
def test_unknown_scenario(wrong: str, tmp_path: Path) -> None:
    code, text = run("simulate", wrong, "--out", tmp_path / "rec")
    assert code == 2
    assert text.startswith("imm-tdoa: error: scenario: ")
    assert text.count("\n") == 1
    if "/" not in wrong:
        assert all(name in text for name in scenarios())
        assert "did you mean 'sample'" in text
