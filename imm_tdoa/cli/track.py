"""``imm-tdoa track``: from a recording to tracks, figures of merit and pictures."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import attrs
import typer

from imm_tdoa import _validate
from imm_tdoa.cli import options, output, recordings, track_report
from imm_tdoa.cli.emitters import AssociatorName, Wishes, track_unlabelled
from imm_tdoa.cli.options import RecordingFolder, RobustOption, Targets

if TYPE_CHECKING:
    from imm_tdoa.bank import Bank
    from imm_tdoa.cycle import RobustRule
    from imm_tdoa.recording import Recording
    from imm_tdoa.scoring import Errors
    from imm_tdoa.track import Track

PICTURED = 6  # targets that get pictures of their own


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
    bank: Annotated[str, options.bank("Bank of motion models")] = "static-cv-ca",
    robust: RobustOption = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Let every estimate know of later scans as well.")
    ] = False,
    engine: Annotated[
        Engine,
        typer.Option(
            help="What computes, to the same numbers. auto: compiled code where it is worth the "
            "wait for the compiler."
        ),
    ] = Engine.AUTO,
    out: Annotated[Path | None, options.out_named_after("NAME OF THE RECORDING")] = None,
    target: Targets = None,
    associator: Annotated[
        AssociatorName | None,
        typer.Option(
            help="Unlabelled: who takes which rows. global: the cheapest of all assignments; "
            "jpda: weighs them all, for emitters close together; nearest: each pair by itself.",
            show_default="global",
        ),
    ] = None,
    detection_probability: Annotated[
        float | None,
        typer.Option(
            metavar="P",
            help="Unlabelled: how likely a row of an emitter is measured in a scan; of tdoa.csv "
            "and fdoa.csv: the messages of toa.csv come when they come.",
            show_default="0.9",
        ),
    ] = None,
    cutoff: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Unlabelled: how far a track may be from the emitter that it follows; default "
            "three standard deviations of a fix.",
            show_default=False,
        ),
    ] = None,
    hide_labels: Annotated[
        bool,
        typer.Option(
            "--hide-labels",
            help="Ignore whose rows are whose, and say afterwards how pure the tracks are.",
        ),
    ] = False,
) -> None:
    """Track the targets of a recording with several motion models at once.

    Writes track.csv, summary.json, pictures (track.png, error.png) and, where the frame lies on
    the Earth, track.geojson and track.kml; prints a table of errors where there is truth.

    Example, arrivals some of which are grossly wrong: trusted less, looking back over all of it:

        imm-tdoa simulate outliers --out outliers

        imm-tdoa track outliers --robust student-t --smooth --out smooth

    Look at smooth/track.png: the map above, beneath it which motion the target was in. Is the
    error in smooth/error.png mostly under its own bound? Then the noise and the bank fit.

    Where nobody knows whose rows are whose (labelled = false), it finds out how many emitters
    there are and which rows are theirs, numbers them, and writes tracks.csv, summary.json and
    tracks.png (the map), lives.png (who lived when, and why not longer), rows.png (who took which
    rows), gospa.png (against the truth):

        imm-tdoa simulate busy-sky --out sky

        imm-tdoa track sky --bank aircraft

    A bank that does not fit, too slow or too nimble, shows there as tracks that are not found.
    """
    from imm_tdoa import bankfile

    chosen = bankfile.load(bank)
    with recordings.folder(recording) as place:
        from imm_tdoa.recording import read, without_labels

        data = read(place)
        home = output.folder(out, place)
    facts = {
        "title": data.title,
        "recording": place.resolve().name,
        "bank": bank,
        "modes": list(chosen.names),
        "robust": None if robust is None else robust.value,
        "smoothed": smooth,
    }
    wishes = Wishes(
        robust=options.rule_of(robust),
        smooth=smooth,
        associator=None if associator is None else associator.value,
        detection_probability=detection_probability,
        cutoff=cutoff,
    )
    if cutoff is not None:
        _validate.positive("--cutoff", cutoff)
    if hide_labels or not data.labelled:
        _refuse_for_unlabelled(target, engine)
        track_unlabelled(without_labels(data), chosen, wishes, facts, home)
        return
    _refuse_for_labelled(wishes)
    names = recordings.targets(data, target)
    with output.progress(len(names)) as advance:
        results, failed = _track_all(
            data, chosen, names, options.rule_of(robust), smooth, engine, advance
        )
        if not results:
            recordings.refuse_without_any(failed, "tracked")
        advance("writing")
        home.mkdir(parents=True, exist_ok=True)
        files = _write(home, data, results)
        advance("drawing")
        files += _draw(home, data, results)
    summary = track_report.summarised(facts, data, results, failed)
    summary["files"] = sorted([*files, "summary.json"])
    output.write_json(home / "summary.json", summary)
    track_report.tell(data, summary, home)


def _refuse_for_unlabelled(target: Sequence[str] | None, engine: Engine) -> None:
    if target:
        raise ValueError("--target: nobody knows whose rows are whose; leave it out")
    if engine is Engine.COMPILED:
        raise ValueError(
            "--engine: only the tracks of labelled recordings are computed as compiled; "
            "use auto or numpy"
        )


def _refuse_for_labelled(wishes: Wishes) -> None:
    given = {
        "--associator": wishes.associator,
        "--detection-probability": wishes.detection_probability,
        "--cutoff": wishes.cutoff,
    }
    for option, value in given.items():
        if value is not None:
            raise ValueError(
                f"{option}: the recording says whose rows are whose, and there is nothing to "
                f"associate; --hide-labels ignores that"
            )


def _track_all(
    data: Recording,
    bank: Bank,
    names: Sequence[str],
    robust: RobustRule | None,
    smooth: bool,
    engine: Engine,
    advance: Any,
) -> tuple[dict[str, Result], dict[str, str]]:
    """Track each target; return results, and the reasons of those that failed.

    Differences go as one batch, to the same numbers as target by target. Messages do not: their
    fixes are searched for, and where a search ends depends, in the last digits that matter, on
    what is searched for beside it, which a target hardly determined makes kilometres of.
    """
    if len(names) > 1 and not any("emission" in table for table in data.measured.values()):
        return _track_together(data, bank, names, robust, smooth, engine, advance)
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


def _track_together(
    data: Recording,
    bank: Bank,
    names: Sequence[str],
    robust: RobustRule | None,
    smooth: bool,
    engine: Engine,
    advance: Any,
) -> tuple[dict[str, Result], dict[str, str]]:
    """The same in batches of targets that are measured alike; each counts its scans' time."""
    from imm_tdoa.imm import IMM
    from imm_tdoa.scoring import against_truth
    from imm_tdoa.tracking import labelled

    advance(f"tracking {len(names)} targets")
    begun, done = time.perf_counter(), 0

    def tell(now: int, every: int) -> None:
        nonlocal done
        for _ in range(min(now, every - 1) - done):
            advance(f"tracking {every} targets")
        done = now

    tracks, failed = labelled.run(
        lambda measurement: IMM(bank, measurement, update="iekf", robust=robust),
        data,
        tell,
        targets=names,
        engine=engine.value,
    )
    if smooth:
        tracks = {name: track.smooth() for name, track in tracks.items()}
    scans = sum(len(track.times) for track in tracks.values())
    each = (time.perf_counter() - begun) / max(scans, 1)
    results = {
        name: Result(track, against_truth(track, data, name), each * len(track.times))
        for name, track in tracks.items()
    }
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
