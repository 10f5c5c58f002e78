"""The map of tracks of which nobody said whose they are: who began, coasted and ended where."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.plot import canvas, colours, marks
from imm_tdoa.plot.sheet import Sheet, most
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording
from imm_tdoa.stations import Stations
from imm_tdoa.tracking import Tracks

FEW = 12  # tracks drawn with wide lines
NAMED = 100  # tracks named, as far as there is room


def emitters(
    tracks: Tracks, recording: Recording | None, stations: Stations | None, title: str
) -> Figure:
    """Return the map of what a tracker found."""
    if not len(tracks):
        raise ValueError("track: expected at least one track, got none")
    cut = {name: colours.stretches(track, tracks.lives[name]) for name, track in tracks.items()}
    lines = {name: track.position[cut[name].shown, :2] for name, track in tracks.items()}
    truths = {}
    if recording is not None and recording.truth is not None:
        for who in marks.true_targets(recording):
            truth = Truth.of(recording, who)
            if truth is not None:
                truths[who] = truth
    known = {f"truth {name}": truth.position[:, :2] for name, truth in truths.items()}
    times = np.unique(np.concatenate([track.times for track in tracks.values()]))
    sheet = Sheet(most({**lines, **known}), stations, times, title)
    ax, unit = sheet.ax, sheet.unit
    wide = len(tracks) <= FEW
    for truth in truths.values():
        line = unit(truth.position[:, :2].T)
        ax.plot(*line, color=canvas.TRUTH, linewidth=5.0 if wide else 2.5, alpha=0.55)
    paint = colours.of_tracks(tracks)
    width, size = (1.8, 7.0) if wide else (1.2, 4.5)
    coasted = False
    for name, track in tracks.items():
        shown, coasting, _ = cut[name]
        p = unit(track.position[:, :2])
        alone = coasting & shown[1:]
        for flags, style in ((shown[1:] & ~coasting, "-"), (alone, ":")):
            for a, b in colours.pieces(flags):
                line = p[a : b + 2].T
                ax.plot(*line, color=paint[name], linewidth=width, linestyle=style, zorder=3)
        coasted |= bool(alone.any())
        own = p[shown]
        ended = tracks.lives[name].ended is not None
        look: dict[str, Any] = {"color": paint[name], "linestyle": "", "zorder": 7}
        ax.plot(*own[0], marker="o", markersize=0.8 * size, markeredgecolor="white", **look)
        end: dict[str, Any] = {"marker": "x", "markeredgewidth": 2.0} if ended else {"marker": "D"}
        ax.plot(*own[-1], markersize=0.8 * size, **end, **look)
    handles = _handles(tracks, len(truths), coasted)
    outside = sum(not np.all(sheet.shown.holds(line)) for line in lines.values())
    leaving = "1 track leaves" if outside == 1 else f"{outside} tracks leave"
    note = f"{leaving} the map" if outside else ""
    return sheet.finished(handles, lines, note, NAMED, [paint[name] for name in lines])


def _handles(tracks: Tracks, truths: int, coasted: bool) -> list[Any]:
    ended = sum(life.ended is not None for life in tracks.lives.values())
    many = "1 track" if len(tracks) == 1 else f"{len(tracks)} tracks"
    ink = canvas.INK
    handles = []
    if truths:
        word = "truth" if truths == 1 else f"truth ({truths} emitters)"
        handles.append(Line2D([], [], color=canvas.TRUTH, linewidth=4.0, alpha=0.55, label=word))
    handles.append(Line2D([], [], color=ink, label=f"{many}, by number"))
    if coasted:
        handles.append(Line2D([], [], color=ink, linestyle=":", label="nothing heard"))
    dot: dict[str, Any] = {"linestyle": "", "color": ink, "markersize": 5}
    handles.append(Line2D([], [], marker="o", label="begins", **dot))
    if ended:
        label = f"ended, last heard ({ended})"
        handles.append(Line2D([], [], marker="x", label=label, **dot))
    if ended < len(tracks):
        label = f"still followed ({len(tracks) - ended})"
        handles.append(Line2D([], [], marker="D", label=label, **dot))
    return handles
