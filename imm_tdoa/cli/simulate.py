"""``imm-tdoa simulate``: a recording that never happened."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imm_tdoa.cli import output

if TYPE_CHECKING:
    from imm_tdoa.simulate import Simulated


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="A TOML file, or a shipped scenario: sample, source-a, two-ships, drone-3d, fdoa, "
            "outliers; unlabelled ones: three-emitters, crossing, parallel, busy-sky; and "
            "many-aircraft.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="RECORDING", help="Folder to write.", show_default=False),
    ],
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Seed of the random numbers; default the scenario's.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a recording that is there already.")
    ] = False,
) -> None:
    """Make a recording from a scenario, truth included, and draw the scene and the differences.

    Example, two ships, and then their tracks:

        imm-tdoa simulate two-ships --out ships --seed 7

        imm-tdoa track ships --bank ship

    The same scenario and seed give the same recording, byte for byte.
    """
    from imm_tdoa import plot, recording
    from imm_tdoa.simulate import load, simulate_labelled

    plan = load(scenario)
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out: expected a folder, {str(out)!r} is a file")
    if out.is_dir() and any(out.iterdir()) and not force:
        raise ValueError(f"--out: {str(out)!r} is not empty; give --force to replace a recording")
    with output.progress(None) as advance:
        advance("simulating")
        made = simulate_labelled(plan, seed)
        data = made.recording
        recording.write(data, out, overwrite=force)
        advance("drawing")
        plot.scene(data, path=out / "scene.png")
        if plot.has_differences(data):
            plot.differences(data, path=out / "differences.png")
    console = output.console()
    output.heading(console, data.title or scenario)
    table = output.table([("", False), ("", True)], header=False)
    for word, count in (
        ("targets", len(plan.emitters)),
        ("stations", len(data.stations)),
        *((f"rows of {name}", len(rows)) for name, rows in data.measured.items()),
        *_confusion(made),
        ("rows of truth", 0 if data.truth is None else len(data.truth)),
    ):
        table.add_row(word, str(count))
    console.print(table)
    output.written(console, out, sorted(file.name for file in out.iterdir() if file.is_file()))
    command = ["imm-tdoa", "track", str(out), *shlex.split(plan.track_with)]
    console.print(f"track it: {shlex.join(command)}", soft_wrap=True, markup=False, highlight=False)


def _confusion(made: Simulated) -> list[tuple[str, int]]:
    """Count what hides whose the rows are, where nobody has told them apart."""
    if made.recording.labelled:
        return []
    names = next(origins for table, origins in made.origins.items() if table in ("tdoa", "toa"))
    return [
        ("of them false alarms", sum(not who for who in names)),
        ("of them of several targets", sum(len(who) > 1 for who in names)),
    ]
