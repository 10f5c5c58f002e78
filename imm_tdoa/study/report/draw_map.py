"""Pictures over swept parameters: which bank wins where, and what a parameter costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.study.report import lessons, paper, words
from imm_tdoa.study.report.paper import Picture


def lines(data: xr.Dataset, base: str, members: Sequence[int], k: int) -> Picture | None:
    """Draw the error of every bank along one parameter that is a number."""
    kind, names = data.attrs["ranked_by"], paper.banks(data)
    key = str(data["scenario_parameter"].values[k])
    value = data["scenario_value"].values[:, k] * words.scale(key)
    members = sorted(members, key=lambda i: value[i])
    rmse = data[f"{kind}_rmse"].values[members]
    if not np.isfinite(rmse).any():
        return None
    x = value[members]
    mean = np.mean(np.log(lessons.regret(data)[members]), axis=0)
    order = [int(b) for b in np.argsort(mean) if np.isfinite(rmse[:, b]).any()]
    chosen = paper.picked(order)
    handles = [
        Line2D([], [], marker=paper.mark(b), markersize=5, label=names[b], **paper.look(b))
        for b in chosen
    ]
    figure = canvas.figure(paper.WIDTH, 3.6 + paper.rows(handles))
    ax = figure.subplots()
    unit: Any = Unit(float(np.nanmedian(rmse))) if kind == "position" else None
    shown = unit if unit is not None else np.asarray
    for b in chosen:
        low, high = (data[f"{kind}_rmse_{end}"].values[members, b] for end in ("low", "high"))
        ax.fill_between(x, shown(low), shown(high), color=paper.colour(b), alpha=0.2, linewidth=0.0)
        ax.plot(x, shown(rmse[:, b]), marker=paper.mark(b), markersize=5, **paper.look(b))
    paper.scaled(ax.yaxis, rmse[:, chosen])
    if np.all(x > 0.0):
        paper.scaled(ax.xaxis, x)
    name = words.quantity(key)
    measure = unit.name if unit is not None else words.UNIT[kind]
    paper.dress(ax, words.axis(key), f"{kind} RMSE [{measure}]")
    paper.legend(figure, handles)
    best = [
        f"{value[i]:g}: {words.listed([names[b] for b in lessons.undefeated(data, i)], 'or')}"
        for i in members
        if lessons.order(data, i)
    ]
    sure = f"{100 * data.attrs['confidence']:g} %"
    return paper.finish(
        figure,
        f"sweep-{paper.file_name(base)}",
        f"Error over {name}",
        f"{sure} intervals of each bank by itself; paired comparisons are sharper."
        + paper.left_out(order, chosen),
        f"{kind.capitalize()} RMSE over {name}. Best, or not told apart from it: "
        f"{'; '.join(best)}.",
    )


def winners(data: xr.Dataset, base: str, members: Sequence[int], two: Sequence[int]) -> Picture:
    """Draw which bank wins where, over two parameters, one map for each point of the others.

    Parameters
    ----------
    data : Dataset
        A study.
    base : str
        What the scenarios of the sweep are called.
    members : sequence of int
        Those scenarios.
    two : sequence of int
        Parameters that change among them; the first two are the axes.
    """
    x, y, *others = (two[-1], two[-2], *two[:-2])
    names = paper.banks(data)
    text = data["scenario_point"].values
    columns, rows = (_levels(data, members, k) for k in (x, y))
    facets: dict[tuple[str, ...], list[int]] = {}
    for i in members:
        facets.setdefault(tuple(text[i, others].tolist()), []).append(i)
    ahead = {i: lessons.undefeated(data, i) if lessons.order(data, i) else [] for i in members}
    seen = sorted({b for best in ahead.values() for b in best})
    handles = [Patch(color=paper.colour(b), label=names[b]) for b in seen]
    panel = 0.75 + 0.5 * len(rows)
    figure = canvas.figure(paper.WIDTH, panel * len(facets) + paper.rows(handles) + 0.4)
    axes = figure.subplots(len(facets), 1, squeeze=False)[:, 0]
    parameter = words.strings(data["scenario_parameter"].values)
    for ax, (point, cells) in zip(axes, facets.items(), strict=True):
        for i in cells:
            at = columns.index(str(text[i, x])), rows.index(str(text[i, y]))
            _cell(ax, at, ahead[i], _lead(data, i, ahead[i]))
        ax.set_xlim(-0.5, len(columns) - 0.5)
        ax.set_ylim(-0.5, len(rows) - 0.5)
        ax.set_xticks(range(len(columns)), _shown(parameter[x], columns))
        ax.set_yticks(range(len(rows)), _shown(parameter[y], rows))
        heading = ", ".join(
            f"{words.quantity(parameter[k])} {_shown(parameter[k], [v])[0]}"
            for k, v in zip(others, point, strict=True)
        )
        canvas.dress(ax, words.axis(parameter[x]), words.axis(parameter[y]), heading, size=10)
        ax.grid(False)
        ax.tick_params(labelsize=9, length=0)
        for side in ("left", "bottom"):
            ax.spines[side].set_visible(False)
    paper.legend(figure, handles)
    told = [
        f"{words.scenario(data, i)}: {words.listed([names[b] for b in ahead[i]], 'or') or 'none'}"
        for i in members
    ]
    return paper.finish(
        figure,
        f"winners-{paper.file_name(base)}",
        f"Which bank wins where, {base}" if base else "Which bank wins where",
        "Colour: the bank with the smallest error; several colours: banks that cannot be told "
        "apart from it. Numbers: the error of the next that can, over the smallest.",
        f"The best bank, or those not told apart from it. {'; '.join(told)}.",
    )


def _shown(key: str, levels: Sequence[str]) -> list[str]:
    """Values of a parameter as an axis shows them."""
    try:
        return [words.plain(key, float(level)) for level in levels]
    except ValueError:
        return list(levels)


def _levels(data: xr.Dataset, members: Sequence[int], k: int) -> list[str]:
    """Values of a parameter as text, numbers by size and names as they come."""
    text = words.strings(data["scenario_point"].values[list(members), k])
    value = data["scenario_value"].values[list(members), k]
    unique = dict.fromkeys(text)
    if np.isfinite(value).all():
        size = dict(zip(text, value.tolist(), strict=True))
        return sorted(unique, key=lambda t: size[t])
    return list(unique)


def _lead(data: xr.Dataset, i: int, ahead: Sequence[int]) -> str:
    """The error of the next bank that is told apart from the best, over the best's."""
    beaten = [b for b in lessons.order(data, i) if b not in ahead]
    if not ahead or not beaten:
        return "=" if len(ahead) > 1 else ""
    return f"{data['rmse_ratio'].values[i, beaten[0], ahead[0]]:.2f}"


