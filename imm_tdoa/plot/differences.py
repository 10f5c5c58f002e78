"""Time differences as they came in, over those that the truth would have given."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.contract import Array, Index
from imm_tdoa.geometry import ranges
from imm_tdoa.plot import canvas, marks
from imm_tdoa.plot.canvas import Clock
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording

CROWD = 60  # targets; of more the picture shows little but how many there are
PANELS = 6  # pairs shown; more would not be legible
MICRO = 1e6
MARGIN = 1.08  # of the largest difference that a pair can have


class _Seen(NamedTuple):
    """Measured differences: the station pair (N, 2), time (N,), s, and value (N,), s, of each."""

    pairs: Index
    times: Array
    values: Array
    alone: int  # emissions with a single row, of which there is no difference


def has_differences(recording: Recording) -> bool:
    """Whether `differences` has anything to draw.

    Parameters
    ----------
    recording : Recording
        What it would draw.
    """
    return len(_seen(recording).times) > 0


def differences(
    recording: Recording, *, title: str | None = None, path: str | Path | None = None
) -> Figure:
    """Draw the measured time differences over time, and the true ones of each target.

    False alarms and gross errors are the points off every line. Arrival times are shown as
    differences to the station that is heard most often. Where there are more pairs than have
    room, those with the most rows are shown.

    Parameters
    ----------
    recording : Recording
        What to draw; its truth may be missing.
    title : str, optional
        Heading; default the recording's.
    path : str or Path, optional
        File to write; its ending says which format.

    Raises
    ------
    ValueError
        A recording with neither time differences nor two arrival times of one emission.
    """
    seen = _seen(recording)
    if not len(seen.times):
        raise ValueError("recording: no time differences to draw")
    pairs, counts = np.unique(seen.pairs, axis=0, return_counts=True)
    shown = pairs[np.sort(np.argsort(-counts, kind="stable")[:PANELS])]
    truths = {name: Truth.of(recording, name) for name in marks.true_targets(recording)}
    known = {name: truth for name, truth in truths.items() if truth is not None}
    columns = 1 if len(shown) <= 3 else 2
    rows = ceil(len(shown) / columns)
    figure = canvas.figure(11.0, 2.0 + 1.9 * rows)
    figure.suptitle(
        recording.title if title is None else title,
        x=0.01,
        ha="left",
        fontsize=11,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(rows, columns + 1, width_ratios=[*[3.4 / columns] * columns, 1.0])
    clock = Clock(np.concatenate([seen.times, *(t.times for t in known.values())]))
    outside, first = 0, None
    for k, pair in enumerate(shown):
        ax = figure.add_subplot(grid[k // columns, k % columns], sharex=first)
        first = first or ax
        outside += _panel(ax, recording, seen, pair, known, clock)
        if k // columns < rows - 1:
            ax.set_xlabel("")
        if k % columns:
            ax.set_ylabel("")
        if k + columns < len(shown):
            ax.tick_params(labelbottom=False)
    side = figure.add_subplot(grid[:, columns])
    note = _note(len(pairs) - len(shown), outside, seen.alone)
    canvas.legend(side, _handles(known, len(seen.times)), note)
    return canvas.finish(figure, path)


def _panel(
    ax: Axes,
    recording: Recording,
    seen: _Seen,
    pair: Index,
    truths: dict[str, Truth],
    clock: Clock,
) -> int:
    """Draw one pair; return how many of its rows are beyond all that it can measure."""
    names = recording.stations.names
    mine = np.all(seen.pairs == pair, axis=-1)
    t, value = seen.times[mine], MICRO * seen.values[mine]
    few, many = len(truths) <= len(canvas.MODES), len(truths) > CROWD
    for i, truth in enumerate(truths.values()):
        true = MICRO * true_difference(recording, truth, pair)
        colour = canvas.MODES[i] if few else canvas.TRACK
        width = _width(i, len(truths))
        ax.plot(clock(truth.times), true, color=colour, linewidth=width, solid_capstyle="butt")
        for row, marker, edge in ((0, "o", canvas.START), (-1, "s", canvas.INK)):
            size = 7 if few else 2 if many else 3.5
            place = clock(truth.times[row]), true[row]
            white = "white" if few else edge
            ax.plot(
                *place, marker=marker, color=edge, markersize=size, markeredgecolor=white, zorder=4
            )
    dot = 5.0 if len(t) < 1000 else 1.0 if many else 2.5
    ax.scatter(clock(t), value, s=dot, color=canvas.INK, linewidths=0.0, zorder=5)
    label = f"{names[pair[0]]} - {names[pair[1]]}"
    canvas.dress(ax, clock.label, "difference [µs]", label, size=9)
    limit = MARGIN * MICRO * baseline(recording, t, pair)
    beyond = np.abs(value) > limit
    if np.any(beyond):
        ax.set_ylim(-limit, limit)
    return int(np.count_nonzero(beyond))


def _width(i: int, count: int) -> float:
    """Return the width of the line of truth i, the later ones narrower, so that all are seen."""
    if count > len(canvas.MODES):
        return 0.8 if count > CROWD else 1.2
    return 7.0 - 4.0 * i / max(count - 1, 1)


def _seen(recording: Recording) -> _Seen:
    number = {name: i for i, name in enumerate(recording.stations.names)}
    nothing = _Seen(np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(0), 0)
    if recording.tdoa is not None:
        table = recording.tdoa
        ends = [[number[n] for n in table[key].tolist()] for key in ("station", "reference")]
        seen = np.isfinite(table["tdoa_s"])
        pairs = np.array(ends, dtype=np.int64).T[seen]
        return _Seen(pairs, table["time_s"][seen], table["tdoa_s"][seen], 0)
    if recording.toa is None:
        return nothing
    table = recording.toa
    station = np.array([number[n] for n in table["station"].tolist()], dtype=np.int64)
    _, emission = np.unique(table["emission"], return_inverse=True)
    if recording.labelled and "target" in table:
        _, who = np.unique(table["target"], return_inverse=True)
        _, emission = np.unique(emission * (who.max() + 1) + who, return_inverse=True)
    reference = int(np.bincount(station).argmax())
    alone = int(np.count_nonzero(np.bincount(emission) == 1))
    base = np.full(emission.max() + 1, np.nan)
    mine = station == reference
    base[emission[mine]] = table["toa_s"][mine]
    value = table["toa_s"] - base[emission]
    keep = ~mine & np.isfinite(value)
    pairs = np.stack([station, np.full(len(station), reference)], axis=-1)
    return _Seen(pairs[keep], table["time_s"][keep], value[keep], alone)


def true_difference(recording: Recording, truth: Truth, pair: Index) -> Array:
    """Return the true difference (K,) of a target between two stations, s."""
    places, _ = recording.stations.at(truth.times)
    reach, _ = ranges(truth.position, places[..., pair, :])
    result: Array = (reach[..., 0] - reach[..., 1]) / recording.speed_mps
    return result


def baseline(recording: Recording, times: Array, pair: Index) -> float:
    """Return the largest difference that the pair can measure, s."""
    places, _ = recording.stations.at(times)
    apart = np.linalg.norm(places[..., pair[0], :] - places[..., pair[1], :], axis=-1)
    return float(np.nanmax(apart)) / recording.speed_mps


def _handles(truths: dict[str, Truth], rows: int) -> list[Any]:
    dot = Line2D([], [], linestyle="", marker=".", color=canvas.INK, label=f"measured ({rows})")
    handles: list[Any] = [dot]
    if len(truths) <= len(canvas.MODES):
        for i, label in enumerate(marks.lives(truths).values()):
            colour, width = canvas.MODES[i], _width(i, len(truths))
            handles.append(Line2D([], [], color=colour, linewidth=width, label=label))
    else:
        handles.append(Line2D([], [], color=canvas.TRACK, label=f"truth of {len(truths)} targets"))
    if truths:
        for marker, colour, word in (("o", canvas.START, "start"), ("s", canvas.INK, "end")):
            handles.append(Line2D([], [], linestyle="", marker=marker, color=colour, label=word))
    return handles


def _note(hidden: int, outside: int, alone: int) -> str:
    lines = []
    if hidden:
        lines.append(f"{hidden} more pairs" if hidden > 1 else "1 more pair")
    if outside:
        rows = "1 row is" if outside == 1 else f"{outside} rows are"
        lines.append(f"{rows} larger than their pair can measure")
    if alone:
        emissions = "1 emission was" if alone == 1 else f"{alone} emissions were"
        lines.append(f"{emissions} heard by one station")
    return "\n".join(lines)
