"""Errors against noise with the bound, and against the distance to a shared coordinate."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.reproduce.receiver_errors.coordinate import COMPARED, Coordinate
from imm_tdoa.reproduce.receiver_errors.levels import Curve, Varied
from imm_tdoa.reproduce.receiver_errors.sample import ESTIMATORS
from imm_tdoa.reproduce.receiver_errors.scenario import SOURCES

LOOKS = {
    "first-step": ("#E69F00", "v", "first step alone"),
    "squared": ("#CC79A7", "s", "squared second step"),
    "error-correction": ("#009E73", "o", "error correction"),
    "joint": ("#0072B2", "D", "joint"),
    "trusted": ("#D55E00", "x", "receivers trusted"),
}
AXES: dict[Varied, tuple[str, str]] = {
    "receivers": ("σ of a coordinate of receiver 1 [m]", "Errors of the receivers' places"),
    "measurement": ("σ of a range difference [m]", "Noise of the measurement"),
}
QUANTITIES = ("position RMSE [m]", "velocity RMSE [m/s]")
BEYOND = 300.0  # times the largest bound: where a panel ends


def of_noise(
    curves: tuple[Curve, ...], varied: Varied, runs: int, path: str | Path | None = None
) -> Figure:
    """Draw the errors of all estimators over one kind of noise: both emitters, both quantities.

    Parameters
    ----------
    curves : tuple of Curve
        What `sweep` gives.
    varied : "receivers" or "measurement"
        Which curves.
    runs : int
        Runs of each level, for the heading.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    chosen = [curve for curve in curves if curve.varied == varied]
    figure = canvas.figure(12.0, 7.6)
    label, heading = AXES[varied]
    other = "range differences" if varied == "receivers" else "a coordinate of receiver 1:"
    figure.suptitle(
        f"{heading}: five estimators and the Cramér-Rao bound, {runs} runs; σ of {other} 0.01 m",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(2, len(chosen) + 1, width_ratios=[1.0] * len(chosen) + [0.42])
    for column, curve in enumerate(chosen):
        x = np.sqrt(curve.levels)
        for row, quantity in enumerate(QUANTITIES):
            ax = figure.add_subplot(grid[row, column])
            _lines(ax, x, {n: curve.rmse(n)[:, row] for n in ESTIMATORS}, curve.bound[:, row])
            ax.plot(x, curve.trusting[:, row], ":", color=LOOKS["trusted"][0], linewidth=1.4)
            place = ", ".join(f"{v:g}" for v in SOURCES[curve.source])
            title = f"{curve.source} emitter ({place}) m" if row == 0 else ""
            canvas.dress(ax, label if row else "", "" if column else quantity, title, size=10)
    handles = [*_handles(ESTIMATORS), _line("receivers trusted,\nby theory", ":")]
    handles[-1].set(color=LOOKS["trusted"][0])
    chance = 100.0 / np.sqrt(2.0 * runs)  # one standard deviation of an RMS error, of it
    note = f"one noise for all points:\n±{chance:.0f} % by chance, alike"
    canvas.legend(figure.add_subplot(grid[:, -1]), handles, note)
    return canvas.finish(figure, path)


def of_coordinate(found: Coordinate, path: str | Path | None = None) -> Figure:
    """Draw velocity and position errors against the distance in x from the reference receiver.

    Parameters
    ----------
    found : Coordinate
        What `shared_coordinate` gives.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    figure = canvas.figure(12.0, 4.6)
    figure.suptitle(
        "An emitter that nearly shares x with the reference receiver: the squared second step "
        "divides by that distance",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(1, 3, width_ratios=[1.0, 1.0, 0.42])
    for row, quantity in enumerate(QUANTITIES):
        ax = figure.add_subplot(grid[0, row])
        errors = {n: found.rmse(n)[:, row] for n in COMPARED}
        _lines(ax, found.away, errors, found.bound[:, row], beyond=1e5)
        canvas.dress(ax, "x of the emitter less x of the reference [m]", quantity)
    canvas.legend(figure.add_subplot(grid[0, 2]), _handles(COMPARED))
    return canvas.finish(figure, path)


def _lines(
    ax: Axes, x: Array, errors: dict[str, Array], bound: Array, beyond: float = BEYOND
) -> None:
    ax.plot(x, bound, color=canvas.INK, linewidth=2.0, zorder=1)
    for name, values in errors.items():
        colour, marker, _ = LOOKS[name]
        ax.plot(x, values, color=colour, marker=marker, markersize=4.5, linewidth=1.1)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(0.5 * float(bound.min()), beyond * float(bound.max()))
    largest = max(float(np.nanmax(values)) for values in errors.values())
    top = min(ax.get_ylim()[1], max(2.0 * largest, 10.0 * float(bound.max())))
    ax.set_ylim(0.5 * float(bound.min()), top)
    if x[-1] < 5e3 * x[0]:
        canvas.plain_log(ax.xaxis)
    canvas.plain_log(ax.yaxis)


def _handles(names: tuple[str, ...]) -> list[Line2D]:
    handles = [_line("Cramér-Rao bound", "-")]
    handles[0].set_linewidth(2.0)
    for name in names:
        colour, marker, label = LOOKS[name]
        line = _line(label, "-")
        line.set(color=colour, marker=marker, markersize=4.5)
        handles.append(line)
    return handles


def _line(label: str, style: Literal["-", ":"]) -> Line2D:
    return Line2D([], [], color=canvas.INK, linewidth=1.3, linestyle=style, label=label)
