"""``imm-tdoa reproduce motion-form``: Source A, computed again."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imm_tdoa.cli import options, output
from imm_tdoa.cli.options import OutFolder
from imm_tdoa.cli.reproduce import folder

if TYPE_CHECKING:
    from rich.console import Console

    from imm_tdoa.reproduce.motion_form.whole import MotionForm

DEFAULT = Path("imm-tdoa-out") / "motion-form"
SCENARIOS = ("scenario-1", "scenario-2", "scenario-3")


class Sign(StrEnum):
    """Sign of time differences."""

    SLAVE_MASTER = "slave-master"
    EQ8 = "eq8"


class Columns(StrEnum):
    """Velocity and acceleration columns of the Jacobian."""

    ZEROS = "zeros"
    DT_SCALED = "dt-scaled"


class Noise(StrEnum):
    """Errors of the simulated differences."""

    INDEPENDENT = "independent"
    CORRELATED = "correlated"


class NoiseCovariance(StrEnum):
    """The estimators' R."""

    FULL = "full"
    DIAGONAL = "diagonal"


class StaticRow(StrEnum):
    """Static estimators."""

    PER_EPOCH = "per-epoch"
    RECURSIVE = "recursive"


class Mixing(StrEnum):
    """Mixing rules."""

    BIRTH = "birth"
    UNBIASED = "unbiased"
    ZERO = "zero"


def motion_form(
    runs: Annotated[int, options.runs(" of the three targets")] = 100,
    seed: Annotated[int, options.seed("the noise")] = 1,
    out: OutFolder = DEFAULT,
    tdoa_sign: Annotated[
        Sign,
        typer.Option(
            help="eq8: data and prediction of the static estimators master minus slave, the "
            "Jacobian slave minus master, as printed; they diverge."
        ),
    ] = Sign.SLAVE_MASTER,
    jacobian: Annotated[
        Columns,
        typer.Option(help="dt-scaled: velocity and acceleration columns as printed in (29)."),
    ] = Columns.ZEROS,
    noise: Annotated[
        Noise,
        typer.Option(
            help="Errors of the simulated differences: independent, as the paper's R supposes, or "
            "correlated, as differences against one master are."
        ),
    ] = Noise.INDEPENDENT,
    noise_covariance: Annotated[
        NoiseCovariance,
        typer.Option(
            help="The estimators' R: the noise's, or its diagonal as printed; they differ with "
            "--noise correlated."
        ),
    ] = NoiseCovariance.FULL,
    process_noise: Annotated[
        float,
        typer.Option(
            min=0.0,
            metavar="Q",
            help="Density of every model's white noise: km²/s, km²/s³, km²/s⁵ for static, constant "
            "velocity, constant acceleration. 0: none, as printed in (26).",
        ),
    ] = 0.0,
    static: Annotated[
        StaticRow,
        typer.Option(help="Which static estimator stands beside the paper's 0.982 km."),
    ] = StaticRow.PER_EPOCH,
    mixing: Annotated[
        Mixing,
        typer.Option(help="The IMM's mixing rule in comparisons; all three are computed."),
    ] = Mixing.BIRTH,
) -> None:
    """Source A: TDOA location by target motion form (Li, Liu & Li 2024), its Table 1 and more.

    Computes Table 1 beside the paper's figures; then one IMM, never told the motion, in the place
    of the paper's choice between filters; then targets that stand, set off and accelerate, against
    every single filter of a sweep over models and noise levels.

    The defaults are what is right; options take single things as the paper printed them:

        imm-tdoa reproduce motion-form --jacobian dt-scaled --out as-printed

    Writes table1.csv, imm.csv, switching.csv, sweep.csv, summary.json, and a picture of each
    scenario, of the switching targets and of the sweep.
    """
    from imm_tdoa.reproduce import motion_form as source_a

    output.refuse_taken(out)
    switches = source_a.Switches(
        tdoa_sign=tdoa_sign.value,
        jacobian=jacobian.value,
        noise=noise.value,
        noise_covariance=noise_covariance.value,
        process_noise=process_noise,
        static=static.value,
        mixing=mixing.value,
    )
    with output.progress(source_a.steps() + 1) as advance:
        result = source_a.compute(runs, seed, switches, advance)
        advance("drawing")
        files = _write(out, result)
    console = output.console()
    _tell(console, result)
    output.written(console, out, files)


