"""The picture of a choice between motion models: the evidence for each, as it comes in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock
from imm_tdoa.selection import Comparison

LINEAR = 10.0  # nats drawn to scale; beyond them the axis is logarithmic
BANDS = ((1.0, 3.0, "positive"), (3.0, 5.0, "strong"))  # nats behind the best (§11)
SHADE = "#EDEDED", "#F7F7F7"


def evidence(
    comparison: Comparison | Mapping[str, Comparison],
    *,
    title: str = "",
    path: str | Path | None = None,
) -> Figure:
    """Draw how far each model lies behind the best, over the run and in a moving window.

    Of several targets: the margin of each, by the model that explains it best.

    Parameters
    ----------
    comparison : Comparison or mapping of name to Comparison
        What `imm_tdoa.selection.compare` found; a mapping holds single targets.
    title : str
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
        No comparison, or a batch within a mapping.
    """
    if isinstance(comparison, Mapping):
        if not comparison:
            raise ValueError("comparison: expected at least one comparison, got none")
        several = list(comparison.values())
        if any(found.margin.ndim for found in several):
            raise ValueError("comparison: expected a mapping of single targets, got a batch in it")
    else:
        several = [comparison.of(*i) for i in np.ndindex(comparison.margin.shape)]
    if len(several) == 1:
        return canvas.finish(_one(several[0], title), path)
    return canvas.finish(_many(several, title), path)


def _one(found: Comparison, title: str) -> Figure:
    figure = canvas.figure(11.0, 6.6)
    grid = figure.add_gridspec(2, 2, width_ratios=[3.4, 1.0])
    top = figure.add_subplot(grid[0, 0])
    below = figure.add_subplot(grid[1, 0], sharex=top)
    beside = figure.add_subplot(grid[:, 1])
    clock = Clock(found.times)
    heading = f"{title}\n" if title else ""
    handles = _behind(top, clock, found, found.evidence)
    canvas.dress(top, "", "nats behind the best", f"{heading}evidence of the whole run so far")
    top.tick_params(labelbottom=False)
    _behind(below, clock, found, found.windowed_evidence)
    scans = "scan" if found.width == 1 else f"{found.width} scans"
    canvas.dress(below, clock.label, "nats behind the best", f"evidence of the last {scans} alone")
    if len(found.times) > 1:
        top.set_xlim(*clock([found.times[0], found.times[-1]]))
    handles += [Patch(color=c, label=w) for c, (*_, w) in zip(SHADE, BANDS, strict=True)]
    prior = ", ".join(f"{k} {v:g}" for k, v in found.birth_std.items())
    note = f"\nverdict: {found.verdict}\n{found.reason}\n\nbirth std: {prior}"
    canvas.legend(beside, handles, note)
    return figure


def _behind(ax: Axes, clock: Clock, found: Comparison, evidence: Array) -> list[Any]:
    """Draw how far each model lies behind the best of the moment, the best on top."""
    rows = np.isfinite(evidence).all(axis=-1)
    evidence = evidence[rows]
    behind = evidence.max(axis=-1, keepdims=True) - evidence if len(evidence) else evidence
    for (low, high, _), colour in zip(BANDS, SHADE, strict=True):
        ax.axhspan(low, high, color=colour, zorder=0)
    handles: list[Any] = []
    for j, name in enumerate(found.names):
        handles += ax.plot(
            clock(found.times[rows]),
            behind[:, j],
            color=canvas.MODES[j % len(canvas.MODES)],
            linewidth=2.0,
            linestyle="-" if found.accepted[j] else (0, (4, 1.5)),
            marker="." if len(behind) <= 60 else "",
            label=name if found.accepted[j] else f"{name}\n(rejected by NIS)",
            clip_on=False,
        )
    _nats(ax, float(behind.max(initial=0.0)))
    return handles


def _nats(ax: Axes, most: float) -> None:
    """Count downwards from the best, by nats while they are few and by powers of ten beyond."""
    if most <= 3.0 * LINEAR:
        ax.set_ylim(max(1.08 * most, 6.0), -0.02 * max(most, 6.0))
        return
    ax.set_yscale("symlog", linthresh=LINEAR, linscale=1.5)
    _ticks(ax.yaxis, most)
    ax.set_ylim(1.5 * most, -0.3)


def _ticks(axis: Axis, most: float) -> None:
    """Name zero, the least margin that decides, and powers of ten."""
    decades = [10.0**k for k in range(1, 15) if 10.0**k <= 1.5 * most]
    step = 1 + len(decades) // 5
    axis.set_major_locator(FixedLocator([0.0, 3.0, *decades[::step]]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))


def _many(several: list[Comparison], title: str) -> Figure:
    """Draw the margin of each target in the row of its best model; hollow where undecided."""
    names = several[0].names
    if any(found.names != names for found in several):
        raise ValueError("comparison: expected comparisons of the same models")
    figure = canvas.figure(11.0, 1.8 + 0.8 * len(names))
    grid = figure.add_gridspec(1, 2, width_ratios=[3.4, 1.0])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    margin = np.array([float(found.margin) for found in several])
    best = np.array([int(found.best) for found in several])
    decided = np.array([found.verdict != "imm" for found in several])
    most = float(np.max(margin[np.isfinite(margin)], initial=10.0))
    margin = np.clip(np.nan_to_num(margin, posinf=1.2 * most), -3.0, None)
    for j in range(len(names)):
        rows = np.flatnonzero(best == j)
        spread = np.zeros(len(rows))  # apart enough to be counted, in the order of the margins
        spread[np.argsort(margin[rows])] = 0.3 * np.sin(2.4 * np.arange(len(rows)))
        colour = canvas.MODES[j % len(canvas.MODES)]
        for chosen in (True, False):
            some = decided[rows] == chosen
            ax.plot(
                margin[rows][some],
                j + spread[some],
                linestyle="",
                marker="o",
                markersize=6.0 if len(several) < 200 else 3.5,
                color=colour,
                markerfacecolor=colour if chosen else "white",
                alpha=0.8,
            )
    ax.axvline(several[0].threshold, color=canvas.INK, linewidth=1.0)
    if most > 3.0 * LINEAR:
        ax.set_xscale("symlog", linthresh=LINEAR, linscale=1.5)
        _ticks(ax.xaxis, most)
    ax.set_xlim(min(-0.02 * most, 1.1 * float(margin.min())), 1.3 * most)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_yticks(range(len(names)), names)
    heading = f"{title}\n" if title else ""
    canvas.dress(
        ax,
        "margin over the next model [nats]",
        "",
        f"{heading}{np.count_nonzero(decided)} of {len(several)} targets decided",
    )
    handles = [
        Line2D([], [], linestyle="", marker="o", color=canvas.INK, label="decided"),
        Line2D(
            [],
            [],
            linestyle="",
            marker="o",
            color=canvas.INK,
            markerfacecolor="white",
            label="undecided: imm",
        ),
        Line2D([], [], color=canvas.INK, linewidth=1.0, label="least margin that decides"),
    ]
    canvas.legend(side, handles)
    return figure
