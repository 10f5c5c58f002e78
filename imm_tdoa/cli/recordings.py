"""What the commands about a recording share: which one, which targets, gross errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from imm_tdoa.cycle import RobustRule
    from imm_tdoa.recording import Recording

RecordingFolder = Annotated[
    Path | None,
    typer.Argument(
        metavar="RECORDING",
        help="Folder of the recording; without it the one that ships with the program.",
        show_default=False,
    ),
]
Targets = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="This target alone; may be repeated."),
]


class Robust(StrEnum):
    """Ways to deal with gross errors."""

    GATE = "gate"
    STUDENT_T = "student-t"


RobustOption = Annotated[
    Robust | None,
    typer.Option(help="gate: leave out what contradicts the prediction; student-t: trust it less."),
]


def rule_of(robust: Robust | None) -> RobustRule | None:
    """Return what `IMM` calls it."""
    if robust is None:
        return None
    return "gate" if robust is Robust.GATE else "student-t"


@contextmanager
def folder(recording: Path | None) -> Iterator[Path]:
    """The recording's folder, or that of the shipped sample."""
    if recording is not None:
        yield recording
        return
    with resources.as_file(resources.files("imm_tdoa").joinpath("sample")) as place:
        yield place


def targets(data: Recording, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """Return the targets wanted, all without a wish, or say that one does not exist."""
    for name in wanted or ():
        if name not in data.targets:
            shown = ", ".join(data.targets[:10]) + (", …" if len(data.targets) > 10 else "")
            raise ValueError(f"--target: no target {name!r} in the recording; there are: {shown}")
    return tuple(dict.fromkeys(wanted)) if wanted else data.targets
