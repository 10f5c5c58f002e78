"""Cost per target-step as the job grows and beside others, and how far each goal is away."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from imm_tdoa.bench.measured import Figure, Measured, Point
from imm_tdoa.plot import canvas

PANELS = {
    "targets": "targets",
    "scans": "scans",
    "modes": "modes in the bank",
    "stations": "stations",
    "threads": "threads",
    "labelled": "labelled aircraft, 20 stations",
    "unlabelled": "unlabelled emitters, 8 stations",
}
MET, MISSED = "#009E73", "#D55E00"
COLOURS = (canvas.TRACK, "#E69F00")
COST = "µs per target-step"
AGREEMENT = 1e-3  # goals below it are of equal answers, not of speed
COMPARED = ("batch", "engines")  # measurements whose costs stand side by side


def scaling(found: Sequence[Measured], stamp: str, path: Path) -> bool:
    """Draw cost against targets, scans, modes, stations and threads; False where none is known."""
    points = [point for measured in found for point in measured.points]
    panels = [against for against in PANELS if any(p.against == against for p in points)]
    if not panels:
        return False
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = canvas.figure(3.8 * columns, 3.1 * rows + 0.8)
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for i, (ax, against) in enumerate(zip(axes, panels, strict=False)):
        _panel(ax, [p for p in points if p.against == against], PANELS[against])
        if i % columns == 0:
            ax.set_ylabel(COST, color=canvas.INK)
    for ax in axes[len(panels) :]:
        ax.axis("off")
    title = "What one target and step costs: medians, with the smallest and the largest"
    _frame(figure, title, stamp, int(46 * columns))
    canvas.finish(figure, path)
    return True


def _panel(ax: Axes, points: Sequence[Point], name: str) -> None:
    curves = list(dict.fromkeys(p.curve for p in points))
    for colour, curve in zip(COLOURS, curves, strict=False):
        own = sorted((p for p in points if p.curve == curve), key=lambda p: p.x)
        x = [p.x for p in own]
        cost = np.array([p.cost for p in own])
        ends = np.array([[p.low for p in own], [p.high for p in own]])
        ax.errorbar(
            x, cost, yerr=np.abs(ends - cost), color=colour, marker="o", markersize=4,
            linewidth=1.5, elinewidth=1.0, capsize=2, label=curve,
        )  # fmt: skip
    every = sorted({p.x for p in points})
    if every[-1] >= 10.0 * every[0]:
        ax.set_xscale("log")
    ax.xaxis.set_major_locator(FixedLocator(every))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _count(value)))
    ax.set_ylim(0.0, 1.12 * max(p.high for p in points))
    canvas.dress(ax, name, "")
    if len(curves) > 1:
        ax.legend(frameon=False, fontsize=9, labelcolor=canvas.INK)


def _count(value: float) -> str:
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:g} {unit}"
    return f"{value:g}"


def costs(found: Sequence[Measured], stamp: str, path: Path) -> bool:
    """Draw what a target-step costs here and elsewhere; False where nothing is known of it."""
    rows = [
        (measured.name, figure)
        for measured in found
        for figure in measured.figures
        if measured.name in COMPARED and figure.unit == COST
    ]
    if not rows:
        return False
    rows.sort(key=lambda row: -row[1].value)
    figure = canvas.figure(9.0, 1.3 + 0.36 * len(rows))
    ax = figure.subplots()
    least = min(row.low for _, row in rows) / 3.0
    for k, (_, row) in enumerate(rows):
        ours = not row.what.startswith(("filterpy", "Stone Soup"))
        colour = canvas.TRACK if ours else canvas.TRUTH
        ax.barh(k, row.value - least, left=least, height=0.62, color=colour, alpha=0.85)
        ax.plot([row.low, row.high], [k, k], color=canvas.INK, linewidth=1.0)
        said = f"{row.value:.0f}" if row.value >= 100.0 else f"{row.value:.3g}"
        ax.annotate(
            said, (max(row.value, row.high), k), (5, 0), va="center", fontsize=8,
            textcoords="offset points", color=canvas.INK,
        )  # fmt: skip
    ax.set_xscale("log")
    ax.set_xlim(least, 3.0 * max(row.high for _, row in rows))
    _labels(ax, [f"{name}: {row.what}" for name, row in rows])
    canvas.plain_log(ax.xaxis)
    canvas.dress(ax, COST, "")
    ax.grid(False, axis="y")
    _frame(figure, "One target and step, here (blue) and elsewhere (grey)", stamp, 130)
    canvas.finish(figure, path)
    return True


def goals(found: Sequence[Measured], stamp: str, path: Path) -> bool:
    """Draw every figure of speed or size that has a goal, relative to it; False where none has."""
    rows = [
        (measured.name, figure)
        for measured in found
        for figure in measured.figures
        if figure.goal is not None and figure.goal.limit > AGREEMENT and figure.value > 0.0
    ]
    if not rows:
        return False
    figure = canvas.figure(9.5, 1.5 + 0.36 * len(rows))
    ax = figure.subplots()
    for k, (_, row) in enumerate(rows):
        ends = [_margin(row, value) for value in (row.low, row.high)]
        middle = _margin(row, row.value)
        colour = MET if row.verdict == "met" else MISSED
        ax.plot(
            [1.0, middle], [k, k], color=colour, linewidth=7.0, alpha=0.3, solid_capstyle="butt"
        )
        ax.plot(ends, [k, k], color=colour, linewidth=1.5)
        ax.plot([middle], [k], color=colour, marker="o" if row.verdict == "met" else "X")
    ax.axvline(1.0, color=canvas.INK, linewidth=1.2)
    ax.set_xscale("log")
    _labels(ax, [f"{name}: {row.what}" for name, row in rows])
    canvas.plain_log(ax.xaxis)
    canvas.dress(ax, "times better than the goal", "")
    handles: list[Any] = [
        Line2D([], [], color=colour, marker=marker, linewidth=1.5, label=word)
        for colour, marker, word in ((MET, "o", "met"), (MISSED, "X", "missed"))
    ]
    ax.legend(handles=handles, frameon=False, fontsize=9, labelcolor=canvas.INK)
    _frame(figure, "Goals: medians, from the worst to the best repetition", stamp, 140)
    canvas.finish(figure, path)
    return True


def _margin(figure: Figure, value: float) -> float:
    assert figure.goal is not None
    limit = figure.goal.limit
    return value / limit if figure.goal.sense == "at least" else limit / value


def _labels(ax: Axes, labels: Sequence[str]) -> None:
    """Name the rows of a picture, the first at the top."""
    ax.set_yticks(range(len(labels)), labels, fontsize=8)
    ax.set_ylim(len(labels) - 0.4, -0.6)


def _frame(figure: Drawing, title: str, stamp: str, width: int) -> None:
    """Say what the picture shows, and in small letters where its figures come from."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=canvas.INK)
    lines = textwrap.fill(stamp, width)
    figure.supxlabel(lines, x=0.01, ha="left", fontsize=7, color="#666666")
