"""``imm-tdoa reproduce sequence-filter``: Source B, computed again."""

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

    from imm_tdoa.reproduce.sequence_filter import Reproduction

DEFAULT = Path("imm-tdoa-out") / "sequence-filter"


class Rule(StrEnum):
    """Process noise from the position increment."""

    ISO = "iso"
    PROJ = "proj"
    BOUND = "bound"


class Test(StrEnum):
    """What the gate judges."""

    POSTERIOR = "posterior"
    INNOVATION = "innovation"


def sequence_filter(
    runs: Annotated[int, options.runs()] = 50,
    seed: Annotated[int, options.seed("noise and geometries")] = 1,
    out: OutFolder = DEFAULT,
    rule: Annotated[
        Rule,
        typer.Option(
            help="How the process noise follows from the position increment, where targets move "
            "and in random geometries; the table of cases has all three."
        ),
    ] = Rule.ISO,
    test: Annotated[
        Test,
        typer.Option(
            help="What the gate judges: the filtered difference against the measured one (the "
            "source), or the innovation in its own standard deviations."
        ),
    ] = Test.POSTERIOR,
    reset_on_gate: Annotated[
        bool,
        typer.Option(
            "--reset-on-gate/--no-reset-on-gate",
            help="Whether a filter begins anew where its gate failed; the source's does not.",
        ),
    ] = False,
) -> None:
    """Source B: Kalman filtering of time-difference sequences (Xu & Hua 2020), its claims.

    The source claims that the spot of fixes of a target that stands shrinks to a point and the
    band of a slow one to a line; it gives no figures. Here are ours: when the spot shrinks and
    when it does not, the loop gain kappa that foretells it, in random geometries too, and what
    the narrow band costs in lag and total error.

    Example, with the worst-case rule:

        imm-tdoa reproduce sequence-filter --rule bound --out worst-case

    Writes cases.csv, moving.csv, jump.csv, geometries.csv, summary.json, and pictures of the spot
    and the band before and after and of what kappa foretells.
    """
    from imm_tdoa.reproduce import sequence_filter as source_b

    output.refuse_taken(out)
    switches = source_b.Switches(rule=rule.value, test=test.value, reset_on_gate=reset_on_gate)
    with output.progress(source_b.steps() + 1) as advance:
        result = source_b.compute(runs, seed, switches, advance)
        advance("drawing")
        files = _write(out, result)
    console = output.console()
    _tell(console, result)
    output.written(console, out, files)


def _write(home: Path, result: Reproduction) -> list[str]:
    from imm_tdoa.reproduce.sequence_filter import pictures, report

    draw = {
        "spot.png": partial(pictures.spot, result),
        "band.png": partial(pictures.band, result),
        "kappa.png": partial(pictures.prediction, result),
    }
    return folder.write(home, report.tables(result), draw, report.summary(result))


def _tell(console: Console, result: Reproduction) -> None:
    from imm_tdoa.reproduce.sequence_filter import RECONSTRUCTION, report

    output.heading(console, f"Source B, its claims, {result.runs} runs")
    shown = output.table([("the source claims", False), ("ours", False)])
    for claim in report.claims(result):
        shown.add_row(claim.claim, claim.ours)
    console.print(shown)
    console.print(output.escaped(RECONSTRUCTION))
    _tell_cases(console, result)
    _tell_moving(console, result)
    _tell_jump(console, result)
    _tell_geometries(console, result)


def _tell_cases(console: Console, result: Reproduction) -> None:
    from imm_tdoa.reproduce.sequence_filter import report

    output.heading(
        console, "\nTargets that stand; in brackets the figures of an independent program"
    )
    columns = ("kappa", "radius before / after", "error before / after", "error left [m]")
    shown = output.table([("", False), ("weights", False), *((c, True) for c in columns)])
    for outcome in result.outcomes:
        row = report.case_row(outcome)
        shown.add_row(
            outcome.case.label,
            outcome.weights,
            _beside(row["kappa"], row["reference_kappa"]),
            _beside(row["radius_ratio"], row["reference_radius_ratio"]),
            _beside(row["error_ratio"], row["reference_error_ratio"]),
            output.number(row["error_m"]),
        )
    console.print(shown)
    console.print(
        "iso, proj, bound: how the process noise follows from the position increment (--rule).\n"
        "weights diagonal: the fix takes adjacent differences as independent; full: as they are, "
        "correlated. A small spot is not a small error: the point stands still beside the target."
    )


def _tell_moving(console: Console, result: Reproduction) -> None:
    from imm_tdoa.reproduce.sequence_filter import report

    output.heading(console, f"\nTargets that move, {result.switches.rule}")
    columns = ("width before / after", "lag [m]", "error before [m]", "after [m]", "gain", "gated")
    shown = output.table([("m/s", True), ("weights", False), *((c, True) for c in columns)])
    for band in result.bands:
        row = report.band_row(band)
        shown.add_row(
            f"{band.speed_mps:g}",
            band.weights,
            _beside(row["width_ratio"], row["reference_width_ratio"]),
            _beside(row["lag_m"], row["reference_lag_m"]),
            _beside(row["raw_error_m"], row["reference_raw_error_m"]),
            _beside(row["error_m"], row["reference_error_m"]),
            output.number(row["mean_gain"]),
            f"{row['gate_failures']:.1%}",
        )
    console.print(shown)


def _tell_jump(console: Console, result: Reproduction) -> None:
    from imm_tdoa.reproduce.sequence_filter.moving import AFTER, JUMP_M

    output.heading(console, f"\nA target that stands and is suddenly {JUMP_M:g} m away: error [m]")
    shown = output.table([("", False), *((f"after {k}", True) for k in AFTER)])
    for jump in result.jumps:
        shown.add_row(jump.label, *(output.number(error) for error in jump.told.values()))
    console.print(shown)


def _tell_geometries(console: Console, result: Reproduction) -> None:
    from imm_tdoa.reproduce.sequence_filter import report

    output.heading(
        console,
        f"\nRandom geometries, {result.switches.rule}: kappa told right in {result.right} of "
        f"{len(result.geometries)}",
    )
    columns = ("stations", "kappa", "radius before / after", "error before / after")
    shown = output.table(
        [("dims", True), *((c, True) for c in columns), ("predicted", False), ("found", False)]
    )
    for geometry in result.geometries:
        row = report.geometry_row(geometry)
        shown.add_row(
            row["dims"],
            row["stations"],
            *(output.number(row[name]) for name in ("kappa", "radius_ratio", "error_ratio")),
            row["predicted"],
            row["found"],
        )
    console.print(shown)


def _beside(ours: float, reference: float) -> str:
    text = output.number(ours)
    return text if reference != reference else f"{text} ({output.number(reference)})"