def _cell(ax: Axes, at: tuple[int, int], ahead: Sequence[int], text: str) -> None:
    """One cell in the colours of the banks that are ahead, the best first."""
    x, y = at
    if not ahead:
        ax.text(x, y, "none", ha="center", va="center", fontsize=8.5, color=canvas.INK)
        return
    wide = 0.94 / len(ahead)
    for n, b in enumerate(ahead):
        left = x - 0.47 + n * wide
        ax.add_patch(
            Rectangle((left, y - 0.46), wide, 0.92, facecolor=paper.colour(b), linewidth=0.0)
        )
    ax.text(
        x,
        y,
        text,
        ha="center",
        va="center",
        fontsize=9,
        color=canvas.INK,
        path_effects=list(canvas.HALO),
    )


def tuning(data: xr.Dataset) -> Picture | None:
    """Draw what swept parameters of the banks cost; None where no bank was swept.

    One parameter gives lines, a line per scenario; two give a heat map, averaged over scenarios.
    """
    members = [b for b, point in enumerate(data["bank_point"].values) if any(point)]
    numeric = lessons.swept(data, "bank", members) if members else []
    if not numeric:
        return None
    over = lessons.regret(data)[:, members]
    value = data["bank_value"].values[members]
    names = words.strings(data["bank_parameter"].values)
    if len(numeric) == 1:
        return _tuning_lines(data, over, value[:, numeric[0]], names[numeric[0]])
    x, y = numeric[-1], numeric[-2]
    columns, rows = np.unique(value[:, x]), np.unique(value[:, y])
    mean = np.exp(np.mean(np.log(over), axis=0))
    cells = np.full((len(rows), len(columns)), np.nan)
    for r, row in enumerate(rows):
        for c, column in enumerate(columns):
            there = (value[:, x] == column) & (value[:, y] == row)
            if there.any() and np.isfinite(mean[there]).any():
                cells[r, c] = np.nanmin(mean[there])
    figure = canvas.figure(paper.WIDTH, 1.5 + 0.5 * len(rows))
    ax = figure.subplots()
    top = float(np.nanmax(cells)) if np.isfinite(cells).any() else 2.0
    image = ax.imshow(
        cells, cmap="YlOrBr", vmin=1.0, vmax=max(top, 1.1), aspect="auto", origin="lower"
    )
    for (r, c), v in np.ndenumerate(cells):
        if np.isfinite(v):
            dark = v > 1.0 + 0.65 * (top - 1.0)
            ax.text(
                c,
                r,
                f"{v:.2f}",
                ha="center",
                va="center",
                fontsize=9,
                color="white" if dark else canvas.INK,
            )
    ax.set_xticks(range(len(columns)), [words.plain(names[x], v) for v in columns])
    ax.set_yticks(range(len(rows)), [words.plain(names[y], v) for v in rows])
    ax.set_xlabel(words.axis(names[x]), color=canvas.INK)
    ax.set_ylabel(words.axis(names[y]), color=canvas.INK)
    ax.tick_params(labelsize=9, length=0)
    bar = figure.colorbar(image, ax=ax, fraction=0.05, pad=0.02)
    bar.set_label("error over the best", color=canvas.INK)
    bar.ax.tick_params(labelsize=8.5)
    r, c = divmod(int(np.nanargmin(cells)), len(columns))
    return paper.finish(
        figure,
        "tuning",
        f"What {words.quantity(names[y])} and {words.quantity(names[x])} cost",
        "Error over that of the best bank of the scenario, mean over the scenarios.",
        f"Error over the best for each {names[y]} and {names[x]}: least, "
        f"{cells[r, c]:.2f}, at {rows[r]:g} and {columns[c]:g}; most {np.nanmax(cells):.2f}.",
    )


