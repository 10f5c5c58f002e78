"""``imm-tdoa reproduce phase-difference``: Source C, computed again."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imm_tdoa.cli import options, output
from imm_tdoa.cli.options import OutFolder
from imm_tdoa.cli.reproduce import folder

if TYPE_CHECKING:
    from rich.console import Console

    from imm_tdoa.reproduce.phase_difference.whole import PhaseDifferences

DEFAULT = Path("imm-tdoa-out") / "phase-difference"
METHODS = {"phase": "phase alone", "rate": "rate alone", "both": "both"}


class Shape(StrEnum):
    """Covariance of a starting component."""

    CORRELATED = "correlated"
    DIAGONAL = "diagonal"


class Merging(StrEnum):
    """Distance under which components are merged."""

    EUCLIDEAN = "euclidean"
    MAHALANOBIS = "mahalanobis"


def phase_difference(
    runs: Annotated[int, options.runs(" of each case")] = 200,
    seed: Annotated[int, options.seed("the errors")] = 1,
    out: OutFolder = DEFAULT,
    covariance: Annotated[
        Shape,
        typer.Option(
            help="Range and bearing of a starting component: correlated, as the phase rate makes "
            "them, or diagonal, as printed."
        ),
    ] = Shape.CORRELATED,
    merging: Annotated[
        Merging,
        typer.Option(help="Distance under which components are merged: 3 km, or 1 sigma."),
    ] = Merging.EUCLIDEAN,
    platform_noise: Annotated[
        bool,
        typer.Option(
            "--platform-noise/--no-platform-noise",
            help="Whether errors of the platform's position and velocity are in the filter's R.",
        ),
    ] = True,
) -> None:
    """Source C: one aircraft with one ambiguous interferometer locates an emitter.

    Computes its Tables 1 and 2, the time until the error is below 5 % of the distance, beside the
    paper's figures; weights and error of one run; the number of hypotheses; clouds of fixes by
    observation time and speed; a sector of 40°; and says what does not come out as published.

    Example, five times the runs, starting components as printed:

        imm-tdoa reproduce phase-difference --runs 1000 --covariance diagonal

    Writes tables.csv, over_time.csv, hypotheses.csv, fixes.csv, sector.csv, summary.json, and
    pictures.
    """
    from imm_tdoa.reproduce import phase_difference as source_c

    output.refuse_taken(out)
    switches = source_c.Switches(
        covariance=covariance.value, merging=merging.value, platform_noise=platform_noise
    )
    with output.progress(source_c.steps() + 1) as advance:
        result = source_c.compute(runs, seed, switches, advance)
        advance("drawing")
        files = _write(out, result)
    console = output.console()
    _tell(console, result)
    output.written(console, out, files)


def _write(home: Path, result: PhaseDifferences) -> list[str]:
    from imm_tdoa.reproduce.phase_difference import pictures, pictures_fixes, report

    draw = {
        "single-run.png": partial(pictures.single_run, result),
        "over-time.png": partial(pictures.over_time, result),
        "observation-time.png": partial(pictures_fixes.by_time, result),
        "speed.png": partial(pictures_fixes.by_speed, result),
        "sector.png": partial(pictures.sector, result),
    }
    return folder.write(home, report.tables(result), draw, report.summary(result))


def _tell(console: Console, result: PhaseDifferences) -> None:
    from imm_tdoa.reproduce.phase_difference import report

    for table, what, unit in ((1, "phase error", "°"), (2, "rate error", "°/s")):
        output.heading(
            console,
            f"{'' if table == 1 else chr(10)}Source C, Table {table}: time [s] until the error of "
            f"{result.runs} runs is below 5 % of the distance",
        )
        columns = [c for c in result.columns if c.table == table]
        shown = output.table(
            [("", False), *((f"{level:g} {unit}", True) for level in columns[0].levels)]
        )
        for column in columns:
            label = METHODS[column.use]
            shown.add_row(f"{label}, paper", *(_time(c.paper_s) for c in column.cells))
            shown.add_row("  ours, rms", *(_time(c.rms_s, c.rms_error_s) for c in column.cells))
            shown.add_row("  ours, mean", *(_time(c.mean_s, c.mean_error_s) for c in column.cells))
        console.print(shown)
        console.print(f"by {what}; -: not within {result.base.times[-1]:g} s")
    _tell_fixes(console, result)
    output.heading(console, "\nWhat agrees and what does not")
    for note in report.notes(result):
        console.print(output.escaped(f"* {note}"))


def _tell_fixes(console: Console, result: PhaseDifferences) -> None:
    from imm_tdoa.reproduce.phase_difference.whole import OBSERVED_S, SPEED_S, inside

    output.heading(console, "\nFigs. 5 and 6: fixes within 10 km of the emitter, and mean error")
    shown = output.table([("", False), ("in the box", True), ("mean error", True)])
    cases = [(f"{t:g} s, 270 m/s", result.base, t) for t in OBSERVED_S]
    cases += [(f"{SPEED_S:g} s, {v:g} m/s", t, SPEED_S) for v, t in result.speeds.items()]
    for label, trial, time in cases:
        mean = f"{100 * trial.at(time, 'mean'):.1f} %"
        shown.add_row(label, f"{100 * inside(trial, time):.0f} %", mean)
    console.print(shown)


def _time(value: float | None, error: float = float("nan")) -> str:
    from imm_tdoa.reproduce.phase_difference.tables import seconds

    return seconds(value) if error != error else f"{seconds(value)} ± {seconds(error)}"
