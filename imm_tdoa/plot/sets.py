"""How well all targets together are tracked, scan by scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from imm_tdoa.contract import Array
from imm_tdoa.following import Following
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock, Unit

LOCAL, MISSED, FALSE = "#0072B2", "#E69F00", "#B0307A"


def gospa(following: Following, *, title: str = "", path: str | Path | None = None) -> Figure:
    """Draw GOSPA and OSPA over time, what they are made of, and how many targets there were.

    Parameters
    ----------
    following : Following
        Targets and tracks side by side (`imm_tdoa.following.follow`).
    title : str
        Heading.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    figure = canvas.figure(11.0, 7.6)
    grid = figure.add_gridspec(3, 2, width_ratios=[3.4, 1.0], height_ratios=[1.3, 1.0, 1.0])
    clock = Clock(following.times)
    t = clock(following.times)
    panels = [figure.add_subplot(grid[k, 0]) for k in range(3)]
    sides = [figure.add_subplot(grid[k, 1]) for k in range(3)]
    unit = Unit(max(float(following.gospa.distance.max()), following.cutoff))
    _distances(panels[0], sides[0], following, t, unit, title)
    _matched(panels[1], sides[1], following, t, unit)
    _counts(panels[2], sides[2], following, t)
    for ax in panels:
        ax.set_xlim(t[0], t[-1] if t[-1] > t[0] else t[0] + 1.0)
        ax.set_ylim(bottom=0.0)
    for ax in panels[:2]:
        ax.set_xlabel("")
        ax.tick_params(labelbottom=False)
    panels[2].set_xlabel(clock.label)
    return canvas.finish(figure, path)


def _distances(
    ax: Axes, side: Axes, following: Following, t: Array, unit: Unit, title: str
) -> None:
    handles = [
        *ax.plot(t, unit(following.gospa.distance), color=canvas.INK, label="GOSPA"),
        *ax.plot(t, unit(following.ospa), color="#56B4E9", linewidth=1.2, label="OSPA"),
    ]
    canvas.dress(ax, "", f"distance [{unit.name}]", title)
    each = unit.text(following.cutoff * np.sqrt(0.5)).replace(" ", "\u00a0")
    c = unit.text(following.cutoff).replace(" ", "\u00a0")
    note = f"order 2, cutoff {c}: one missed emitter or false track makes a GOSPA of {each}"
    canvas.legend(side, handles, note)


def _matched(ax: Axes, side: Axes, following: Following, t: Array, unit: Unit) -> None:
    pairs = following.present.sum(axis=0) - following.missed
    known = np.where(pairs > 0.5, following.gospa.localisation, np.nan) / np.maximum(pairs, 1.0)
    error = np.sqrt(known)
    word = "RMS error of the tracks\nthat follow an emitter"
    line = ax.plot(t, unit(error), color=LOCAL, linewidth=1.4, label=word)
    canvas.dress(ax, "", f"position error [{unit.name}]")
    canvas.legend(side, line)


def _counts(ax: Axes, side: Axes, following: Following, t: Array) -> None:
    there, alive = following.present.sum(axis=0), following.alive.sum(axis=0)
    outlived = bool(np.any(following.false > 0.5))
    steps: dict[str, Any] = {"drawstyle": "steps-mid"}
    handles: list[Any] = [
        *ax.plot(t, there, color=canvas.TRUTH, linewidth=4.0, alpha=0.6, label="emitters", **steps),
        *ax.plot(t, alive, color=canvas.INK, linewidth=1.2, label="tracks", **steps),
    ]
    word = "emitters without a track"
    area = ax.fill_between(
        t, following.missed, step="mid", color=MISSED, alpha=0.45, linewidth=0.0, label=word
    )
    word = "tracks without an emitter"
    handles += [
        area,
        *ax.plot(t, following.false, color=FALSE, linewidth=1.6, label=word, **steps),
    ]
    canvas.dress(ax, "", "number")
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    note = "A track that has lost its emitter counts until it is ended." if outlived else ""
    canvas.legend(side, handles, note)
