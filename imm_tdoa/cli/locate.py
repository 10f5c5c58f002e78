"""``imm-tdoa locate``: a position from every scan on its own."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from imm_tdoa.cli import options, output, recordings
from imm_tdoa.cli.options import RecordingFolder

if TYPE_CHECKING:
    from imm_tdoa.cli.fixes import Fixes
    from imm_tdoa.contract import Array
    from imm_tdoa.recording import Recording

LISTED = 12  # targets in the printed table
REASONS = 4


class Method(StrEnum):
    """Ways to a fix."""

    GAUSS_NEWTON = "gauss-newton"
    CHAN_HO = "chan-ho"
    TWO_STEP = "two-step"
    JOINT = "joint"


def locate(
    recording: RecordingFolder = None,
    method: Annotated[
        Method,
        typer.Option(
            metavar="METHOD",
            help="gauss-newton: least squares, takes everything. chan-ho: closed form, for scans "
            "of time differences that no station is missing from. two-step: closed form that knows "
            "of receiver errors (--station-sigma). joint: corrects the receivers along with it.",
        ),
    ] = Method.GAUSS_NEWTON,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust/--no-robust",
            help="Whether gauss-newton weighs gross errors down (Student-t), where a scan has "
            "rows to spare.",
        ),
    ] = True,
    station_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Standard deviation of each coordinate of the stations, m; default: they are "
            "exactly where they say.",
            show_default=False,
        ),
    ] = None,
    sequence_filter: Annotated[
        bool,
        typer.Option(
            "--sequence-filter",
            help="Filter the sequences of time differences of adjacent stations first (Source B): "
            "steadies an emitter that stands, lags behind one that moves. Least squares, not "
            "robust.",
        ),
    ] = False,
    out: Annotated[Path | None, options.out_named_after("NAME OF THE RECORDING-fixes")] = None,
) -> None:
    """Locate the emitter from each scan on its own, no motion assumed.

    Writes fixes.csv (position, standard deviations, chi2, mirror solutions), summary.json, and
    gdop.png: where the stations locate well, and the fixes; with truth also error.png.

    Example, arrivals some of which are grossly wrong:

        imm-tdoa simulate outliers --out outliers

        imm-tdoa locate outliers --out fixes

    Look at fixes/gdop.png: are the fixes where the stations locate well? And at fixes/error.png:
    are the errors mostly below the line?
    """
    from imm_tdoa.recording import read

    with recordings.folder(recording) as place:
        data = read(place)
        home = output.folder(out, place, "-fixes")
    if station_sigma is not None:
        from imm_tdoa.cli.receiver_aware import with_station_errors

        data = with_station_errors(data, station_sigma)
    robust = robust and method is Method.GAUSS_NEWTON and not sequence_filter
    stages: dict[str, Any] = {}
    with output.progress(None) as advance:
        if sequence_filter:
            found, failed, stages = _filtered(data, method, advance)
        else:
            found, failed = _locate(data, method, robust, advance)
        if not found:
            name, reason = next(iter(failed.items()))
            raise ValueError(
                reason if len(failed) == 1 else f"no target can be located: {name!r}: {reason}"
            )
        advance("writing and drawing")
        home.mkdir(parents=True, exist_ok=True)
        files = _write(home, data, found)
    facts = {
        "title": data.title,
        "recording": place.resolve().name,
        "method": method.value,
        "robust": "student-t" if robust else None,
        "station_sigma_m": station_sigma,
        **stages,
    }
    summary = _summary(facts, data, found, failed)
    summary["files"] = sorted([*files, "summary.json"])
    output.write_json(home / "summary.json", summary)
    _tell(data, summary, home, method)


def _locate(
    data: Recording, method: Method, robust: bool, advance: Any
) -> tuple[dict[str, Fixes], dict[str, str]]:
    """Fixes by target, and the reasons of those that have none."""
    from imm_tdoa.cli import fixes

    if method is Method.GAUSS_NEWTON:
        return fixes.gauss_newton(
            data, data.targets, robust, lambda who: advance(f"locating {who}")
        )
    from imm_tdoa.cli.closed_form import closed_form
    from imm_tdoa.cli.receiver_aware import receiver_aware

    found: dict[str, Fixes] = {}
    failed: dict[str, str] = {}
    for name in data.targets:
        advance(f"locating {name}")
        try:
            if method is Method.CHAN_HO:
                found[name] = closed_form(data, name)
            else:
                which: Any = method.value
                found[name] = receiver_aware(data, name, which)
        except ValueError as error:
            failed[name] = str(error)
    return found, failed


def _filtered(
    data: Recording, method: Method, advance: Any
) -> tuple[dict[str, Fixes], dict[str, str], dict[str, Any]]:
    """Fixes from filtered sequences as from `_locate`, and what the summary says of the filter."""
    if method is not Method.GAUSS_NEWTON:
        raise ValueError(
            f"--sequence-filter: expected --method gauss-newton, got {method.value}: the filter "
            f"needs a fix of every scan from whatever differences are there"
        )
    from imm_tdoa.cli import sequences

    found: dict[str, Fixes] = {}
    failed: dict[str, str] = {}
    facts: dict[str, Any] = {}
    for name in data.targets:
        advance(f"filtering {name}")
        try:
            found[name], result = sequences.filtered_fixes(data, name)
        except ValueError as error:
            failed[name] = str(error)
            continue
        facts[name] = sequences.facts(data, name, result)
    return found, failed, {"sequence_filter": {**sequences.SETTINGS, "targets": facts}}


def _write(home: Path, data: Recording, found: Mapping[str, Fixes]) -> list[str]:
    from imm_tdoa import plot
    from imm_tdoa.cli import fixes

    output.write_table(home / "fixes.csv", fixes.table(found, data))
    every = fixes.together(found)
    good = every.good
    times = every.times[good] if np.any(good) else every.times
    true = [data.truth_at(name, f.times)[0] for name, f in found.items()]
    true_places = np.concatenate(true)
    plot.gdop(
        data.stations,
        every.located,
        truth=true_places[np.isfinite(true_places).all(axis=-1)],
        time=float(np.median(times)),
        title=data.title,
        path=home / "gdop.png",
    )
    errors, bound = _errors(data, found)
    if not len(errors):
        return ["fixes.csv", "gdop.png"]
    distance = np.linalg.norm(errors, axis=-1)
    plot.calibration(bound, distance, title=data.title, path=home / "error.png")
    return ["fixes.csv", "gdop.png", "error.png"]


def _errors(data: Recording, found: Mapping[str, Fixes]) -> tuple[Array, Array]:
    """Errors (N, a) of all fixes of which the truth is known, and their own 95 % bounds (N,)."""
    parts = [fixes.errors(data, name) for name, fixes in found.items()]
    error = np.concatenate([part[0] for part in parts])
    bound = np.concatenate([part[1] for part in parts])
    known = np.isfinite(error).all(axis=-1)
    return error[known], bound[known]


def _figures(data: Recording, found: Mapping[str, Fixes]) -> dict[str, Any]:
    """Counts, and error quartiles; null where there is no truth."""
    good = sum(int(np.count_nonzero(f.good)) for f in found.values())
    scans = sum(len(f.times) for f in found.values())
    errors, _ = _errors(data, found)
    result: dict[str, Any] = {
        "scans": scans,
        "converged": good,
        "ambiguous": sum(int(np.count_nonzero(f.ambiguous)) for f in found.values()),
        "failed": scans - good,
        "position_error_quartiles_m": _quartiles(errors),
    }
    if data.dims == 3:
        result["horizontal_error_quartiles_m"] = _quartiles(errors[:, :2])
    return result


def _quartiles(errors: Array) -> list[float] | None:
    if not len(errors):
        return None
    quartiles = np.quantile(np.linalg.norm(errors, axis=-1), [0.25, 0.5, 0.75])
    return [float(q) for q in quartiles]


def _summary(
    facts: Mapping[str, Any],
    data: Recording,
    found: Mapping[str, Fixes],
    failed: Mapping[str, str],
) -> dict[str, Any]:
    """What summary.json holds."""
    return {
        **facts,
        "overall": {"targets": len(found), **_figures(data, found)},
        "targets": {name: _figures(data, {name: fixes}) for name, fixes in found.items()},
        "not_located": dict(failed),
    }


def _tell(data: Recording, summary: Mapping[str, Any], home: Path, method: Method) -> None:
    """Print a short table and where everything is."""
    out = output.console()
    overall, targets = summary["overall"], summary["targets"]
    quartiles = [
        (key, heading)
        for key, heading in (
            ("position_error_quartiles_m", "error 25 / 50 / 75 % [m]"),
            ("horizontal_error_quartiles_m", "horizontal 25 / 50 / 75 % [m]"),
        )
        if overall.get(key) is not None
    ]
    counts = ("scans", "converged", "ambiguous", "failed")
    robust = ", robust" if summary["robust"] else ""
    stage = ", filtered sequences" if "sequence_filter" in summary else ""
    output.heading(out, f"{data.title or summary['recording']}\n{method.value}{robust}{stage}\n")
    table = output.table(
        [("target", False), *((c, True) for c in counts), *((h, True) for _, h in quartiles)],
    )
    rows = [*list(targets.items())[:LISTED], *([("all", overall)] if len(targets) > 1 else [])]
    for name, row in rows:
        cells = [" / ".join(output.number(q) for q in row[key] or ()) for key, _ in quartiles]
        table.add_row(
            output.escaped(name),
            *(str(row[c]) for c in counts),
            *(cell or "-" for cell in cells),
            style="bold" if row is overall else None,
        )
    out.print(table)
    if len(targets) > LISTED:
        out.print(f"{len(targets) - LISTED} more targets are in summary.json")
    if not quartiles:
        out.print("no truth to compare with")
    if "sequence_filter" in summary:
        from imm_tdoa.cli import sequences

        for note in sequences.notes(summary["sequence_filter"]["targets"], LISTED):
            out.print(output.escaped(note))
    failed = summary["not_located"]
    for name, reason in list(failed.items())[:REASONS]:
        out.print(output.escaped(f"not located: {name}: {reason}"))
    if len(failed) > REASONS:
        out.print(f"and {len(failed) - REASONS} more, in summary.json")
    output.written(out, home, summary["files"])
