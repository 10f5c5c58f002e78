"""``imm-tdoa reproduce receiver-errors``: Source D, computed."""

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
    from collections.abc import Mapping

    from rich.console import Console

    from imm_tdoa.reproduce.receiver_errors.whole import ReceiverErrors

DEFAULT = Path("imm-tdoa-out") / "receiver-errors"


class Weights(StrEnum):
    """What the weights of the two steps know of the receivers' errors."""

    BOTH = "both"
    FIRST = "first"
    NONE = "none"


def receiver_errors(
    runs: Annotated[int, options.runs(" of each point")] = 2000,
    seed: Annotated[int, options.seed("the noise")] = 1,
    receiver_weights: Annotated[
        Weights,
        typer.Option(
            help="Which steps of the two-step estimators weigh the receivers' errors: both (D1 "
            "and D2), the first (D1), none."
        ),
    ] = Weights.BOTH,
    out: OutFolder = DEFAULT,
) -> None:
    """Source D: TDOA and FDOA with uncertain receivers (CN112444776A).

    Six moving receivers that are not exactly where they say. Compares the first linear step, the
    squared and the error-correcting second step, the joint estimation of emitter and receivers,
    and trust in the receivers, with the Cramér-Rao bound; then over noise levels; then where the
    squared step fails.

    The weights as Source D may mean them, without the receivers' errors:

        imm-tdoa reproduce receiver-errors --receiver-weights none --out unweighted

    Writes table.csv, noise.csv, shared_coordinate.csv, summary.json and three pictures.
    """
    from imm_tdoa.reproduce import receiver_errors as source_d

    output.refuse_taken(out)
    with output.progress(source_d.steps() + 1) as advance:
        result = source_d.compute(runs, seed, receiver_weights.value, advance)
        advance("drawing")
        files = _write(out, result)
    console = output.console()
    _tell(console, result)
    output.written(console, out, files)


def _write(home: Path, result: ReceiverErrors) -> list[str]:
    from imm_tdoa.reproduce.receiver_errors import pictures, report, whole

    runs = min(result.table.runs, whole.SWEPT)
    draw = {
        "receiver-errors.png": partial(pictures.of_noise, result.curves, "receivers", runs),
        "measurement-noise.png": partial(pictures.of_noise, result.curves, "measurement", runs),
        "shared-coordinate.png": partial(pictures.of_coordinate, result.coordinate),
    }
    return folder.write(home, report.tables(result), draw, report.summary(result))


def _tell(console: Console, result: ReceiverErrors) -> None:
    from imm_tdoa.reproduce.receiver_errors import ESTIMATORS, RECONSTRUCTION

    table = result.table
    for which, unit, name in ((0, "m", "position"), (1, "m/s", "velocity")):
        output.heading(
            console,
            f"Source D: RMS error of the {name} [{unit}], {table.runs} runs"
            + ("; beneath, an independent program, 400 runs" if which == 0 else ""),
        )
        shown = output.table(
            [
                ("emitter, σ_d², σ_s²", False),
                ("bound", True),
                *((estimator, True) for estimator in ESTIMATORS),
                ("trusted, theory", True),
            ]
        )
        for point in table.points:
            case, theory = point.case, point.trusting[which]
            errors = {
                estimator: (s.position_rmse_m, s.velocity_rmse_mps)[which]
                for estimator, s in point.samples.items()
            }
            shown.add_row(
                f"{point.source}, {case.range_variance:g}, {case.receiver_variance:g}",
                output.number(point.bound[which]),
                *(output.number(errors[estimator]) for estimator in ESTIMATORS),
                output.number(theory),
            )
            reference = (point.reference_m, point.reference_mps)[which]
            if reference:
                shown.add_row(*_reference(reference, ESTIMATORS), style="dim")
        console.print(shown)
        output.heading(console, "")
    for note in _notes(result):
        console.print(output.escaped(note))
    console.print(output.escaped(RECONSTRUCTION))


def _reference(figures: Mapping[str, float], estimators: tuple[str, ...]) -> list[str]:
    names = ("bound", *estimators, "trusted-theory")
    return ["", *(output.number(figures.get(name)) for name in names)]


def _notes(result: ReceiverErrors) -> list[str]:
    points = result.table.points
    low = [point for point in points if point.efficient]
    worst = {
        name: max(
            max(s.position_rmse_m / p.bound[0], s.velocity_rmse_mps / p.bound[1])
            for p in low
            for s in (p.samples[name],)
        )
        for name in ("error-correction", "joint")
    }
    fallback = max(point.samples["joint"].fallback_share for point in points)
    last = points[-1]
    gains = [point.receiver_gain for point in low]
    k = int(abs(result.coordinate.away - 0.01).argmin())
    chance = 100.0 / (2.0 * result.table.runs) ** 0.5
    lines = [
        f"{result.table.runs} runs leave some ±{chance:.2g} % of an RMS error to chance, so it may "
        f"lie a little below its bound.",
        f"At low and moderate noise (all but the last row) the worst RMS error over its bound is "
        f"{worst['error-correction']:.3f} for error correction, {worst['joint']:.3f} for joint.",
        f"Joint estimation fell back to its initial value in {100.0 * fallback:.2g} % of the runs "
        f"of its worst row.",
        f"It brings the receivers' own errors to {min(gains):.2f} to {max(gains):.2f} of what "
        f"they were.",
        "Bias of the position in the last row: "
        + ", ".join(
            f"{name} {last.samples[name].bias_m:.0f} m"
            for name in ("squared", "error-correction", "joint")
        )
        + ".",
        f"An emitter {result.coordinate.away[k]:g} m from the reference receiver in x: velocity "
        f"error {result.coordinate.rmse('squared')[k, 1]:.3g} m/s with the squared step, "
        f"{result.coordinate.rmse('error-correction')[k, 1]:.3g} m/s with error correction, bound "
        f"{result.coordinate.bound[k, 1]:.3g} m/s.",
    ]
    return lines
