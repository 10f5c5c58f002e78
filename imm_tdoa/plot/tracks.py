"""The picture of a track: map, height, and which motion it was; or many tracks on one map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from imm_tdoa.contract import Array, Index
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.plot import canvas, marks, panels
from imm_tdoa.plot.agreement import OUTSIDE
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.plot.emitters import emitters
from imm_tdoa.plot.maps import Box, name_points, settle
from imm_tdoa.plot.receivers import OVERVIEW, Receivers, overview
from imm_tdoa.plot.scenes import many
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording
from imm_tdoa.stations import Stations
from imm_tdoa.track import Track
from imm_tdoa.tracking import Tracks

ELLIPSES = 12
SHARE = 0.4  # of the map's width that the track keeps when stations are added
NAMED_SMALL = 10  # stations named on the small map
APART = 0.08  # of the map's width between places that are labelled with a time


def track(
    track: Track | Mapping[str, Track],
    recording: Recording | None = None,
    *,
    target: str | None = None,
    truth: tuple[Any, Any] | None = None,
    stations: Stations | None = None,
    title: str | None = None,
    path: str | Path | None = None,
) -> Figure:
    """Draw a track over the truth, its height, and its mode probabilities; or many on one map.

    Parameters
    ----------
    track : Track or mapping of name to Track
        One track, or several, which are drawn on one map. Those of a tracker that nobody told
        whose rows are whose (`imm_tdoa.tracking.Tracks`) are drawn by number, with births, gaps
        and ends, over the truth of all targets.
    recording : Recording, optional
        Gives stations, truth, frame and title.
    target : str, optional
        Whose track it is; may be left out where the recording has only one.
    truth : (times (K,), positions (K, d)), optional
        Truth of a single track, s and m, instead of the recording's.
    stations : Stations, optional
        Stations, instead of the recording's.
    title : str, optional
        Heading.
    path : str or Path, optional
        File to write; its ending says which format.

    Returns
    -------
    Figure
        Not tied to pyplot.

    Raises
    ------
    ValueError
        A batch of tracks as one Track, an empty mapping, a track along a line.
    """
    stations = stations if stations is not None or recording is None else recording.stations
    if title is None:
        title = "" if recording is None else recording.title
    if isinstance(track, Tracks) and (recording is None or not recording.labelled):
        return canvas.finish(emitters(track, recording, stations, title), path)
    if isinstance(track, Mapping) and len(track) != 1:
        return canvas.finish(many(track, recording, stations, title), path)
    if isinstance(track, Mapping):
        target, track = next(iter(track.items()))
    if track.times.ndim != 1 or track.mean.ndim != 2:
        raise ValueError(
            f"track: expected one track, got a batch of shape {track.mean.shape[:-2]}; give a "
            f"mapping of names to tracks"
        )
    if track.space.dims == 1:
        raise ValueError("track: a map needs 2 or 3 dimensions, this track has 1")
    known = Truth.of(recording, target)
    if truth is not None:
        known = Truth(np.asarray(truth[0], dtype=float), np.asarray(truth[1], dtype=float))
    frame = None if recording is None else recording.frame
    return canvas.finish(_one(track, known, stations, frame, title), path)


def _one(
    track: Track,
    truth: Truth | None,
    stations: Stations | None,
    frame: EastNorthUp | None,
    title: str,
) -> Figure:
    below = [("height", 1.7)] * (track.space.dims == 3) + [("modes", 1.9)] * (len(track.modes) > 1)
    sizes = [2.8, 2.8, *(size for _, size in below)]
    figure = canvas.figure(11.0, sum(sizes) + 0.4)
    grid = figure.add_gridspec(len(sizes), 2, height_ratios=sizes, width_ratios=[3.4, 1.0])
    truth = None if truth is None else truth.during(track.times)
    clock = Clock(track.times)
    for row, (panel, _) in enumerate(below, start=2):
        ax, side = figure.add_subplot(grid[row, 0]), figure.add_subplot(grid[row, 1])
        if panel == "height":
            canvas.legend(side, panels.height(ax, clock, track, truth, frame))
        else:
            canvas.legend(side, panels.modes(ax, clock, track))
        if len(track.times) > 1:
            ax.set_xlim(*clock([track.times[0], track.times[-1]]))
    ax = figure.add_subplot(grid[:2, 0])
    _map(figure, ax, grid[:2, 1], track, truth, stations, title)
    return figure


def _map(
    figure: Figure,
    ax: Axes,
    beside: Any,
    track: Track,
    truth: Truth | None,
    stations: Stations | None,
    title: str,
) -> None:
    position, P = track.position[:, :2], track.position_covariance[:, :2, :2]
    spread = float(np.sqrt(np.median(np.einsum("tii->t", P))))
    true = None if truth is None else truth.position[:, :2]
    points = position if true is None else np.concatenate([position, true])
    box = Box.around(position, true, least=max(4.0 * spread, 1.0))
    receivers = Receivers.during(stations, track.times)
    shown, far = receivers.fitted(box, SHARE)
    unit, clock = Unit(shown.width), Clock(track.times)
    canvas.dress(ax, f"x [{unit.name}]", f"y [{unit.name}]", title)
    handles: list[Any] = [] if truth is None else marks.truth_line(ax, unit, truth)
    dots = "." if len(position) <= 60 else ""
    handles += ax.plot(
        *unit(position.T), color=canvas.TRACK, linewidth=1.6, marker=dots, label="track"
    )
    if np.any(track.lost):
        handles += ax.plot(
            *unit(position[track.lost].T),
            linestyle="",
            marker="x",
            markersize=4,
            color=OUTSIDE,
            label="lost: rejects every scan",
        )
    rows = np.unique(np.linspace(0, len(position) - 1, ELLIPSES).astype(int))
    if marks.ellipses(ax, unit, position[rows], P[rows], 0.5 * shown.width):
        face = to_rgba(canvas.TRACK, 0.18)
        handles.append(
            Patch(facecolor=face, edgecolor=canvas.TRACK, label="95 % uncertainty\n(some times)")
        )
    handles += marks.ends(ax, unit, clock, track)
    stations_drawn = receivers.draw(ax, unit)
    handles += stations_drawn if np.any(shown.holds(receivers.places)) else []
    outside = np.count_nonzero(~shown.holds(position))
    note = f"{outside} of {len(position)} track points lie outside the map" if outside else ""
    maps = [(ax, shown, unit)]
    if len(far.names) and np.min(far.distances(box)) <= OVERVIEW * box.width:
        note += "\nframe below: this map"
        cells = beside.subgridspec(2, 1)
        beside, small = cells[0], figure.add_subplot(cells[1])
        heard = receivers.part(receivers.ever_heard)
        maps.append((small, *overview(small, shown, heard)))
    elif far.names:
        note += f"\n{far.far_away(box)}"
    canvas.legend(figure.add_subplot(beside), handles, note.strip())
    settle(figure, maps)
    for small, _, scale in maps[1:]:
        if len(heard.names) <= NAMED_SMALL:
            places = scale(heard.places)
            name_points(figure, small, places, heard.names, colour=canvas.STATION)
    rows = rows[marks.apart(position[rows], APART * shown.width)][1:]
    _name_on_map(figure, ax, unit, track, rows, receivers, points)


def _name_on_map(
    figure: Figure,
    ax: Axes,
    unit: Unit,
    track: Track,
    rows: Index,
    receivers: Receivers,
    points: Array,
) -> None:
    """Write the names of stations, and when the track was where at `rows`, off `points`."""
    clock = Clock(track.times)
    clear = unit(points[:: max(len(points) // 300, 1)])
    places, when = unit(receivers.places), [f"{clock(t):.4g} s" for t in track.times[rows]]
    taken = name_points(
        figure, ax, places, receivers.names, colour=canvas.STATION, keep_clear=clear
    )
    at = unit(track.position[rows, :2])
    ax.plot(*at.T, "o", color="white", mec=canvas.TRACK, ms=4, zorder=5)
    name_points(figure, ax, at, when, colour=canvas.TRACK, keep_clear=clear, taken=taken)
