"""``imm-tdoa simulate``: a recording that never happened."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imm_tdoa.cli import output


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="A shipped scenario (sample, source-a, two-ships, drone-3d, …) or a TOML file.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="RECORDING", help="Folder to write.", show_default=False),
    ],
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of the random numbers; default the scenario's.", min=0),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a recording that is there already.")
    ] = False,
) -> None:
    """Make a recording from a scenario, truth included, and draw the scene.

    Example, two ships, and then their tracks:

        imm-tdoa simulate two-ships --out ships --seed 7

        imm-tdoa track ships --bank ship

    The same scenario and seed give the same recording, byte for byte.
    """
    from imm_tdoa import plot, recording
    from imm_tdoa.simulate import load
    from imm_tdoa.simulate import simulate as make

    plan = load(scenario)
    if out.is_dir() and any(out.iterdir()) and not force:
        raise ValueError(f"--out: {str(out)!r} is not empty; give --force to replace a recording")
    with output.progress(None) as advance:
        advance("simulating")
        data = make(plan, seed)
        recording.write(data, out, overwrite=force)
        advance("drawing")
        plot.scene(data, path=out / "scene.png")
    console = output.console()
    output.heading(console, data.title or scenario)
    table = output.table([("", False), ("", True)], header=False)
    for word, count in (
        ("targets", len(data.targets)),
        ("stations", len(data.stations)),
        *((f"rows of {name}", len(rows)) for name, rows in data.measured.items()),
        ("rows of truth", 0 if data.truth is None else len(data.truth)),
    ):
        table.add_row(word, str(count))
    console.print(table)
    output.written(console, out, sorted(file.name for file in out.iterdir() if file.is_file()))
