"""Differences over time in the colour of the track that took them."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.contract import Array, Index
from imm_tdoa.plot import canvas, colours, marks
from imm_tdoa.plot.canvas import Clock
from imm_tdoa.plot.differences import MARGIN, MICRO, PANELS, baseline, true_difference
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording, UnlabelledScans, gather
from imm_tdoa.tracking import Tracks

NOBODY = "#B9B9B9"


class _Rows(NamedTuple):
    """Measured differences: pair (K, 2), time (K,), s, value (K,), s, and which track's (K,)."""

    pairs: Index
    times: Array
    values: Array
    owner: Index


def claims(
    tracks: Tracks,
    recording: Recording,
    found: UnlabelledScans,
    *,
    title: str | None = None,
    path: str | Path | None = None,
) -> Figure | None:
    """Draw measured time differences in the colours of the tracks that took them.

    Arrival times are shown as differences to the station that is heard most often. Where there
    are more pairs than have room, those with the most rows are shown.

    Parameters
    ----------
    tracks : Tracks
        What a tracker found in `found`.
    recording : Recording
        Stations, and truth where there is any: thin lines.
    found : UnlabelledScans
        All that the tracker was given.
    title : str, optional
        Heading; default the recording's.
    path : str or Path, optional
        File to write; its ending says which format.

    Returns
    -------
    Figure or None
        None where there are neither time differences nor two arrival times of one emission.
    """
    rows = _rows(tracks, recording, found)
    if rows is None or not len(rows.times):
        return None
    pairs, counts = np.unique(rows.pairs, axis=0, return_counts=True)
    shown = pairs[np.sort(np.argsort(-counts, kind="stable")[:PANELS])]
    truths = [Truth.of(recording, who) for who in marks.true_targets(recording)]
    known = [truth for truth in truths if truth is not None]
    columns = 1 if len(shown) <= 3 else 2
    lines = ceil(len(shown) / columns)
    figure = canvas.figure(11.0, 2.0 + 1.9 * lines)
    heading = recording.title if title is None else title
    figure.suptitle(heading, x=0.01, ha="left", fontsize=11, color=canvas.INK)
    grid = figure.add_gridspec(lines, columns + 1, width_ratios=[*[3.4 / columns] * columns, 1.0])
    clock = Clock(np.concatenate([rows.times, *(t.times for t in known)]))
    paint = list(colours.of_tracks(tracks).values())
    first = None
    for k, pair in enumerate(shown):
        ax = figure.add_subplot(grid[k // columns, k % columns], sharex=first)
        first = first or ax
        _panel(ax, recording, rows, pair, known, clock, paint)
        ax.set_xlabel(clock.label if k + columns >= len(shown) else "")
        ax.set_ylabel("" if k % columns else "difference [µs]")
        ax.tick_params(labelbottom=k + columns >= len(shown))
    hidden = len(pairs) - len(shown)
    note = "" if not hidden else "1 more pair" if hidden == 1 else f"{hidden} more pairs"
    canvas.legend(
        figure.add_subplot(grid[:, columns]), _handles(tracks, paint, rows, len(known)), note
    )
    return canvas.finish(figure, path)


def _panel(
    ax: Axes,
    recording: Recording,
    rows: _Rows,
    pair: Index,
    truths: Sequence[Truth],
    clock: Clock,
    paint: Sequence[str],
) -> None:
    names = recording.stations.names
    mine = np.all(rows.pairs == pair, axis=-1)
    t, value, owner = rows.times[mine], MICRO * rows.values[mine], rows.owner[mine]
    for truth in truths:
        true = MICRO * true_difference(recording, truth, pair)
        ax.plot(clock(truth.times), true, color=canvas.TRUTH, linewidth=0.8, alpha=0.7, zorder=2)
    size = 9.0 if len(t) < 1000 else 4.0
    free = owner < 0
    ax.scatter(clock(t[free]), value[free], s=size, color=NOBODY, linewidths=0.0, zorder=1)
    shades = np.array([*paint, NOBODY])[owner[~free]]
    ax.scatter(clock(t[~free]), value[~free], s=size, c=shades, linewidths=0.0, zorder=3)
    canvas.dress(ax, "", "", f"{names[pair[0]]} - {names[pair[1]]}", size=9)
    limit = MARGIN * MICRO * baseline(recording, t, pair)
    if np.any(np.abs(value) > limit):
        ax.set_ylim(-limit, limit)


def _rows(tracks: Tracks, recording: Recording, found: UnlabelledScans) -> _Rows | None:
    """All differences; rows of arrival times are turned into differences of their emission."""
    owners = [np.full(len(scan), -1, dtype=np.int64) for scan in found.scans]
    for n, name in enumerate(tracks):
        for s, k in zip(*tracks.taken(name), strict=True):
            owners[int(s)][k] = n
    model: Any = found.measurement
    parts = getattr(model, "models", (model,))
    tables = [name for name in gather.ORDER if name in recording.measured]
    start = np.cumsum([0, *(part.size for part in parts)])
    kind = "tdoa" if "tdoa" in tables else "toa"
    if kind not in tables:
        return None
    i = tables.index(kind)
    low, high = int(start[i]), int(start[i + 1])
    row = np.concatenate([scan.row for scan in found.scans])
    use = (row >= low) & (row < high)
    value = np.concatenate([scan.values for scan in found.scans])[use]
    time = np.concatenate([np.full(len(scan), scan.time) for scan in found.scans])[use]
    owner, row = np.concatenate(owners)[use], row[use] - low
    if kind == "tdoa":
        return _Rows(np.asarray(parts[i].pairs)[row], time, value, owner)
    message = _messages(found)[use]
    reference = int(np.bincount(row).argmax())
    base = np.full(int(message.max(initial=-1)) + 1, np.nan)
    base[message[row == reference]] = value[row == reference]
    difference = value - base[message]
    keep = (row != reference) & np.isfinite(difference)
    pairs = np.stack([row, np.full(len(row), reference)], axis=-1)
    return _Rows(pairs[keep], time[keep], difference[keep], owner[keep])


def _messages(found: UnlabelledScans) -> Index:
    """Number each value's emission, no number twice."""
    numbers, used = [], 0
    for scan in found.scans:
        own = np.arange(len(scan)) if scan.emission is None else scan.emission
        numbers.append(own + used)
        used += int(own.max(initial=-1)) + 1
    return np.concatenate(numbers)


def _handles(tracks: Tracks, paint: Sequence[str], rows: _Rows, truths: int) -> list[Any]:
    dot: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 4}
    free = int(np.count_nonzero(rows.owner < 0))
    handles = []
    if len(tracks) <= len(colours.PALETTE):
        for n, (name, colour) in enumerate(zip(tracks, paint, strict=True)):
            label = f"track {name} ({int(np.count_nonzero(rows.owner == n))})"
            handles.append(Line2D([], [], color=colour, label=label, **dot))
    else:
        label = f"{len(tracks)} tracks ({len(rows.owner) - free}),\ncolours as on the map"
        handles.append(Line2D([], [], color=colours.PALETTE[0], label=label, **dot))
    handles.append(Line2D([], [], color=NOBODY, label=f"no track's ({free})", **dot))
    if truths:
        word = "truth" if truths == 1 else f"truth ({truths} emitters)"
        handles.append(Line2D([], [], color=canvas.TRUTH, linewidth=0.8, label=word))
    return handles
