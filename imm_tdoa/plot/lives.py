"""Who lived when: a line per track, from its birth to its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.following import Following
from imm_tdoa.plot import canvas, colours
from imm_tdoa.plot.canvas import Clock
from imm_tdoa.tracking import Tracks

LEAST, MOST = 2.6, 14.0  # height of the picture, inches
EACH = 0.24  # per line, inches
MISSED = 20  # lines of targets that nobody followed; more are counted
ENDS = ("x", "s", "v", "^", "P", "*")  # a marker per reason why tracks ended


def lives(
    tracks: Tracks,
    following: Following | None = None,
    *,
    title: str = "",
    path: str | Path | None = None,
) -> Figure:
    """Draw when each track was on trial, confirmed and coasting, and why it ended.

    Parameters
    ----------
    tracks : Tracks
        What a tracker found.
    following : Following, optional
        Which target each track follows: the targets' own lives are drawn behind the tracks that
        followed them most, those that none followed beneath.
    title : str
        Heading.
    path : str or Path, optional
        File to write; its ending says which format.

    Raises
    ------
    ValueError
        No tracks.
    """
    if not len(tracks):
        raise ValueError("tracks: expected at least one track, got none")
    lines = _lines(tracks, following)
    height = min(max(1.1 + EACH * len(lines), LEAST), MOST)
    figure = canvas.figure(11.0, height)
    grid = figure.add_gridspec(1, 2, width_ratios=[3.4, 1.0])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    every = [t.times for t in tracks.values()]
    clock = Clock(np.concatenate(every if following is None else [*every, following.times]))
    paint = colours.of_tracks(tracks)
    reasons = list(dict.fromkeys(life.reason for life in tracks.lives.values() if life.reason))
    thick = min(72.0 * 0.45 * (height - 1.1) / len(lines), 7.0)
    for y, (name, who) in enumerate(lines):
        if who is not None and following is not None:
            _truth(ax, clock, following, who, y, thick)
        if name is not None:
            _life(ax, clock, tracks, name, y, thick, paint[name], reasons)
    ax.set_ylim(len(lines) - 0.4, -0.6)
    labels = [name if name is not None else f"({who})" for name, who in lines]
    ax.set_yticks(range(len(lines)), labels, fontsize=8 if len(lines) <= 40 else 6)
    canvas.dress(ax, clock.label, "track", title)
    ax.grid(axis="y", visible=False)
    note = _more(following, tracks, lines)
    canvas.legend(
        side, _handles(reasons, tracks, following is not None, len(tracks) < len(lines)), note
    )
    return canvas.finish(figure, path)


def _lines(tracks: Tracks, following: Following | None) -> list[tuple[str | None, str | None]]:
    """The lines of the picture: a track and its target, then the targets that nobody followed."""
    if following is None:
        return [(name, None) for name in tracks]
    main = following.main
    missed = [w for w, m in zip(following.targets, following.present, strict=True) if m.any()]
    missed = [w for w in missed if w not in main.values()][:MISSED]
    return [*((name, main.get(name)) for name in tracks), *((None, w) for w in missed)]


def _more(
    following: Following | None, tracks: Tracks, lines: list[tuple[str | None, str | None]]
) -> str:
    if following is None:
        return ""
    there = int(np.count_nonzero(following.present.any(axis=1)))
    more = there - len(set(following.main.values())) - (len(lines) - len(tracks))
    return f"{more} more emitters that no track followed" if more > 0 else ""


def _truth(ax: Axes, clock: Clock, following: Following, who: str, y: int, thick: float) -> None:
    there = following.present[following.targets.index(who)]
    for a, b in colours.pieces(there):
        ends = clock(following.times[[a, b]])
        if a == b:
            ax.plot(ends[0], y, marker="|", color=canvas.TRUTH, markersize=2.0 * thick)
        ax.plot(
            ends, [y, y], color=canvas.TRUTH, alpha=0.35, linewidth=2.0 * thick,
            solid_capstyle="butt", zorder=1,
        )  # fmt: skip


def _life(
    ax: Axes,
    clock: Clock,
    tracks: Tracks,
    name: str,
    y: int,
    thick: float,
    colour: str,
    reasons: list[str],
) -> None:
    track, life = tracks[name], tracks.lives[name]
    shown, coasting, trial = colours.stretches(track, life)
    t = clock(track.times)
    flat: dict[str, Any] = {"color": colour, "solid_capstyle": "butt", "zorder": 3}
    on = shown[1:] & ~coasting
    for flags, width in ((on & trial[:-1], 0.3), (on & ~trial[:-1], 1.0)):
        for a, b in colours.pieces(flags):
            ax.plot([t[a], t[b + 1]], [y, y], linewidth=width * thick, **flat)
    for a, b in colours.pieces(coasting & shown[1:]):
        ax.plot([t[a], t[b + 1]], [y, y], color=colour, linewidth=1.2, linestyle=":", zorder=3)
    ax.plot(
        clock(life.confirmed), y, color=colour, linestyle="", zorder=3,
        marker="|", markersize=1.6 * thick, markeredgewidth=1.5,
    )  # fmt: skip
    if life.ended is not None:
        ends = [clock(life.heard), clock(life.ended)]
        ax.plot(ends, [y, y], color=colour, linewidth=1.2, linestyle=":", zorder=3)
        ax.plot(
            ends[1], y, color=canvas.INK, linestyle="", markersize=4.5, zorder=4,
            marker=ENDS[reasons.index(life.reason) % len(ENDS)],
        )  # fmt: skip


def _handles(reasons: list[str], tracks: Tracks, truth: bool, missed: bool) -> list[Any]:
    ink = canvas.INK
    handles = []
    if truth:
        word = "its emitter was there"
        word += "\n(in brackets: never followed)" if missed else ""
        handles.append(Line2D([], [], color=canvas.TRUTH, alpha=0.35, linewidth=9, label=word))
    handles += [
        Line2D([], [], color=ink, linewidth=1.5, label="on trial"),
        Line2D([], [], color=ink, linewidth=5, label="confirmed"),
        Line2D([], [], color=ink, linewidth=1.2, linestyle=":", label="nothing heard"),
    ]
    for k, reason in enumerate(reasons):
        count = sum(life.reason == reason for life in tracks.lives.values())
        handles.append(
            Line2D(
                [],
                [],
                color=ink,
                linestyle="",
                marker=ENDS[k % len(ENDS)],
                markersize=5,
                label=f"ended ({count}):\n{reason}",
            )
        )
    return handles
