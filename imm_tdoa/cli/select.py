"""``imm-tdoa select``: which motion model explains a target's measurements."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import attrs
import numpy as np
import typer

from imm_tdoa.cli import options, output, recordings, verdicts
from imm_tdoa.cli.options import RecordingFolder, RobustOption, Targets

if TYPE_CHECKING:
    from imm_tdoa.bank import Bank
    from imm_tdoa.cycle import RobustRule
    from imm_tdoa.recording import Recording
    from imm_tdoa.selection import Comparison

PICTURED = 6  # targets that get pictures of their own


@attrs.frozen(eq=False)
class Result:
    """One target: what the comparison found, and how long it took, s."""

    found: Comparison
    seconds: float


def select(
    recording: RecordingFolder = None,
    bank: Annotated[str, options.bank("Whose modes are the candidates")] = "static-cv-ca",
    robust: RobustOption = None,
    window: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Judge by the last N scans only, for a target that may have changed its motion; "
            "default all.",
            show_default=False,
        ),
    ] = None,
    velocity_std: Annotated[
        float | None,
        typer.Option(
            metavar="M/S",
            help="Standard deviation of what is believed of each velocity component beforehand; "
            "default the bank's.",
            show_default=False,
        ),
    ] = None,
    acceleration_std: Annotated[
        float | None,
        typer.Option(
            metavar="M/S²",
            help="The same of each acceleration component; default the bank's.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path | None, options.out_named_after("NAME OF THE RECORDING-select")] = None,
    target: Targets = None,
) -> None:
    """Say which motion each target of a recording was in: it stood, moved straight on, or …

    Every mode of the bank runs alone on the same measurements. The most probable one is chosen,
    unless its own innovations reject it or its lead is too small to tell; then the verdict is
    imm: keep all modes (`imm-tdoa track`). Writes select.csv, summary.json and evidence.png.

    Example, three targets much faster than the default bank believes:

        imm-tdoa simulate source-a --out source-a

        imm-tdoa select source-a --velocity-std 3000 --acceleration-std 300

    Look at evidence.png: where does one model fall behind the other, and does it stay there? A
    target that changes its motion fits no simple model as a whole; --window 20 asks about now.
    """
    from imm_tdoa import bankfile

    chosen = bankfile.load(bank)
    if window is not None and window < 1:
        raise ValueError(f"--window: expected a number of scans, 1 or more, got {window}")
    with recordings.folder(recording) as place:
        from imm_tdoa.recording import read

        data = read(place)
        home = output.folder(out, place, "-select")
    names = recordings.targets(data, target)
    chosen = _believing(chosen, velocity_std, acceleration_std)
    with output.progress(len(names)) as advance:
        rule = options.rule_of(robust)
        results, failed = _compare_all(data, chosen, names, rule, window, advance)
        if not results:
            recordings.refuse_without_any(failed, "judged")
        advance("writing and drawing")
        home.mkdir(parents=True, exist_ok=True)
        files = [*_write(home, results), *_draw(home, data, results)]
    facts = {
        "title": data.title,
        "recording": place.resolve().name,
        "bank": bank,
        "models": list(chosen.names),
        "robust": rule,
        "window": window,
    }
    summary = _summary(facts, results, failed)
    summary["files"] = sorted([*files, "summary.json"])
    output.write_json(home / "summary.json", summary)
    verdicts.tell(summary, {name: result.found for name, result in results.items()}, home)


def _believing(bank: Bank, velocity_std: float | None, acceleration_std: float | None) -> Bank:
    """The bank with the birth law that was asked for."""
    given = {"velocity": velocity_std, "acceleration": acceleration_std}
    for name, value in given.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise ValueError(f"--{name}-std: expected a number above 0, got {value:g}")
    asked = {name: value for name, value in given.items() if value is not None}
    return attrs.evolve(bank, birth_std={**bank.birth_std, **asked})


def _compare_all(
    data: Recording,
    bank: Bank,
    names: Sequence[str],
    robust: RobustRule | None,
    window: int | None,
    advance: Any,
) -> tuple[dict[str, Result], dict[str, str]]:
    """Judge each target on its own; return results, and the reasons of those that failed."""
    from imm_tdoa.selection import compare

    results: dict[str, Result] = {}
    failed: dict[str, str] = {}
    for name in names:
        advance(f"comparing models on {name}")
        begun = time.perf_counter()
        try:
            scans = data.scans(name)
            found = compare(
                bank,
                scans.measurement,
                scans.times,
                scans.values,
                pairs=scans.pairs,
                update="iekf",
                robust=robust,
                window=window,
            )
        except ValueError as error:
            failed[name] = str(error)
            continue
        results[name] = Result(found, time.perf_counter() - begun)
    return results, failed


def _write(home: Path, results: Mapping[str, Result]) -> list[str]:
    """One row per target and model."""
    from imm_tdoa.recording.table import Table

    rows = [
        {
            "target": name,
            "model": row["model"],
            **{key: row[key] for key in _FIGURES},
            "nis": "rejected" if not row["accepted"] else "accepted",
            "verdict": str(result.found.verdict),
        }
        for name, result in results.items()
        for row in result.found.table()
    ]
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    output.write_table(home / "select.csv", Table(columns))
    return ["select.csv"]


_FIGURES = (
    "log_evidence",
    "probability",
    "bayes_factor",
    "aic",
    "bic",
    "nis_ratio",
    "nis_p",
)


def _draw(home: Path, data: Recording, results: Mapping[str, Result]) -> list[str]:
    """All targets together, and each on its own where they are few."""
    from imm_tdoa import plot

    found = {name: result.found for name, result in results.items()}
    plot.evidence(found, title=data.title, path=home / "evidence.png")
    files = ["evidence.png"]
    if 1 < len(found) <= PICTURED:
        for name, one in found.items():
            file = f"evidence-{output.file_name(name)}.png"
            title = f"{data.title}: {name}" if data.title else name
            plot.evidence(one, title=title, path=home / file)
            files.append(file)
    return files


def _summary(
    facts: Mapping[str, Any], results: Mapping[str, Result], failed: Mapping[str, str]
) -> dict[str, Any]:
    """What summary.json holds."""
    first = next(iter(results.values())).found
    every = [str(result.found.verdict) for result in results.values()]
    overall = {
        "targets": len(results),
        "verdicts": {name: every.count(name) for name in (*first.names, "imm")},
        "seconds": sum(result.seconds for result in results.values()),
    }
    targets = {
        name: {
            "verdict": str(result.found.verdict),
            "reason": str(result.found.reason),
            "best": result.found.names[int(result.found.best)],
            "runner_up": result.found.names[int(result.found.runner_up)],
            "margin": float(result.found.margin),
            "scans": len(result.found.times),
            "rows": int(result.found.rows),
            "seconds": result.seconds,
            "models": {row.pop("model"): row for row in result.found.table()},
        }
        for name, result in results.items()
    }
    settings = {"birth_std": dict(first.birth_std), "prior": first.prior.tolist()}
    return {**facts, **settings, "overall": overall, "targets": targets, "failed": dict(failed)}
