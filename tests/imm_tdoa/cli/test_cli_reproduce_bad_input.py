"""``imm-tdoa reproduce``, every source: what is refused, in one line; what the help teaches."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_cases import run, words

EXAMPLES = {
    "motion-form": "--jacobian dt-scaled",
    "phase-difference": "--runs 1000 --covariance diagonal",
    "receiver-errors": "--receiver-weights none",
    "sequence-filter": "--rule bound",
}
EVERYWHERE = [
    (["--runs", "1"], "Invalid value for '--runs'"),
    (["--runs", "many"], "Invalid value for '--runs'"),
    (["--seed", "-1"], "Invalid value for '--seed'"),
    (["--gate", "3"], "No such option: --gate"),
    (["else"], "unexpected extra argument"),
]
OWN = {
    "motion-form": [
        (["--tdoa-sign", "eq9"], "Invalid value for '--tdoa-sign'"),
        (["--jacobian", "x"], "Invalid value for '--jacobian'"),
        (["--process-noise", "-1"], "Invalid value for '--process-noise'"),
        (["--process-noise", "inf"], "process_noise: expected a finite number"),
        (["--no-match"], "No such option: --no-match"),
    ],
    "phase-difference": [
        (["--covariance", "full"], "Invalid value for '--covariance'"),
        (["--merging", "none"], "Invalid value for '--merging'"),
        (["--platform-noise", "no"], "unexpected extra argument"),
        (["--sigma", "3"], "No such option: --sigma"),
    ],
    "receiver-errors": [
        (["--receiver-weights", "all"], "Invalid value for '--receiver-weights'"),
        (["--second-step"], "No such option: --second-step"),
    ],
    "sequence-filter": [
        (["--rule", "worst"], "Invalid value for '--rule'"),
        (["--test", "prior"], "Invalid value for '--test'"),
    ],
}


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["nothing"], "No such command 'nothing'"),
        *(([name, *more], part) for name in EXAMPLES for more, part in [*EVERYWHERE, *OWN[name]]),
    ],
)
def test_bad_options_are_one_line(arguments: list[str], part: str) -> None:
    code, text = run("reproduce", *arguments)
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert part in text
    assert text.count("\n") == 1
    assert "Value error" not in text
    assert "Input should be" not in text


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_file_in_the_way(name: str, tmp_path: Path) -> None:
    place = tmp_path / "out"
    place.write_text("mine", "utf-8")
    code, text = run("reproduce", name, "--out", place)
    assert (code, text) == (
        2,
        f"imm-tdoa: error: --out: expected a folder, {str(place)!r} is a file\n",
    )
    assert place.read_text("utf-8") == "mine"


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_recording_in_the_way(name: str, tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text("mine", "utf-8")
    code, text = run("reproduce", name, "--out", tmp_path)
    assert (code, text) == (
        2,
        f"imm-tdoa: error: --out: {str(tmp_path)!r} is a recording; give a folder elsewhere\n",
    )
    assert [f.name for f in tmp_path.iterdir()] == ["recording.toml"]


def test_help_names_every_source() -> None:
    code, text = run("reproduce")
    assert code == 0
    assert "imm-tdoa reproduce motion-form" in words(text)
    for name in EXAMPLES:
        assert name in text


@pytest.mark.parametrize("name", EXAMPLES)
def test_help_teaches(name: str) -> None:
    code, text = run("reproduce", name, "--help")
    assert code == 0
    assert f"imm-tdoa reproduce {name} {EXAMPLES[name]}" in words(text)
