"""Pictures of the targets that switch: errors over time, modes, and the sweep of single filters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.plot import canvas
from imm_tdoa.reproduce.motion_form.scenario import MODELS, SWITCHING
from imm_tdoa.reproduce.motion_form.switches import Mixing
from imm_tdoa.reproduce.motion_form.switching_target import Single
from imm_tdoa.reproduce.motion_form.whole import MotionForm

RULE_COLOURS: dict[Mixing, str] = {
    "birth": canvas.TRACK,
    "unbiased": canvas.MIRROR,
    "zero": canvas.STATION,
}
RULE_TEXTS: dict[Mixing, str] = {
    "birth": "IMM, birth law",
    "unbiased": "IMM, unbiased mixing",
    "zero": "IMM, zero padding",
}
PHASES = ("standing", "constant velocity", "constant acceleration")
UNITS = dict(zip(MODELS, ("km²/s", "km²/s³", "km²/s⁵"), strict=True))


def over_time(result: MotionForm, path: str | Path | None = None) -> Figure:
    """Draw the errors of the IMMs and of the best single filter, and the mode probabilities.

    Parameters
    ----------
    result : MotionForm
        Everything.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    chosen, best = result.switches.mixing, result.sweep.best
    sample = result.switching.imms[chosen]
    ratio, error = sample.ratio(best.sample)
    figure = canvas.figure(12.0, 7.4)
    figure.suptitle(
        f"Targets that stand, set off and accelerate; the estimators are not told\n"
        f"one IMM: mean error {sample.mean_km:.3f} ± {sample.standard_error_km:.3f} km, "
        f"{ratio:.2f} ± {error:.2f} of the best single filter's, in {result.table.runs} runs",
        x=0.01,
        ha="left",
        fontsize=12,
        color=canvas.INK,
    )
    grid = figure.add_gridspec(2, 2, height_ratios=[1.9, 1.0], width_ratios=[3.2, 1.0])
    top, ribbon = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    handles = _errors(top, result)
    canvas.legend(figure.add_subplot(grid[0, 1]), handles)
    times = SWITCHING.times[1:]
    layers = ribbon.stackplot(
        times,
        result.switching.mode_probability[chosen].T,
        colors=canvas.MODES[: len(MODELS)],
        labels=MODELS,
        edgecolor="white",
        linewidth=0.3,
    )
    ribbon.set_ylim(0.0, 1.0)
    what = f"{RULE_TEXTS[chosen]}: what it takes them for"
    canvas.dress(ribbon, "time [s]", "mode probability", what, size=10)
    canvas.legend(figure.add_subplot(grid[1, 1]), layers[::-1])
    for ax in (top, ribbon):
        ax.set_xlim(float(times[0]), float(times[-1]))
        for change in (SWITCHING.sets_off_s, SWITCHING.accelerates_s):
            ax.axvline(change, color=canvas.INK, linewidth=1.0, linestyle=(0, (4, 3)))
    return canvas.finish(figure, path)


def _errors(ax: Axes, result: MotionForm) -> list[Any]:
    times, handles = SWITCHING.times[1:], []
    for rule, sample in result.switching.imms.items():
        label = f"{RULE_TEXTS[rule]}:\n{sample.mean_km:.3g} km on average"
        handles += ax.plot(
            times, sample.over_time_km, color=RULE_COLOURS[rule], linewidth=2.2, label=label
        )
    best = result.sweep.best
    label = (
        f"best single filter of {len(result.sweep.singles)},\n{best.model},\n"
        f"q = {best.process_noise:.2g} {UNITS[best.model]}:\n{best.sample.mean_km:.3g} km"
    )
    handles += ax.plot(
        times, best.sample.over_time_km, color=canvas.INK, linewidth=1.6, label=label
    )
    bound = result.switching.bound_km
    label = f"bound of a tracker told\nwhen, not how fast:\n{bound.mean():.3g} km"
    handles += ax.plot(times, bound, color=canvas.INK, linewidth=1.2, linestyle=":", label=label)
    ax.set_yscale("log")
    canvas.plain_log(ax.yaxis)
    low, high = ax.get_ylim()
    ax.set_ylim(low, 1.5 * high)
    changes = [0.0, SWITCHING.sets_off_s, SWITCHING.accelerates_s, float(times[-1])]
    for begin, end, text in zip(changes[:-1], changes[1:], PHASES, strict=True):
        ax.text(
            0.5 * (begin + end),
            0.97,
            text,
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="top",
            color=canvas.INK,
            path_effects=canvas.HALO,
        )
    canvas.dress(ax, "time [s]", "mean position error [km]")
    return handles


def sweep(result: MotionForm, path: str | Path | None = None) -> Figure:
    """Draw the mean error of every single filter over its process noise, and the IMM's.

    Parameters
    ----------
    result : MotionForm
        Everything.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    figure = canvas.figure(12.0, 5.4)
    grid = figure.add_gridspec(1, 2, width_ratios=[3.2, 1.0])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    positive = [s.process_noise for s in result.sweep.singles if s.process_noise > 0.0]
    none = min(positive) / 10.0  # where the axis shows no process noise at all
    handles: list[Any] = []
    for model, colour in zip(MODELS, canvas.MODES, strict=False):
        first, *rest = result.sweep.of_model(model)
        noise = [single.process_noise for single in rest]
        error = [single.sample.mean_km for single in rest]
        handles += ax.plot(
            noise, error, "-o", color=colour, markersize=4.0, label=f"{model} [{UNITS[model]}]"
        )
        ax.plot(none, first.sample.mean_km, "o", color=colour, markersize=7.0)
    best = result.sweep.best
    handles += _best(ax, best)
    handles += _imm(ax, result)
    ax.set_xscale("log")
    ax.set_yscale("log")
    canvas.plain_log(ax.yaxis)
    ax.set_xlim(0.4 * none, 1.6 * max(positive))
    decades = np.arange(np.ceil(np.log10(min(positive))), np.log10(max(positive)) + 0.5, 2.0)
    ax.set_xticks([none, *10.0**decades], ["none", *(f"$10^{{{d:.0f}}}$" for d in decades)])
    ax.set_xticks([], minor=True)
    canvas.dress(
        ax,
        "process noise of the single filter, in the unit of its model",
        "mean position error [km]",
        f"Single filters and one IMM on targets that stand, set off and accelerate "
        f"({result.table.runs} runs)",
    )
    canvas.legend(side, handles)
    return canvas.finish(figure, path)


def _best(ax: Axes, best: Single) -> list[Line2D]:
    return ax.plot(
        best.process_noise,
        best.sample.mean_km,
        "o",
        markersize=12.0,
        markerfacecolor="none",
        markeredgecolor=canvas.INK,
        markeredgewidth=1.6,
        label=f"best single filter:\n{best.sample.mean_km:.3f} ± "
        f"{best.sample.standard_error_km:.3f} km",
    )


def _imm(ax: Axes, result: MotionForm) -> list[Any]:
    chosen = result.switches.mixing
    sample = result.switching.imms[chosen]
    line = ax.axhline(sample.mean_km, color=canvas.TRACK, linewidth=2.0)
    line.set_label(
        f"{RULE_TEXTS[chosen]}:\n{sample.mean_km:.3f} ± {sample.standard_error_km:.3f} km"
    )
    bound = ax.axhline(
        float(result.switching.bound_km.mean()), color=canvas.INK, linewidth=1.2, linestyle=":"
    )
    bound.set_label("bound of a tracker told\nwhen, not how fast")
    return [line, bound]
