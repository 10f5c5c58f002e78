"""Arguments and options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from imm_tdoa.cycle import RobustRule

PRESETS = "static-cv-ca, pedestrian, vehicle, drone, ship, aircraft, rocket"

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
    typer.Option(metavar="NAME", help="This target alone; may be repeated.", show_default=False),
]
OutFolder = Annotated[Path, typer.Option(metavar="DIR", help="Folder to write to.")]


class Robust(StrEnum):
    """Ways to deal with gross errors."""

    GATE = "gate"
    STUDENT_T = "student-t"


RobustOption = Annotated[
    Robust | None,
    typer.Option(
        help="gate: leave out what contradicts the prediction; student-t: trust it less. Default: "
        "neither, every row is believed.",
        show_default=False,
    ),
]


def rule_of(robust: Robust | None) -> RobustRule | None:
    """Return what `IMM` calls it."""
    if robust is None:
        return None
    return "gate" if robust is Robust.GATE else "student-t"


def bank(what: str) -> Any:
    """Return the option ``--bank``; `what` says what its modes are for."""
    return typer.Option(metavar="NAME|FILE", help=f"{what}: {PRESETS}, or a TOML file.")


def out_named_after(what: str, *, use: str = "Folder to write to") -> Any:
    """Return the option ``--out`` of a command that names its folder after what it works on."""
    return typer.Option(
        metavar="DIR", help=f"{use}; default imm-tdoa-out/{what}.", show_default=False
    )


def runs(what: str = "") -> Any:
    """Return the option ``--runs`` of a Monte-Carlo computation."""
    return typer.Option(min=2, metavar="N", help=f"Monte-Carlo runs{what}.")


def seed(of: str) -> Any:
    """Return the option ``--seed``."""
    return typer.Option(min=0, metavar="N", help=f"Seed of {of}.")
