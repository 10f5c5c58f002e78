"""Pictures of who is better: the ranking with its intervals, and what criteria choose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.study.report import lessons, paper, words
from imm_tdoa.study.report.paper import Picture
from imm_tdoa.study.results.statistics import share_error


def ranking(data: xr.Dataset, i: int) -> Picture | None:
    """Draw the error of each bank with its interval, the best on top; None without two banks."""
    order = lessons.order(data, i)
    if len(order) < 2:
        return None
    kind, names = data.attrs["ranked_by"], paper.banks(data)
    rows = [[data[f"{kind}_rmse{e}"].values[i, b] for b in order] for e in ("", "_low", "_high")]
    value, low, high = np.array(rows)
    figure = canvas.figure(paper.WIDTH, 1.3 + 0.34 * len(order))
    ax = figure.subplots()
    unit = Unit(float(np.nanmedian(value))) if kind == "position" else None
    shown = unit if unit is not None else np.asarray
    for y, b in enumerate(order):
        ends = np.array([[value[y] - low[y]], [high[y] - value[y]]])
        ends = np.where(np.isfinite(ends), ends, 0.0)
        ax.errorbar(
            shown(value[y]),
            y,
            xerr=shown(ends),
            fmt=paper.mark(b),
            color=paper.colour(b),
            markersize=6,
            linewidth=2.0,
            capsize=3.5,
        )
    for b in lessons.undefeated(data, i):
        y = order.index(b)
        ax.axhspan(y - 0.5, y + 0.5, color="#EEF4EE", zorder=0, linewidth=0.0)
    ax.set_ylim(len(order) - 0.5, -0.5)
    ax.set_yticks(range(len(order)), [names[b] for b in order])
    letters = [str(data["letters"].values[i, b]) for b in order]
    right = ax.secondary_yaxis("right")
    right.set_yticks(range(len(order)), letters)
    right.tick_params(length=0, labelsize=9.5)
    right.spines["right"].set_visible(False)
    paper.scaled(ax.xaxis, np.append(low, high))
    measure = unit.name if unit is not None else words.UNIT[kind]
    paper.dress(ax, f"{kind} RMSE [{measure}]", "")
    ax.grid(False, axis="y")
    what = words.scenario(data, i)
    told = [
        f"{names[b]} {words.length(float(v), words.UNIT[kind])} ({letter})"
        for b, v, letter in zip(order, value, letters, strict=True)
    ]
    sure = f"{100 * data.attrs['confidence']:g} %"
    return paper.finish(
        figure,
        f"ranking-{i + 1:03d}",
        f"Ranking, {what}",
        f"{sure} intervals. Banks that share a letter cannot be told apart by paired tests over "
        f"the same runs (Holm's correction for all pairs); shaded: not told apart from the best. "
        f"Intervals may overlap where the tests separate: errors of the same run go together.",
        f"Ranking in {what}: {', '.join(told)}.",
        i,
    )


def criteria(data: xr.Dataset, base: str, members: Sequence[int], k: int) -> Picture | None:
    """Draw how often each criterion chooses its richest candidate along one parameter."""
    if "chosen" not in data:
        return None
    key = str(data["scenario_parameter"].values[k])
    value = data["scenario_value"].values[:, k]
    members = sorted(members, key=lambda i: value[i])
    candidates = [
        [name for name in words.strings(row) if name] for row in data["candidate_name"].values
    ]
    share = np.array(
        [
            [data["chosen"].values[i, c, len(own) - 1] for i in members]
            for c, own in enumerate(candidates)
        ]
    )
    runs = data["runs_done"].values[members]
    error = share_error(share * runs, runs)
    figure = canvas.figure(paper.WIDTH, 1.7 + 0.55 * len(share))
    ax = figure.subplots()
    _cells(figure, ax, share, error)
    names = words.strings(data["criterion"].values)
    rich = {own[-1] for own in candidates}
    labels = [
        n if len(rich) == 1 else f"{n}\n{own[-1]}" for n, own in zip(names, candidates, strict=True)
    ]
    ax.set_yticks(range(len(labels)), labels)
    ax.set_xticks(range(len(members)), [words.plain(key, value[i]) for i in members])
    name = words.quantity(key)
    ax.set_xlabel(words.axis(key), color=canvas.INK)
    ax.tick_params(labelsize=9, length=0)
    for side in ax.spines.values():
        side.set_visible(False)
    least = float(np.nanmax(error)) if np.isfinite(error).any() else 0.0
    told = [
        f"{n} {', '.join(words.percent(float(s)) for s in row)}"
        for n, row in zip(names, share, strict=True)
    ]
    what = words.listed(sorted(rich), "or")
    return paper.finish(
        figure,
        f"criteria-{paper.file_name(base)}",
        f"Which criterion chooses {what}, over {name}",
        f"Per cent of the runs, with standard errors (at most {100 * least:.1f} points).",
        f"Share of the runs in which each criterion chooses {what} at {name} = "
        f"{', '.join(words.amount(key, value[i]) for i in members)}: {'; '.join(told)}.",
    )


def _cells(figure: Figure, ax: Axes, share: Array, error: Array) -> None:
    image = ax.imshow(100.0 * share, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    small = share.shape[1] > 8
    for (c, m), s in np.ndenumerate(share):
        if not np.isfinite(s):
            continue
        text = f"{100 * s:.0f}" if small else f"{100 * s:.0f}\n±{100 * error[c, m]:.1f}"
        ink = "white" if s > 0.6 else canvas.INK
        ax.text(m, c, text, ha="center", va="center", fontsize=8.5, color=ink, linespacing=1.0)
    bar = figure.colorbar(image, ax=ax, fraction=0.05, pad=0.02)
    bar.set_label("% of runs", color=canvas.INK)
    bar.ax.tick_params(labelsize=8.5)
