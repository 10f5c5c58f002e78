"""Pictures of many errors at once: each against the bound that was given for it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa import _validate, metrics
from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.recording import Recording
from imm_tdoa.scoring import against_truth
from imm_tdoa.track import Track

OUTSIDE = canvas.STATION


def pooled(tracks: Mapping[str, Track], recording: Recording | None, title: str) -> Figure:
    """Draw each error of several tracks against its own bound."""
    if not tracks:
        raise ValueError("track: expected at least one track, got none")
    found = {
        name: None if recording is None else against_truth(track, recording, name)
        for name, track in tracks.items()
    }
    known = [errors for errors in found.values() if errors is not None]
    if known:
        bound = np.concatenate([errors.bound for errors in known])
        distance = np.concatenate([errors.distance for errors in known])
        what = f"errors of {len(known)} targets inside the tracks' own 95 % bounds"
        return _scatter(bound, distance, what, title)
    figure = canvas.figure(11.0, 4.2)
    grid = figure.add_gridspec(1, 2, width_ratios=[3.4, 1.0])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    every = [t.times for t in tracks.values()]
    clock = Clock(np.concatenate(every))
    bounds = {n: metrics.error_radius(t.position_covariance) for n, t in tracks.items()}
    unit = Unit(float(np.nanmax(np.concatenate(list(bounds.values())))))
    for name, track in tracks.items():
        ax.plot(clock(track.times), unit(bounds[name]), color=canvas.TRACK, linewidth=1.0)
    ax.set_yscale("log")
    canvas.plain_log(ax.yaxis)
    heading = f"{title}\n" if title else ""
    canvas.dress(
        ax,
        clock.label,
        f"95 % bound [{unit.name}]",
        f"{heading}no truth: the tracks' own 95 % bounds",
    )
    canvas.legend(side, [Line2D([], [], color=canvas.TRACK, label=f"tracks ({len(tracks)})")])
    return figure


def calibration(
    bound: Any, distance: Any, *, title: str = "", path: str | Path | None = None
) -> Figure:
    """Draw errors of fixes against the bounds that the fixes give them themselves.

    Parameters
    ----------
    bound : (N,)
        Length that each fix gives its error with 95 % probability, m.
    distance : (N,)
        Length of its error, m.
    title : str
        Heading.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    bound = _validate.array("bound", bound, ("N",))
    distance = _validate.array("distance", distance, (len(bound),))
    what = "errors of fixes inside their own 95 % bounds"
    return canvas.finish(_scatter(bound, distance, what, title), path)


def _scatter(bound: Array, distance: Array, what: str, title: str) -> Figure:
    figure = canvas.figure(11.0, 7.0)
    grid = figure.add_gridspec(1, 2, width_ratios=[3.4, 1.0])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    inside = distance <= bound
    every = np.concatenate([bound, distance])
    every = every[np.isfinite(every) & (every > 0.0)]
    unit = Unit(float(np.median(every)))
    low, high = unit(0.7 * every.min()), unit(1.4 * every.max())
    handles: list[Any] = []
    for rows, colour, word in (
        (inside, canvas.TRACK, "error inside the bound"),
        (~inside, OUTSIDE, "error outside the bound"),
    ):
        handles += ax.plot(
            unit(bound[rows]),
            unit(distance[rows]),
            linestyle="",
            marker="o",
            markersize=4.0,
            alpha=0.7,
            color=colour,
            label=word,
        )
    handles += ax.plot(
        [low, high], [low, high], color=canvas.INK, linewidth=1.0, label="error = bound"
    )
    ax.set_xscale("log")
    ax.set_yscale("log")
    canvas.plain_log(ax.xaxis)
    canvas.plain_log(ax.yaxis)
    ax.set_xlim(low, high)
    ax.set_ylim(low, high)
    heading = f"{title}\n" if title else ""
    canvas.dress(
        ax,
        f"its own 95 % bound [{unit.name}]",
        f"position error [{unit.name}]",
        f"{heading}{100.0 * np.mean(inside):.0f} % of {len(inside)} {what}",
    )
    canvas.legend(side, handles)
    return figure
