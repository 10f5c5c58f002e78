"""Maps of many targets: their tracks, or a recording's stations and truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.contract import Array, Mask
from imm_tdoa.plot import canvas, marks
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.plot.maps import Box, name_points, settle
from imm_tdoa.plot.receivers import Receivers
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording
from imm_tdoa.stations import Stations
from imm_tdoa.track import Track

LABELLED = 12  # targets in a legend; more would not be legible
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
    sheet = _Sheet(_most({**lines, **known}), stations, times, title)
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


def _most(lines: Mapping[str, Array]) -> Array:
    """Points (N, 2) of the targets that are not far from where most of them are."""
    middle = np.array([np.nanmedian(line, axis=0) for line in lines.values()])
    core = Box.of(np.quantile(middle, [0.1, 0.9], axis=0))
    core = core.joined(np.concatenate([*(x for x in lines.values())])) if len(lines) < 5 else core
    near = core.grown(1.0).holds(middle)
    return np.concatenate([x for x, keep in zip(lines.values(), near, strict=True) if keep])


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
    sheet = _Sheet(points, recording.stations, times, recording.title if title is None else title)
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


class _Sheet:
    """A map with its legend beside it, large enough for `points` (N, 2) and stations near them."""

    def __init__(self, points: Array, stations: Stations | None, times: Array, title: str) -> None:
        self.points, self.box = points, Box.of(points)
        self.receivers = Receivers.during(stations, times)
        self.shown, self.far = self.receivers.fitted(self.box)
        self.unit = Unit(self.shown.width)
        self.figure = canvas.figure(11.0, 7.0)
        grid = self.figure.add_gridspec(1, 2, width_ratios=[3.4, 1.0])
        self.ax: Axes = self.figure.add_subplot(grid[0, 0])
        self.side: Axes = self.figure.add_subplot(grid[0, 1])
        canvas.dress(self.ax, f"x [{self.unit.name}]", f"y [{self.unit.name}]", title)

    def mark_ends(self, lines: list[Array]) -> list[Line2D]:
        """Mark where lines (T, 2) start and end."""
        size = 7 if len(lines) <= LABELLED else 4
        handles = []
        for row, marker, colour, word in (
            (0, "o", canvas.START, "start"),
            (-1, "s", canvas.INK, "end"),
        ):
            ends = np.array([line[row] for line in lines]).reshape(-1, 2)
            handles += self.ax.plot(
                *self.unit(ends.T),
                linestyle="",
                marker=marker,
                color=colour,
                markersize=size,
                markeredgecolor="white" if len(lines) <= LABELLED else colour,
                label=word,
                zorder=7,
            )
        return handles if lines else []

    def finished(
        self, handles: list[Any], lines: Mapping[str, Array], note: str, named: int = LABELLED
    ) -> Figure:
        """Add stations, legend and names, those of lines where there are at most so many."""
        stations = self.receivers.draw(self.ax, self.unit)
        self.side.axis("off")
        settle(self.figure, [(self.ax, self.shown, self.unit)])
        inside = self._in_view(self.receivers)
        handles += stations if np.any(inside) else []
        far = self.far.part(~self._in_view(self.far))
        if far.names:
            note += f"\n{far.far_away(self.box)}"
        canvas.legend(self.side, handles, note.strip())
        clear = self.unit(self.points[:: max(len(self.points) // 300, 1)])
        names, places = self.receivers.names, self.unit(self.receivers.places)
        taken = name_points(
            self.figure, self.ax, places, names, colour=canvas.STATION, keep_clear=clear
        )
        if 1 < len(lines) <= named:
            ends = self.unit(np.array([line[-1] for line in lines.values()]))
            name_points(self.figure, self.ax, ends, list(lines), keep_clear=clear, taken=taken)
        return self.figure

    def _in_view(self, receivers: Receivers) -> Mask:
        """Return which stations (S,) the map shows, now that it has grown to fill its axes."""
        view = np.array([self.ax.get_xlim(), self.ax.get_ylim()]).T
        return np.asarray(Box(*view).holds(self.unit(receivers.places)), dtype=bool)
