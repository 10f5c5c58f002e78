"""Pictures in the manner of Source C's Figs. 3, 4 and 7: weights, errors over time, a sector."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.reproduce.phase_difference.scenario import EMITTER
from imm_tdoa.reproduce.phase_difference.tables import SHARE
from imm_tdoa.reproduce.phase_difference.trials import Trial
from imm_tdoa.reproduce.phase_difference.whole import PhaseDifferences

PALETTE = ("#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#0072B2", "#D55E00", "#9A9A9A")
ERROR = "position error [% of the distance]"


def single_run(result: PhaseDifferences, path: str | Path | None = None) -> Figure:
    """Draw one run of the base case: error and weights over time (Fig. 3)."""
    trial = result.base
    figure = canvas.figure(9.0, 6.8)
    figure.suptitle(
        "One run of the base case: error, and weights of the six hypotheses",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    top, bottom = figure.subplots(2, 1, sharex=True)
    top.plot(trial.times, 1e-3 * trial.error_m[0], color=canvas.TRACK, linewidth=2.0)
    top.set_ylim(bottom=0.0)
    canvas.dress(top, "", "position error [km]")
    nearest = int(np.argmin(np.linalg.norm(trial.means[0] - EMITTER, axis=-1)))
    for i, weight in enumerate(trial.weight[0].T):
        colour = PALETTE[i % len(PALETTE)]
        label = f"hypothesis {i + 1}{', nearest at first' if i == nearest else ''}"
        bottom.plot(trial.times, weight, color=colour, linewidth=1.6, label=label)
    heaviest = trial.weight[0].max(axis=-1)
    bottom.plot(trial.times, heaviest, ":", color=canvas.INK, linewidth=2.0, label="heaviest")
    bottom.set_ylim(0.0, 1.03)
    canvas.dress(bottom, "time [s]", "weight")
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return canvas.finish(figure, path)


def over_time(result: PhaseDifferences, path: str | Path | None = None) -> Figure:
    """Draw the error over time: of the base case (a), by number of hypotheses (b, Fig. 4)."""
    figure = canvas.figure(12.0, 5.4)
    left, right = figure.subplots(1, 2, sharey=True)
    base = result.base
    lines: list[tuple[Trial, str, str, str]] = [
        (base, canvas.TRACK, "-", "six hypotheses"),
        (result.lobes, canvas.START, "-", "one for every integer"),
        (result.trusting, canvas.STATION, "-", "six, platform errors not in R"),
    ]
    for trial, colour, style, label in lines:
        left.plot(trial.times, 100 * trial.over_time(), style, color=colour, lw=2.0, label=label)
        left.plot(trial.times, 100 * trial.over_time("mean"), ":", color=colour, lw=1.6)
    left.plot([], [], ":", color=canvas.INK, lw=1.6, label="mean instead of rms")
    _goal(left, base.times)
    left.plot([18.0], [100 * SHARE], "o", color=canvas.INK, markersize=6, label="the paper: 18 s")
    title = f"a) phase and rate, rms of {result.runs} runs"
    canvas.dress(left, "time [s]", ERROR, title)
    for (count, trial), colour in zip(result.counts.items(), PALETTE, strict=False):
        label = f"{count} hypothes{'is' if count == 1 else 'es'}"
        right.plot(trial.times, 100 * trial.over_time(), color=colour, lw=2.0, label=label)
    _goal(right, base.times)
    canvas.dress(right, "time [s]", "", "b) by number of hypotheses across the window")
    left.set_ylim(0.0, 18.0)
    left.legend(loc="upper right", frameon=False, fontsize=9)
    right.legend(loc="upper right", frameon=False, fontsize=9, ncols=2)
    return canvas.finish(figure, path)


def sector(result: PhaseDifferences, path: str | Path | None = None) -> Figure:
    """Draw the error over the phase error, with phase and rate or phase alone (Fig. 7)."""
    figure = canvas.figure(8.0, 5.2)
    ax = figure.subplots()
    for use, colour, label in (
        ("both", canvas.TRACK, "phase and rate"),
        ("phase", canvas.STATION, "phase alone"),
    ):
        trials = [t for (rows, _), t in result.sector.items() if rows == use]
        levels = np.array([level for rows, level in result.sector if rows == use])
        for time, style in ((30.0, "--s"), (40.0, "-o")):
            errors: Array = np.array([100 * t.at(time, "mean") for t in trials])
            ax.plot(levels, errors, style, color=colour, lw=2.0, label=f"{label}, {time:g} s")
    _goal(ax, levels)
    ax.set_ylim(bottom=0.0)
    canvas.dress(
        ax,
        "phase error [°]",
        ERROR,
        f"Sector of 40°, 12 hypotheses: mean error of {result.runs} runs",
    )
    ax.legend(loc="upper left", frameon=False, fontsize=9)
    return canvas.finish(figure, path)


def _goal(ax: Axes, across: Array) -> None:
    ax.axhline(100 * SHARE, color=canvas.TRUTH, linewidth=1.2, linestyle="--")
    ax.set_xlim(float(across[0]), float(across[-1]))
    ax.annotate(
        "5 %",
        (float(across[0]), 100 * SHARE),
        xytext=(4, 3),
        textcoords="offset points",
        fontsize=9,
        color="#777777",
    )
