"""``imm-tdoa track``: from a recording to tracks, figures of merit and pictures."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import attrs
import numpy as np
import typer

from imm_tdoa.cli import output, recordings
from imm_tdoa.cli.recordings import RecordingFolder, RobustOption, Targets

if TYPE_CHECKING:
    from imm_tdoa.bank import Bank
    from imm_tdoa.cycle import RobustRule
    from imm_tdoa.recording import Recording
    from imm_tdoa.scoring import Errors
    from imm_tdoa.track import Track

PICTURED = 6  # targets that get pictures of their own
LISTED = 12  # targets in the printed table
REASONS = 4  # reasons printed why targets were not tracked


class Engine(StrEnum):
    """What computes."""

    AUTO = "auto"
    NUMPY = "numpy"
    COMPILED = "compiled"


@attrs.frozen(eq=False)
class Result:
    """One target: its track, its errors where there is truth, and how long it took, s."""

    track: Track
    errors: Errors | None
    seconds: float


def track(
    recording: RecordingFolder = None,
    bank: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            help="Bank of motion models: static-cv-ca, pedestrian, vehicle, drone, ship, "
            "aircraft, rocket, or a TOML file.",
        ),
    ] = "static-cv-ca",
    robust: RobustOption = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Let every estimate know of later scans as well.")
    ] = False,
    engine: Annotated[Engine, typer.Option(help="What computes.")] = Engine.AUTO,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder to write to; default imm-tdoa-out/NAME OF THE RECORDING.",
            show_default=False,
        ),
    ] = None,
    target: Targets = None,
) -> None:
    """Track the targets of a recording with several motion models at once.

    Writes track.csv, summary.json, pictures (track.png, error.png) and, where the frame lies on
    the Earth, track.geojson and track.kml; prints a table of errors where there is truth.

    Example, a car from GPS signals, gross errors trusted less, looking back over all of it:

        imm-tdoa track gnss_phone_drive --bank vehicle --robust student-t --smooth --out car

    Look at car/track.png: the map above, beneath it which motion the target was in. Is the error
    in car/error.png mostly under its own bound? Then the noise and the bank fit.
    """
    from imm_tdoa import bankfile

    chosen = bankfile.load(bank)
    with recordings.folder(recording) as place:
        from imm_tdoa.recording import read

        data = read(place)
        home = output.folder(out, place)
    names = recordings.targets(data, target)
    with output.progress(len(names)) as advance:
        results, failed = _track_all(
            data, chosen, names, recordings.rule_of(robust), smooth, engine, advance
        )
        if not results:
            name, reason = next(iter(failed.items()))
            more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
            raise ValueError(f"no target can be tracked: target {name!r}: {reason}{more}")
        advance("writing")
        home.mkdir(parents=True, exist_ok=True)
        files = _write(home, data, results)
        advance("drawing")
        files += _draw(home, data, results)
    facts = {
        "title": data.title,
        "recording": place.resolve().name,
        "bank": bank,
        "modes": list(chosen.names),
        "robust": None if robust is None else robust.value,
        "smoothed": smooth,
    }
    summary = _summary(facts, data, results, failed)
    summary["files"] = sorted([*files, "summary.json"])
    output.write_json(home / "summary.json", summary)
    _tell(data, summary, home)


def _track_all(
    data: Recording,
    bank: Bank,
    names: Sequence[str],
    robust: RobustRule | None,
    smooth: bool,
    engine: Engine,
    advance: Any,
) -> tuple[dict[str, Result], dict[str, str]]:
    """Track each target on its own; return results, and the reasons of those that failed."""
    from imm_tdoa.imm import IMM
    from imm_tdoa.scoring import against_truth

    results: dict[str, Result] = {}
    failed: dict[str, str] = {}
    for name in names:
        advance(f"tracking {name}")
        begun = time.perf_counter()
        try:
            scans = data.scans(name)
            imm = IMM(bank, scans.measurement, update="iekf", robust=robust)
            track = imm.run(scans.times, scans.values, pairs=scans.pairs, engine=engine.value)
            track = track.smooth() if smooth else track
        except ValueError as error:
            failed[name] = str(error)
            continue
        seconds = time.perf_counter() - begun
        results[name] = Result(track, against_truth(track, data, name), seconds)
    return results, failed


def _write(home: Path, data: Recording, results: Mapping[str, Result]) -> list[str]:
    from imm_tdoa.recording import write_geojson, write_kml, write_track

    tracks = {name: result.track for name, result in results.items()}
    write_track(home / "track.csv", tracks, data.frame)
    if data.frame is None:
        return ["track.csv"]
    write_geojson(home / "track.geojson", tracks, data.frame)
    write_kml(home / "track.kml", tracks, data.frame)
    return ["track.csv", "track.geojson", "track.kml"]


def _draw(home: Path, data: Recording, results: Mapping[str, Result]) -> list[str]:
    """All tracks together, and each on its own where they are few."""
    from imm_tdoa import plot

    tracks = {name: result.track for name, result in results.items()}
    plot.track(tracks, data, path=home / "track.png")
    plot.error(tracks, data, path=home / "error.png")
    files = ["track.png", "error.png"]
    if 1 < len(tracks) <= PICTURED:
        for name, track in tracks.items():
            title = f"{data.title}: {name}" if data.title else name
            for kind, draw in (("track", plot.track), ("error", plot.error)):
                file = f"{kind}-{output.file_name(name)}.png"
                draw(track, data, target=name, title=title, path=home / file)
                files.append(file)
    return files


def _figures(dims: int, errors: Errors | None) -> dict[str, float | None]:
    """Figures of merit by name, null where there is no truth."""
    names = ["position_rmse_m", "horizontal_rmse_m", "position_median_m", "horizontal_median_m"]
    names += ["velocity_rmse_mps", "mean_nees"]
    found = {} if errors is None else errors.summary()
    return {n: found.get(n) for n in names if dims == 3 or not n.startswith("horizontal")}


def _summary(
    facts: Mapping[str, Any],
    data: Recording,
    results: Mapping[str, Result],
    failed: Mapping[str, str],
) -> dict[str, Any]:
    """What summary.json holds."""
    from imm_tdoa.scoring import pooled

    targets: dict[str, dict[str, Any]] = {
        name: {
            "scans": len(result.track.times),
            **_figures(data.dims, result.errors),
            "log_likelihood": _last_finite(result.track.log_likelihood),
            "rows_left_out": int(np.count_nonzero(result.track.row_weight < 0.5)),
            "lost_scans": int(np.count_nonzero(result.track.lost)),
            "seconds": result.seconds,
            "engine": result.track.engine,
        }
        for name, result in results.items()
    }
    known = [result.errors for result in results.values() if result.errors is not None]
    engines = sorted({result.track.engine for result in results.values()})
    overall = {
        "targets": len(results),
        "scans": sum(row["scans"] for row in targets.values()),
        **_figures(data.dims, pooled(known) if known else None),
        "log_likelihood": sum(row["log_likelihood"] for row in targets.values()),
        "rows_left_out": sum(row["rows_left_out"] for row in targets.values()),
        "lost_scans": sum(row["lost_scans"] for row in targets.values()),
        "seconds": sum(row["seconds"] for row in targets.values()),
        "engine": ", ".join(engines),
    }
    return {**facts, "overall": overall, "targets": targets, "failed": dict(failed)}


def _last_finite(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else 0.0


def _tell(data: Recording, summary: Mapping[str, Any], home: Path) -> None:
    """Print a short table and where everything is."""
    out = output.console()
    heads = {
        "position_rmse_m": "RMSE [m]",
        "position_median_m": "median [m]",
        "horizontal_rmse_m": "horizontal RMSE [m]",
        "velocity_rmse_mps": "velocity RMSE [m/s]",
        "mean_nees": f"mean NEES (ideal {len(data.truth_scoring.axes or 'xyz'[: data.dims])})",
    }
    overall, targets = summary["overall"], summary["targets"]
    shown = [key for key in heads if overall.get(key) is not None]
    columns = [("target", False), ("scans", True), *((heads[k], True) for k in shown)]
    output.heading(
        out,
        f"{data.title or summary['recording']}\n"
        f"bank {summary['bank']}: {', '.join(summary['modes'])}\n",
    )
    table = output.table([*columns, ("log-likelihood", True), ("time [s]", True)])
    rows = [*list(targets.items())[:LISTED], *([("all", overall)] if len(targets) > 1 else [])]
    for name, row in rows:
        table.add_row(
            output.escaped(name),
            str(row["scans"]),
            *(output.number(row[k]) for k in shown),
            f"{row['log_likelihood']:.1f}",
            output.number(row["seconds"], 2),
            style="bold" if row is overall else None,
        )
    out.print(table)
    if len(targets) > LISTED:
        out.print(f"{len(targets) - LISTED} more targets are in summary.json")
    if not shown:
        out.print("no truth to compare with")
    if overall["rows_left_out"]:
        out.print(f"rows left out or trusted less than half: {overall['rows_left_out']}")
    if overall["lost_scans"]:
        out.print(f"scans while lost, nothing having fitted for too long: {overall['lost_scans']}")
    failed = summary["failed"]
    if failed:
        out.print(f"\nnot tracked: {len(failed)} of {len(failed) + len(targets)} targets")
        for name, reason in list(failed.items())[:REASONS]:
            out.print(output.escaped(f"  {name}: {reason}"))
        if len(failed) > REASONS:
            out.print(f"  and {len(failed) - REASONS} more, in summary.json")
    output.written(out, home, summary["files"])
