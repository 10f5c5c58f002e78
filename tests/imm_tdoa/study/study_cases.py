"""A study so small that it is run many times over, and what to compare of two folders."""

from __future__ import annotations

from pathlib import Path

from imm_tdoa.study import Study, parse, run

STATIONS = """
    { name = "a", position_m = [0.0, 0.0] },
    { name = "b", position_m = [9000.0, 1000.0] },
    { name = "c", position_m = [4000.0, 8000.0] },
    { name = "d", position_m = [-3000.0, 6000.0] },
"""
HEAD = """
title = "A small one"
question = "Does it run?"
reading = "It should."
seed = 4
runs = 20
chunk = 6
"""
SCENARIOS = f"""
[[scenarios]]
name = "drive"

[scenarios.scenario]
title = "A drive"
dims = 2
sampling = {{ interval_s = 2.0 }}
noise = {{ toa_sigma_s = 30e-9 }}
stations = [{STATIONS}]
targets = [
    {{ name = "car", position_m = [2000.0, 1500.0], velocity_mps = [12.0, 5.0], legs = [
        {{ motion = "constant-velocity", duration_s = 8.0 }},
        {{ motion = "static", duration_s = 8.0 }},
    ] }},
]

[scenarios.sweep]
noise_factor = [1.0, 3.0]
"""
BANKS = """
[[banks]]
name = "IMM"
bank = "static-cv-ca"

[[banks]]
name = "CV"
modes = [{ model = "constant-velocity", psd = 1.0 }]

[[banks]]
name = "static"
modes = [{ model = "static", psd = 1.0 }]
"""
CRITERIA = """
[[criteria]]
name = "evidence"
by = "log_evidence"
banks = ["static", "CV"]
"""
TEXT = HEAD + SCENARIOS + BANKS


def small(*changes: tuple[str, str], runs: int | None = None) -> Study:
    """Return the small study with some of its text replaced."""
    text = TEXT
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return parse(text, "small.toml", runs=runs)


def tiny(*changes: tuple[str, str], runs: int | None = None) -> Study:
    """Return a study of as many chunks that takes less time."""
    without = (BANKS.partition('[[banks]]\nname = "CV"')[0], "")
    return small(*changes, without, ("interval_s = 2.0", "interval_s = 4.0"), runs=runs)


def contents(folder: Path) -> dict[str, bytes]:
    """Return all that must not depend on how a study was run: chunks and bounds, byte by byte."""
    files = [*folder.glob("chunks/*.npz"), *folder.glob("bounds/*.npz")]
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(files)
        if not file.name.startswith(".draft")
    }


def drafts(folder: Path) -> list[Path]:
    """Return files that were begun and not finished."""
    return [file for file in folder.rglob("*") if file.name.startswith(".draft")]


def go(text: str, folder: str) -> None:
    """Run a study, in a process that will be killed."""
    run(parse(text), folder, workers=1)
