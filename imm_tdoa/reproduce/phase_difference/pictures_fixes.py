"""Pictures in the manner of Source C's Figs. 5 and 6: clouds of fixes about the emitter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from imm_tdoa.plot import canvas
from imm_tdoa.reproduce.phase_difference.scenario import EMITTER
from imm_tdoa.reproduce.phase_difference.trials import Trial
from imm_tdoa.reproduce.phase_difference.whole import (
    BOX_M,
    OBSERVED_S,
    SPEED_S,
    PhaseDifferences,
    inside,
)

HALF_KM = (24.0, 36.0)  # east and north of the emitter shown


def by_time(result: PhaseDifferences, path: str | Path | None = None) -> Figure:
    """Draw the base case's fixes after 10 to 40 s (Fig. 5)."""
    cases = [(result.base, t, f"after {t:g} s") for t in OBSERVED_S]
    return _clouds(f"Fixes of {result.runs} runs by observation time", cases, path)


def by_speed(result: PhaseDifferences, path: str | Path | None = None) -> Figure:
    """Draw the fixes after 20 s at speeds of 100 to 400 m/s (Fig. 6)."""
    cases = [(trial, SPEED_S, f"{speed:g} m/s") for speed, trial in result.speeds.items()]
    title = f"Fixes of {result.runs} runs after {SPEED_S:g} s by the platform's speed"
    return _clouds(title, cases, path)


def _clouds(
    title: str, cases: Sequence[tuple[Trial, float, str]], path: str | Path | None
) -> Figure:
    figure = canvas.figure(13.0, 5.9)
    figure.suptitle(
        f"{title}; the box is 10 km about the emitter",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    axes = figure.subplots(1, len(cases), sharex=True, sharey=True, squeeze=False)[0]
    centre = 1e-3 * EMITTER
    for i, (ax, (trial, time, label)) in enumerate(zip(axes, cases, strict=True)):
        points = 1e-3 * trial.position[:, trial.index(time)]
        ax.plot(*points.T, "o", color=canvas.FIX, markersize=3.0, alpha=0.5, markeredgewidth=0)
        ax.plot(*centre, "*", color=canvas.STATION, markersize=11)
        mean = points.mean(axis=0)
        ax.plot(*mean, "+", color=canvas.INK, markersize=12, markeredgewidth=2.0)
        side = 2e-3 * BOX_M
        corner = (float(centre[0] - side / 2), float(centre[1] - side / 2))
        ax.add_patch(Rectangle(corner, side, side, fill=False, edgecolor="#C00000", linestyle="--"))
        ax.set_xlim(centre[0] - HALF_KM[0], centre[0] + HALF_KM[0])
        ax.set_ylim(centre[1] - HALF_KM[1], centre[1] + HALF_KM[1])
        ax.set_aspect("equal")
        away = np.abs(points - centre) > np.array(HALF_KM)
        beyond = int(np.count_nonzero(np.any(away, axis=-1)))
        if beyond:
            note = f"{beyond} beyond the picture"
            ax.annotate(note, (0.97, 0.97), xycoords="axes fraction", ha="right", va="top", size=8)
        panel = f"{label}: {100 * inside(trial, time):.0f} % in the box"
        canvas.dress(ax, "x [km]", "y [km]" if i == 0 else "", panel, size=10)
    handles = [
        axes[0].plot([], [], "o", color=canvas.FIX, markersize=4, label="fix")[0],
        axes[0].plot([], [], "+", color=canvas.INK, markersize=10, mew=2, label="their mean")[0],
        axes[0].plot([], [], "*", color=canvas.STATION, markersize=9, label="emitter")[0],
    ]
    axes[0].legend(handles=handles, loc="lower left", frameon=False, fontsize=8)
    return canvas.finish(figure, path)
