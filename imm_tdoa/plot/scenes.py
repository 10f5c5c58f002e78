"""Maps of many targets: their tracks, or a recording's stations and truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas, marks
from imm_tdoa.plot.receivers import Receivers
from imm_tdoa.plot.sheet import LABELLED, Sheet, most
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording
from imm_tdoa.stations import Stations
from imm_tdoa.track import Track

NAMED = 60  # targets named in a scene, as far as there is room


def many(
    tracks: Mapping[str, Track],
    recording: Recording | None,
    stations: Stations | None,
    title: str,
) -> Figure:
    """Return a map of several tracks over their truth."""
    if not tracks:
        raise ValueError("track: expected at least one track, got none")
    lines = {name: t.position[:, :2] for name, t in tracks.items()}
    truths = {}
    for name, t in tracks.items():
        truth = Truth.of(recording, name)
        if truth is not None:
            truths[name] = truth.during(t.times)
    known = {name: truth.position[:, :2] for name, truth in truths.items()}
    times = np.unique(np.concatenate([t.times for t in tracks.values()]))
    sheet = Sheet(most({**lines, **known}), stations, times, title)
    handles: list[Any] = []
    for truth in truths.values():
        drawn = marks.truth_line(sheet.ax, sheet.unit, truth)
        handles = handles or drawn
    for line in lines.values():
        sheet.ax.plot(*sheet.unit(line.T), color=canvas.TRACK, linewidth=1.2)
    handles.append(Line2D([], [], color=canvas.TRACK, label=f"tracks ({len(tracks)})"))
    handles += sheet.mark_ends(list(lines.values()))
    outside = sum(not np.all(sheet.shown.holds(line)) for line in lines.values())
    leaving = "1 track leaves" if outside == 1 else f"{outside} tracks leave"
    return sheet.finished(handles, lines, f"{leaving} the map" if outside else "")


def scene(
    recording: Recording, *, title: str | None = None, path: str | Path | None = None
) -> Figure:
    """Draw the stations of a recording and where its targets truly were.

    Parameters
    ----------
    recording : Recording
        What to draw; without truth, stations alone.
    title : str, optional
        Heading; default the recording's.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    found = {name: Truth.of(recording, name) for name in marks.true_targets(recording)}
    truths = {name: truth for name, truth in found.items() if truth is not None}
    tables = recording.measured.values()
    times = np.unique(np.concatenate([np.asarray(t["time_s"], dtype=float) for t in tables]))
    lines = {name: truth.position[:, :2] for name, truth in truths.items()}
    points = np.concatenate(list(lines.values())) if lines else _all_stations(recording, times)
    sheet = Sheet(points, recording.stations, times, recording.title if title is None else title)
    handles: list[Any] = []
    words = marks.lives(truths)
    for i, (name, line) in enumerate(lines.items()):
        many = len(lines) > len(canvas.MODES)
        handles += sheet.ax.plot(
            *sheet.unit(line.T),
            color=canvas.TRACK if many else canvas.MODES[i],
            linewidth=1.5 if many else 2.5,
            label=words[name],
        )
    if len(handles) > LABELLED:
        handles = [Line2D([], [], color=canvas.TRACK, label=f"truth of {len(lines)} targets")]
    handles += sheet.mark_ends(list(lines.values()))
    return canvas.finish(sheet.finished(handles, lines, "", NAMED), path)


def _all_stations(recording: Recording, times: Array) -> Array:
    return Receivers.during(recording.stations, times).paths.reshape(-1, 2)
