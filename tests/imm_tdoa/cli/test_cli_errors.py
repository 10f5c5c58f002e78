"""What the command says when something is wrong: one line, exit code 2."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_cases import HEAD, run, words, write_recording

import imm_tdoa
from imm_tdoa import bankfile

COMMANDS = ("track", "locate", "select", "simulate", "study", "reproduce", "models", "bench")
Case = Callable[[Path], tuple[list[str], str]]


def missing_folder(tmp: Path) -> tuple[list[str], str]:
    where = str(tmp / "nowhere")
    return ["track", where], f"folder: expected a recording folder, there is none at {where!r}"


def scenario_for_a_folder(tmp: Path) -> tuple[list[str], str]:
    return ["locate", "two-ships"], (
        "folder: there is none called 'two-ships', but a scenario; "
        "imm-tdoa simulate two-ships --out two-ships makes a recording of it"
    )


def folder_without_recording(tmp: Path) -> tuple[list[str], str]:
    return ["track", str(tmp)], f"recording.toml: missing in {str(tmp)!r}"


def broken_row(tmp: Path) -> tuple[list[str], str]:
    folder = write_recording(tmp / "rec")
    lines = (folder / "toa.csv").read_text("utf-8").splitlines()
    lines[4] = lines[4].replace(",d,", ",d,x")
    (folder / "toa.csv").write_text("\n".join(lines) + "\n", "utf-8")
    value = lines[4].split(",")[3]
    return ["track", str(folder)], f"toa.csv:5: toa_s: expected a number, got {value!r}"


def unknown_station(tmp: Path) -> tuple[list[str], str]:
    folder = write_recording(tmp / "rec")
    text = (folder / "toa.csv").read_text("utf-8").replace(",ship0,e,", ",ship0,x,")
    (folder / "toa.csv").write_text(text, "utf-8")
    return ["locate", str(folder)], (
        "toa.csv:6: station: unknown station 'x'; there are a, b, c, d, e"
    )


def broken_settings(tmp: Path) -> tuple[list[str], str]:
    folder = write_recording(
        tmp / "rec", files={"recording.toml": HEAD.replace("dims = 2", "dims")}
    )
    return ["track", str(folder)], (
        "recording.toml:4:5: Expected '=' after a key in a key/value pair"
    )


def unknown_preset(tmp: Path) -> tuple[list[str], str]:
    every = ", ".join(bankfile.presets())
    return ["track", "--bank", "vehicel"], (
        f"bank: no preset and no file is called 'vehicel' (did you mean 'vehicle'?); there "
        f"are: {every}"
    )


def missing_bank_file(tmp: Path) -> tuple[list[str], str]:
    return ["track", "--bank", "my/bank.toml"], "bank: there is no file 'my/bank.toml'"


def broken_bank_file(tmp: Path) -> tuple[list[str], str]:
    bank = tmp / "bank.toml"
    bank.write_text('[[modes]]\nmodel = "static"\npsd = "none"\n', "utf-8")
    return ["track", "--bank", str(bank)], (
        "bank.toml: modes[0].psd: expected one number, got 'none'"
    )


def unknown_target(tmp: Path) -> tuple[list[str], str]:
    folder = write_recording(tmp / "rec")
    return ["track", str(folder), "--target", "plane"], (
        "--target: no target 'plane' in the recording; there are: ship"
    )


def out_inside_the_recording(tmp: Path) -> tuple[list[str], str]:
    folder = write_recording(tmp / "rec")
    out = str(folder / "out")
    return ["track", str(folder), "--out", out], (
        f"--out: {out!r} lies inside the recording; give a folder elsewhere"
    )


def out_is_a_file(tmp: Path) -> tuple[list[str], str]:
    folder = write_recording(tmp / "rec")
    out = tmp / "out"
    out.write_text("", "utf-8")
    return ["locate", str(folder), "--out", str(out)], (
        f"--out: expected a folder, {str(out)!r} is a file"
    )


CASES: list[Case] = [
    missing_folder,
    scenario_for_a_folder,
    folder_without_recording,
    broken_row,
    unknown_station,
    broken_settings,
    unknown_preset,
    missing_bank_file,
    broken_bank_file,
    unknown_target,
    out_inside_the_recording,
    out_is_a_file,
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_bad_input_is_one_line(case: Case, tmp_path: Path) -> None:
    arguments, message = case(tmp_path)
    assert run(*arguments) == (2, f"imm-tdoa: error: {message}\n")


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["track", "--robust", "x"], "Invalid value for '--robust'"),
        (["track", "--banc", "x"], "No such option: --banc"),
        (["trakc"], "No such command 'trakc'"),
        (["simulate", "--out", "x"], "Missing argument"),
        (["simulate", "sample"], "Missing option '--out'"),
        (["simulate", "sample", "--out", "x", "--seed", "one"], "Invalid value for '--seed'"),
    ],
)
def test_bad_command_line_is_one_line(arguments: list[str], part: str) -> None:
    code, text = run(*arguments)
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert part in text
    assert text.count("\n") == 1


def test_system_errors_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> None:
        raise PermissionError(13, "Permission denied", "bank.toml")

    monkeypatch.setattr(bankfile, "load", refuse)
    assert run("track") == (2, "imm-tdoa: error: bank.toml: Permission denied\n")


def test_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(bankfile, "load", interrupt)
    assert run("track")[0] == 130


def test_help_teaches() -> None:
    code, text = run()
    assert code == 0
    assert "imm-tdoa track my-recording --bank vehicle --robust gate" in words(text)
    for command in COMMANDS:
        code, text = run(command, "--help")
        assert code == 0
        assert words(text).count(f"imm-tdoa {command}") > 1  # the usage line, and an example
    assert run("--version") == (0, f"imm-tdoa {imm_tdoa.__version__}\n")


def test_as_a_process(tmp_path: Path) -> None:
    """The real thing: output on stdout, errors on stderr, pyplot's global state untouched."""
    program = (
        "import sys\n"
        "from imm_tdoa.cli import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    folder = write_recording(tmp_path / "rec")
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        [*command, "track", str(folder)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "A small one" in done.stdout
    assert (tmp_path / "imm-tdoa-out" / "rec" / "track.png").exists()
    done = subprocess.run(
        [*command, "track", "nowhere"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "imm-tdoa: error: folder: expected a recording folder, there is none at 'nowhere'\n"
    )
