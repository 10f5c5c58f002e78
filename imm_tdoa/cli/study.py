"""``imm-tdoa study``: which bank, for these targets, this geometry and this noise?"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from imm_tdoa.cli import options, output

if TYPE_CHECKING:
    import xarray as xr

    from imm_tdoa.study import Progress as Step
    from imm_tdoa.study import Store, Study

SHOWN = 40  # rows of the table on the screen; the report has all


def study(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="STUDY",
            help="A shipped study or a TOML file; without it the shipped ones are listed.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        options.out_named_after("NAME OF THE STUDY", use="Folder to write to, and to go on from"),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Workers on this machine; default one per core. Results do not depend on it.",
            show_default=False,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="dask://HOST:PORT",
            help="The scheduler of a dask.distributed cluster, instead of this machine.",
            show_default=False,
        ),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Runs of each scenario; default the study's. More than before go on from there.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Seed of all runs; default the study's.", show_default=False
        ),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Delete what the folder holds of a study.")
    ] = False,
) -> None:
    """Run many simulated targets through several banks, and say which is best and how sure that is.

    Example, how large an acceleration must be before any criterion sees it:

        imm-tdoa study discrimination --out discrimination

    Writes tables, results.nc and report.html, which opens without a network. Interrupted at any
    moment, the same command goes on where it was.
    """
    from imm_tdoa import study as studies

    if name is None:
        _list(studies.shipped(), studies.load)
        return
    plan = studies.load(name, runs=runs, seed=seed)
    home = Path("imm-tdoa-out") / Path(name).stem if out is None else out
    output.refuse_taken(home)
    begun = time.perf_counter()
    with _progress() as tell:
        try:
            store = studies.run(
                plan, home, workers=workers, cluster=cluster, restart=restart, tell=tell
            )
        except (KeyboardInterrupt, SystemExit):
            _tell_interrupted(plan, studies.Store(home))
            raise
        except OSError as error:
            _blame(error, plan, studies.Store(home))
            raise
        computed = time.perf_counter() - begun
        found = studies.collect(plan, store)
        files = studies.write(found, plan, store, home)
    seconds = time.perf_counter() - begun
    console = output.console()
    _tell(console, plan, found)
    _tell_cost(console, plan, store, computed, seconds)
    output.written(console, home, [*files, "study.toml", "chunks"])
    if "report.html" in files:
        console.print(output.escaped(f"report: {home / 'report.html'}"), soft_wrap=True)


def _list(names: Sequence[str], load: Callable[[str], Study]) -> None:
    console = output.console()
    for name in names:
        plan = load(name)
        output.heading(console, name)
        scenarios, banks = len(plan.scenarios), len(plan.banks)
        what = f"{scenarios} scenarios × {banks} banks × {plan.runs} runs"
        for line in (plan.title, " ".join(plan.question.split()), what):
            console.print(output.escaped(f"  {line}"))


@contextmanager
def _progress() -> Iterator[Callable[[Step], None]]:
    """Show how far the study is and how long it will take, on a terminal."""
    err = Console(stderr=True)
    if not err.is_terminal:
        yield lambda _: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("", total=None)

        def tell(step: Step) -> None:
            bar.update(task, completed=step.done, total=step.total, description=step.what)

        yield tell


def _kept(plan: Study, store: Store) -> str:
    chunks = [(case, len(plan.chunks(case))) for case in plan.scenarios]
    there = sum(count - len(store.missing(plan, case)) for case, count in chunks)
    return f"{there} of {sum(count for _, count in chunks)} chunks are kept in {store.folder}"


def _tell_interrupted(plan: Study, store: Store) -> None:
    if (store.folder / "study.toml").is_file():
        line = f"interrupted: {_kept(plan, store)}; the same command goes on from there"
        print(f"imm-tdoa: {line}", file=sys.stderr)


def _blame(error: OSError, plan: Study, store: Store) -> None:
    """Add to an error of the disk what is safe."""
    if (store.folder / "chunks").is_dir():
        error.strerror = (
            f"{error.strerror or error}: {_kept(plan, store)} and valid; make room and run the "
            f"same command again"
        )


def _tell(console: Console, plan: Study, found: xr.Dataset) -> None:
    from imm_tdoa.study import conclude

    output.heading(console, f"{plan.title} ({plan.runs} runs)")
    table = output.table(
        [
            ("scenario", False),
            ("bank", False),
            ("RMSE [m]", True),
            (f"{100 * plan.confidence:g} %", True),
            ("like", False),
            ("NEES / dims", True),
            ("failed", True),
        ]
    )
    rows = [(case.name, bank.name) for case in plan.scenarios for bank in plan.banks]
    for scenario, bank in rows[:SHOWN]:
        one = found.sel(scenario=scenario, bank=bank)
        low, high = (float(one[f"position_rmse_{end}"]) for end in ("low", "high"))
        table.add_row(
            scenario if bank == plan.banks[0].name else "",
            bank,
            output.number(float(one["position_rmse"]), 4),
            f"{output.number(low, 4)} – {output.number(high, 4)}",
            str(one["letters"].item()),
            output.number(float(one["nees_ratio"]), 3),
            str(int(one["failed"])),
        )
    console.print(table)
    console.print(
        "like: banks of one scenario that share a letter cannot be told apart; a: the best"
    )
    if len(rows) > SHOWN:
        console.print(output.escaped(f"… and {len(rows) - SHOWN} more in summary.csv"))
    said = conclude(found)
    output.heading(console, "\nWhat to conclude")
    for sentence in said.get("", ()):
        console.print(output.escaped(f"  {sentence}"))
    for case in plan.scenarios[:SHOWN]:
        for sentence in said.get(case.name, ())[:1]:
            console.print(output.escaped(f"  {case.name}: {sentence}"))


def _tell_cost(
    console: Console, plan: Study, store: Store, computed: float, seconds: float
) -> None:
    """How long it took, and what one step of each bank's filter costs."""
    total: Any = 0.0
    steps = 0
    for case in plan.scenarios:
        for path in store.chunks(case.name):
            total = total + store.cost(path)
            steps += store.steps(path)
    output.heading(console, "\nCost")
    table = output.table([("bank", False), ("engine", False), ("µs per filter step", True)])
    for bank, engine, spent in zip(plan.banks, store.engines, total, strict=True):
        table.add_row(bank.name, engine, output.number(1e6 * spent / steps, 3))
    console.print(table)
    runs, every = plan.runs * len(plan.scenarios), steps * len(plan.banks)
    console.print(
        output.escaped(
            f"{runs} runs of {len(plan.banks)} banks, {every} filter steps; this time "
            f"{computed:.1f} s to run what was missing and {seconds - computed:.1f} s for tables "
            f"and report, {seconds:.1f} s in all"
        )
    )