def _tuning_lines(data: xr.Dataset, over: Array, value: Array, key: str) -> Picture:
    levels = np.unique(value[np.isfinite(value)])
    # of several banks at one value the best counts
    cost = np.array([[np.min(row[value == v]) for v in levels] for row in over])
    shown = range(min(len(cost), 8))
    handles = [
        Line2D(
            [],
            [],
            marker=paper.mark(i),
            markersize=5,
            label=words.scenario(data, i),
            **paper.look(i),
        )
        for i in shown
    ]
    figure = canvas.figure(paper.WIDTH, 3.3 + paper.rows(handles))
    ax = figure.subplots()
    for i in shown:
        ax.plot(
            levels * words.scale(key), cost[i], marker=paper.mark(i), markersize=5, **paper.look(i)
        )
    if np.all(levels > 0.0):
        paper.scaled(ax.xaxis, levels)
    paper.scaled(ax.yaxis, cost)
    paper.dress(ax, words.axis(key), "error over the best")
    paper.legend(figure, handles)
    mean = np.exp(np.mean(np.log(cost), axis=0))
    told = [f"{m:.2f} at {words.amount(key, v)}" for m, v in zip(mean, levels, strict=True)]
    return paper.finish(
        figure,
        "tuning",
        f"What the {words.quantity(key)} costs",
        "Error over that of the best bank of the same scenario.",
        f"Error over the best along {words.quantity(key)}, mean over the scenarios: "
        f"{', '.join(told)}.",
    )
