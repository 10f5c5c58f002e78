"""Pictures: spot and band before and after, as the source draws them, and what kappa foretells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.plot.maps import Box, settle
from imm_tdoa.reproduce.sequence_filter import geometries, moving, scenario
from imm_tdoa.reproduce.sequence_filter.cases import FIRST
from imm_tdoa.reproduce.sequence_filter.moving import Band
from imm_tdoa.reproduce.sequence_filter.spots import together
from imm_tdoa.reproduce.sequence_filter.whole import Reproduction

RAW = "#E69F00"
AFTER = canvas.FIX
PREDICTED = {True: "#009E73", False: "#D55E00"}


def spot(result: Reproduction, path: str | Path | None = None) -> Figure:
    """Draw the fixes of a target that stands: before, after, and after enlarged."""
    outcome = result.outcome(FIRST)
    spots, place = outcome.spots, outcome.case.place
    figure = canvas.figure(12.0, 5.0)
    figure.suptitle(
        f"A target that stands: the spot shrinks {spots.shrink:.0f}-fold, to a point that is not "
        f"the target\nlast {scenario.LAST} epochs of one run, 6 stations on a ring of 2 km, clocks "
        f"ticking every 10 ns, iso; rms error of {result.runs} runs "
        f"{together(spots.raw_error_m):.2f} m before, {together(spots.error_m):.3f} m after",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(1, 4, width_ratios=[1, 1, 1, 0.62])
    last = slice(-scenario.LAST, None)
    raw, after = outcome.raw_fixes[last] - place, outcome.fixes[last] - place
    zero = np.zeros((1, 2))
    wide = Box.of(np.concatenate([raw, after, zero]))
    close = Box.of(np.concatenate([after, zero]), least=0.01)
    unit, maps = Unit(1.0), []
    shown = (
        ("a) before: measured differences", raw, RAW, wide),
        ("b) after, same scale", after, AFTER, wide),
        ("c) after, enlarged", after, AFTER, close),
    )
    for i, (title, points, colour, box) in enumerate(shown):
        ax = figure.add_subplot(grid[0, i])
        ax.plot(*points.T, "o", color=colour, markersize=4.0, alpha=0.6, markeredgewidth=0.0)
        _target(ax)
        canvas.dress(ax, "east of the target [m]", "north [m]" if i == 0 else "", title, size=10)
        maps.append((ax, box, unit))
    handles = [_dot(RAW, "fix before"), _dot(AFTER, "fix after"), _cross()]
    canvas.legend(figure.add_subplot(grid[0, 3]), handles)
    settle(figure, maps)
    return canvas.finish(figure, path)


def band(result: Reproduction, path: str | Path | None = None) -> Figure:
    """Draw the fixes of a slow turn before and after, and what it costs at several speeds."""
    figure = canvas.figure(12.0, 8.0)
    slow = next(b for b in result.bands if b.weights == "full")
    figure.suptitle(
        f"A target that moves: a narrower band, behind the target\nat {slow.speed_mps:g} m/s width "
        f"{slow.raw_width_m:.2f} m before, {slow.width_m:.2f} m after; lag {slow.lag_m:.2f} m; rms "
        f"error {slow.raw_error_m:.2f} m before, {slow.error_m:.2f} m after",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(2, 3, height_ratios=[1.35, 1.0], width_ratios=[1, 1, 0.5])
    turn, maps = result.turn, []
    middle = turn.truth.mean(axis=0)
    box = Box.of(np.concatenate([turn.truth, turn.raw_fixes, turn.fixes]) - middle)
    shown = (("a) before", turn.raw_fixes, RAW), ("b) after", turn.fixes, AFTER))
    for i, (title, points, colour) in enumerate(shown):
        ax = figure.add_subplot(grid[0, i])
        ax.plot(*(turn.truth - middle).T, color=canvas.TRUTH, linewidth=4.0, alpha=0.75)
        ax.plot(*(points - middle).T, "-o", color=colour, linewidth=0.8, markersize=3.5)
        speed = f"{title}: a turn at {moving.TURN_SPEED_MPS:g} m/s, one fix a second"
        canvas.dress(ax, "x [m]", "y [m]" if i == 0 else "", speed, size=10)
        maps.append((ax, box, Unit(1.0)))
    canvas.legend(
        figure.add_subplot(grid[0, 2]),
        [
            Line2D([], [], color=canvas.TRUTH, linewidth=4.0, alpha=0.75, label="true path"),
            _dot(RAW, "before"),
            _dot(AFTER, "after"),
            Line2D([], [], color=canvas.STATION, marker="^", label="lag behind the target"),
        ],
    )
    bands = [b for b in result.bands if b.weights == "full"]
    _against_speed(figure.add_subplot(grid[1, 0]), bands, "width")
    _against_speed(figure.add_subplot(grid[1, 1]), bands, "error")
    figure.add_subplot(grid[1, 2]).axis("off")
    settle(figure, maps)
    return canvas.finish(figure, path)


def _against_speed(ax: Axes, bands: list[Band], what: str) -> None:
    speed = [b.speed_mps for b in bands]
    ax.plot(speed, [getattr(b, f"raw_{what}_m") for b in bands], "-o", color=RAW)
    ax.plot(speed, [getattr(b, f"{what}_m") for b in bands], "-o", color=AFTER)
    if what == "error":
        ax.plot(speed, [b.lag_m for b in bands], "-^", color=canvas.STATION)
    ax.set_xscale("log")
    canvas.plain_log(ax.xaxis)
    ax.set_ylim(bottom=0.0)
    title = "c) width of the band" if what == "width" else "d) rms error, and the lag in it"
    canvas.dress(ax, "speed [m/s]", f"{what} [m]", title, size=10)


def prediction(result: Reproduction, path: str | Path | None = None) -> Figure:
    """Draw how far spots shrank against the loop gain that foretold it."""
    figure = canvas.figure(10.0, 5.4)
    count = len(result.geometries)
    figure.suptitle(
        f"Whether the spot shrinks is known beforehand: kappa told right in {result.right} of "
        f"{count} random geometries",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(1, 2, width_ratios=[1.0, 0.36])
    ax = figure.add_subplot(grid[0, 0])
    ax.axvline(1.0, color=canvas.INK, linewidth=1.0, linestyle="--")
    ax.axhline(geometries.SHRUNK, color=canvas.INK, linewidth=1.0, linestyle=":")
    for g in result.geometries:
        marker = "o" if g.dims == 2 else "s"
        colour = PREDICTED[g.predicted]
        ax.plot(g.kappa, g.spots.shrink, marker, color=colour, markersize=8, alpha=0.8)
    known = [o for o in result.outcomes if o.kappa > 0.0]
    x, y = [o.kappa for o in known], [o.spots.shrink for o in known]
    ax.plot(x, y, "x", color=canvas.INK, markersize=7)
    ax.set_xscale("log")
    ax.set_yscale("log")
    for axis in (ax.xaxis, ax.yaxis):
        canvas.plain_log(axis)
    canvas.dress(ax, "loop gain kappa", "radius before / after")
    handles = [
        _dot(PREDICTED[True], "random geometry, should shrink"),
        _dot(PREDICTED[False], "should not"),
        Line2D([], [], linestyle="", marker="s", color=canvas.TRUTH, label="three dimensions"),
        Line2D([], [], linestyle="", marker="x", color=canvas.INK, label="cases of the table"),
        Line2D([], [], linestyle="--", color=canvas.INK, label="kappa = 1"),
        Line2D([], [], linestyle=":", color=canvas.INK, label="counts as shrunk"),
    ]
    canvas.legend(figure.add_subplot(grid[0, 1]), handles)
    return canvas.finish(figure, path)


def _target(ax: Axes) -> None:
    ax.plot(0.0, 0.0, "+", color=canvas.INK, markersize=14, markeredgewidth=1.8, zorder=8)


def _dot(colour: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="", marker="o", color=colour, label=label)


def _cross() -> Line2D:
    return Line2D([], [], linestyle="", marker="+", color=canvas.INK, markersize=12, label="target")
