"""``imm-tdoa track`` on recordings of which nobody knows whose rows are whose."""

from __future__ import annotations

import time
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs

from imm_tdoa.cli import emitters_report, output

if TYPE_CHECKING:
    from imm_tdoa.bank import Bank
    from imm_tdoa.following import Following
    from imm_tdoa.recording import Recording, UnlabelledScans
    from imm_tdoa.scoring import Errors
    from imm_tdoa.tracking import Tracks

SMOOTHING = 10  # scans of progress that smoothing counts for


class AssociatorName(StrEnum):
    """Who takes which rows."""

    GLOBAL = "global"
    JPDA = "jpda"
    NEAREST = "nearest"


@attrs.frozen
class Wishes:
    """What the command line says of an unlabelled recording.

    Attributes
    ----------
    robust : str or None
        Rule against gross errors; refused.
    smooth : bool
        Whether tracks look back.
    associator : str or None
        Who takes which rows; None: the tracker's own default.
    detection_probability : float or None
        Of a row of an emitter in a scan; None: the tracker's own default.
    cutoff : float or None
        Largest distance at which a track follows an emitter, m.
    """

    robust: Any
    smooth: bool
    associator: str | None
    detection_probability: float | None
    cutoff: float | None


@attrs.frozen(eq=False)
class Found:
    """What was found, and how it compares with the truth.

    Attributes
    ----------
    rows : UnlabelledScans
        All that the tracker was given.
    tracks : Tracks
        What it found.
    following : Following or None
        Tracks and targets side by side.
    errors : dict of str to Errors
        Of tracks that followed a target.
    purity : dict of str to float
        By the names that the tracker was not shown; empty where the rows have none.
    seconds : float
        How long tracking took, s.
    """

    rows: UnlabelledScans
    tracks: Tracks
    following: Following | None
    errors: dict[str, Errors]
    purity: dict[str, float]
    seconds: float


def track_unlabelled(
    data: Recording, bank: Bank, wishes: Wishes, facts: Mapping[str, Any], home: Path
) -> None:
    """Track whatever there is, write, draw, and print a short table."""
    from imm_tdoa.recording import unlabelled

    if wishes.robust is not None:
        raise ValueError(
            "--robust: only for labelled recordings; without labels a row that does not fit a "
            "track is left to others"
        )
    rows = unlabelled(data)
    with output.progress(len(rows.scans) + SMOOTHING + 2) as advance:
        begun = time.perf_counter()
        tracks = _tracked(data, bank, wishes, len(rows.scans), advance)
        found = _compared(data, rows, tracks, wishes, time.perf_counter() - begun)
        advance("writing")
        home.mkdir(parents=True, exist_ok=True)
        files = _write(home, data, found)
        advance("drawing")
        files += _draw(home, data, found)
    summary = emitters_report.summarised(facts, data, found)
    summary["files"] = sorted([*files, "summary.json"])
    output.write_json(home / "summary.json", summary)
    emitters_report.tell(data, found, summary, home)


def _tracked(data: Recording, bank: Bank, wishes: Wishes, scans: int, advance: Any) -> Tracks:
    from imm_tdoa.tracking import Tracker

    p = wishes.detection_probability
    if p is not None and not 0.0 < p < 1.0:
        raise ValueError(
            f"--detection-probability: expected a probability above 0 and below 1, got {p:g}"
        )
    given: dict[str, Any] = {
        "associator": wishes.associator,
        "detection_probability": wishes.detection_probability,
    }
    tracker = Tracker(
        bank,
        imm={"update": "iekf"},
        **{name: value for name, value in given.items() if value is not None},
    )
    advance(f"scan 1 of {scans}")
    tracks = tracker.run(data, lambda done, all_: advance(f"scan {min(done + 1, all_)} of {all_}"))
    if not wishes.smooth:
        return tracks
    advance("looking back")
    return attrs.evolve(tracks, given={name: track.smooth() for name, track in tracks.items()})


def _compared(
    data: Recording, rows: UnlabelledScans, tracks: Tracks, wishes: Wishes, seconds: float
) -> Found:
    from imm_tdoa import following
    from imm_tdoa.scoring import against_truth

    beside = following.follow(
        tracks,
        data,
        [scan.time for scan in rows.scans],
        cutoff=wishes.cutoff,
        measurement=rows.measurement,
    )
    errors = {}
    for name, who in ({} if beside is None else beside.main).items():
        own = against_truth(tracks[name], data, who)
        if own is not None:
            errors[name] = own
    named = any(scan.target is not None for scan in rows.scans)
    purity = following.labels(tracks.labels(rows.scans)) if named else {}
    return Found(rows, tracks, beside, errors, purity, seconds)


def _write(home: Path, data: Recording, found: Found) -> list[str]:
    from imm_tdoa.recording import write_geojson, write_kml, write_track

    if not len(found.tracks):
        return []
    write_track(home / "tracks.csv", found.tracks, data.frame)
    if data.frame is None:
        return ["tracks.csv"]
    write_geojson(home / "tracks.geojson", found.tracks, data.frame)
    write_kml(home / "tracks.kml", found.tracks, data.frame)
    return ["tracks.csv", "tracks.geojson", "tracks.kml"]


def _draw(home: Path, data: Recording, found: Found) -> list[str]:
    from imm_tdoa import plot

    files = []
    if len(found.tracks):
        plot.track(found.tracks, data, path=home / "tracks.png")
        plot.lives(found.tracks, found.following, title=data.title, path=home / "lives.png")
        files = ["tracks.png", "lives.png"]
    if found.following is not None:
        plot.gospa(found.following, title=data.title, path=home / "gospa.png")
        files.append("gospa.png")
    if plot.claims(found.tracks, data, found.rows, path=home / "rows.png") is not None:
        files.append("rows.png")
    return files