def _write(home: Path, result: MotionForm) -> list[str]:
    from imm_tdoa.reproduce.motion_form import pictures, pictures_switching, report

    draw = {
        **{f"{name}.png": partial(pictures.of_scenario, result.table, name) for name in SCENARIOS},
        "switching.png": partial(pictures_switching.over_time, result),
        "sweep.png": partial(pictures_switching.sweep, result),
    }
    return folder.write(home, report.tables(result), draw, report.summary(result))


def _tell(console: Console, result: MotionForm) -> None:
    from imm_tdoa.reproduce.motion_form import RECONSTRUCTION

    table = result.table
    output.heading(
        console, f"Source A, Table 1: mean position error [km], {table.runs} runs of three targets"
    )
    shown = output.table(
        [("", False), *((word, True) for word in ("paper", "ours", "±", "theory", "bound"))]
    )
    for row in table.rows:
        sample = row.sample
        shown.add_row(
            row.label,
            _km(row.paper_km),
            "diverges" if sample is None else _km(sample.mean_km),
            "" if sample is None else _km(sample.standard_error_km),
            _km(None if row.predicted_km is None else float(row.predicted_km.mean())),
            _km(None if row.bound_km is None else float(row.bound_km.mean())),
        )
    console.print(shown)
    for note in (RECONSTRUCTION, *_notes(result)):
        console.print(output.escaped(note))
    _tell_rivals(console, result)
    _tell_switching(console, result)


def _notes(result: MotionForm) -> list[str]:
    switches, notes = result.switches, []
    iterates = result.table.iterates_km
    if iterates is not None:
        steps = ", ".join(_km(float(e)) for e in iterates)
        notes.append(
            f"With (8) as printed the error of the static iteration doubles each time: {steps} km "
            f"without noise. The moving filters follow (21), which is right, from a right fix."
        )
    if switches.noise_covariance == "diagonal" and switches.noise == "independent":
        notes.append(
            "Independent noise has a diagonal covariance: --noise-covariance makes a difference "
            "with --noise correlated."
        )
    if switches.jacobian == "dt-scaled" or switches.tdoa_sign == "eq8":
        notes.append("What follows is computed with the right sign and Jacobian.")
    return notes


def _tell_rivals(console: Console, result: MotionForm) -> None:
    from imm_tdoa.reproduce.motion_form import MODELS

    output.heading(console, "\nOne IMM that is not told the motion: mean position error [km]")
    rules = list(result.rivals[0].imms)
    chosen = result.switches.mixing
    shown = output.table(
        [
            ("targets", False),
            *((word, True) for word in ("static", "CV", "CA")),
            *((f"IMM {rule}", True) for rule in rules),
            (f"IMM {chosen} / matched", True),
        ]
    )
    for rivals in result.rivals:
        ratio, error = rivals.cost(chosen)
        shown.add_row(
            rivals.motion,
            *(_km(rivals.singles[m].mean_km) for m in MODELS),
            *(_km(rivals.imms[rule].mean_km) for rule in rules),
            f"{ratio:.3f} ± {error:.3f}",
        )
    console.print(shown)


def _tell_switching(console: Console, result: MotionForm) -> None:
    best, switching = result.sweep.best, result.switching
    output.heading(console, "\nTargets that stand, set off, accelerate: mean position error [km]")
    shown = output.table([("", False), ("mean", True), ("±", True), ("of the best single", True)])
    every: list[tuple[str, Any]] = [(f"IMM {rule}", s) for rule, s in switching.imms.items()]
    what = f"best single: {best.model}, process noise {best.process_noise:.2g} (sweep.png)"
    for label, sample in [*every, (what, best.sample)]:
        ratio, error = sample.ratio(best.sample)
        share = "" if sample is best.sample else f"{ratio:.3f} ± {error:.3f}"
        shown.add_row(label, _km(sample.mean_km), _km(sample.standard_error_km), share)
    bound = float(switching.bound_km.mean())
    shown.add_row("bound of a tracker told when, not how fast", _km(bound), "", "")
    console.print(shown)


def _km(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
