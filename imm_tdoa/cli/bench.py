"""``imm-tdoa bench``: how fast it is on this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from imm_tdoa.cli import output
from imm_tdoa.cli.options import OutFolder

if TYPE_CHECKING:
    from imm_tdoa.bench import Figure, Measured

DEFAULT = Path("imm-tdoa-out") / "bench"
BUSY = 0.5  # processes at work beforehand, per processor, from which figures are not to be trusted


class Part(StrEnum):
    """Measurements."""

    BATCH = "batch"
    STREAMING = "streaming"
    SOURCE_A = "source-a"
    SINGLE_ROWS = "single-rows"
    ENGINES = "engines"
    SCALING = "scaling"
    EMITTERS = "emitters"
    STUDY = "study"
    MEMORY = "memory"
    COLD_START = "cold-start"


def bench(
    quick: Annotated[
        bool, typer.Option("--quick", help="Smaller jobs, fewer repetitions: about a minute.")
    ] = False,
    only: Annotated[
        list[Part] | None,
        typer.Option(
            metavar="NAME",
            help=f"Measure this alone; may be given several times: {', '.join(Part)}.",
            show_default=False,
        ),
    ] = None,
    out: OutFolder = DEFAULT,
) -> None:
    """Measure how fast it is on this machine, beside filterpy on the same data, against its goals.

    Example, the batch and the stream alone, on an otherwise idle machine:

        imm-tdoa bench --only batch --only streaming

    The whole takes ten to twenty minutes; the very first time, compiling is added. Every figure is
    the median of several repetitions (the smallest and the largest stand beside it), and ratios
    are of things timed in turns. Without --quick a repetition is made again, for a second at most,
    where a virtual machine's host has lent the processors to others meanwhile (steal time, over a
    fiftieth of it); the column "again" counts these, and the whole takes longer.

    * **batch**: 16384 targets, 50 scans, against filterpy, in one thread and in two
    * **streaming**: one target through IMM.step, against filterpy
    * **source-a**: the three targets and 20 scans of Source A
    * **single-rows**: one target, 30000 differences one pair at a time
    * **engines**: NumPy against compiled, and what gate and student-t cost
    * **scaling**: cost against targets (to a million), scans, modes, stations, threads
    * **emitters**: time per scan of 10 to 200 labelled aircraft, of 5 to 50 unlabelled emitters
    * **study**: 4 banks, 3 scenarios, 1000 runs of 60 scans, against filterpy in a loop
    * **memory**: a million targets through 50 scans
    * **cold-start**: import, the shipped sample, and compiling, in fresh processes

    Writes figures.csv, points.csv, bench.json (machine and versions in it) and pictures.
    """
    from imm_tdoa import bench as measurements
    from imm_tdoa.bench import machine, report

    output.refuse_taken(out)
    out.mkdir(parents=True, exist_ok=True)  # refused before it is measured, not after
    about = machine.describe()
    names = [part.value for part in only or ()]
    console = output.console()
    output.heading(console, machine.in_words(about))
    load = about["load_before"]
    if load is not None and load > BUSY * about["processors"]:
        console.print(
            f"others are computing on this machine (load {load:.1f}): the figures are worse than "
            f"they would be on an idle one",
            soft_wrap=True,
        )
    found: list[Measured] = []
    try:
        with _progress(len(names) or len(Part)) as tell:
            for measured in measurements.run(names, quick, tell):
                found.append(measured)
                _tell(console, measured)
    finally:  # what was measured before something failed, or was interrupted, is kept
        if found:
            _tell_goals(console, found)
            files = report.write(found, {**about, "quick": quick}, out)
            output.written(console, out, files)


@contextmanager
def _progress(total: int) -> Iterator[Callable[[int, str], None]]:
    """Show how many measurements are done and what is being measured, on a terminal."""
    err = Console(stderr=True)
    if not err.is_terminal:
        yield lambda done, what: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda done, what: bar.update(task, completed=done, description=what)


def _tell(console: Console, measured: Measured) -> None:
    output.heading(console, f"\n{measured.name}: {measured.title}")
    if measured.figures:
        table = output.table(
            [
                *(("", False), ("median", True), ("", False), ("from", True), ("to", True)),
                *(("of", True), ("again", True), ("goal", False), ("", False)),
            ]
        )
        for figure in measured.figures:
            table.add_row(*_cells(figure))
        console.print(table)
    if measured.points:
        table = output.table([("against", False), ("", True), ("µs per target-step", True)])
        last = ""
        for point in measured.points:
            name = (
                point.against if point.curve == "one thread" else f"{point.against}, {point.curve}"
            )
            shown = name if name != last else ""
            table.add_row(output.escaped(shown), f"{point.x:g}", output.number(point.cost))
            last = name
        console.print(table)
    for note in measured.notes:
        console.print(output.escaped(note), soft_wrap=True)


def _cells(figure: Figure) -> list[str]:
    goal, several = figure.goal, figure.repetitions > 1
    return [
        figure.what,
        output.number(figure.value),
        figure.unit,
        output.number(figure.low) if several else "",
        output.number(figure.high) if several else "",
        str(figure.repetitions),
        str(figure.again) if figure.again else "",
        "" if goal is None else f"{goal.sense} {goal.limit:g}",
        figure.verdict,
    ]


def _tell_goals(console: Console, found: list[Measured]) -> None:
    verdicts = [figure.verdict for measured in found for figure in measured.figures]
    met, missed = verdicts.count("met"), verdicts.count("missed")
    if met + missed:
        output.heading(console, f"\n{met} of {met + missed} goals met")
