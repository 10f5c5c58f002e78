"""Pictures over time: errors with their bound, consistency, mode probabilities."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.study.report import lessons, paper, words
from imm_tdoa.study.report.paper import Picture

MOST_RIBBONS = 6


def errors(data: xr.Dataset, i: int) -> Picture | None:
    """Draw error and NEES of all banks over time; None where nothing is scored."""
    rmse = data["position_rmse_by_time"].values[i]
    times = data["time_s"].values[i]
    scans = np.isfinite(times)
    if not np.isfinite(rmse).any():
        return None
    times, clock = times[scans], Clock(times[scans])
    bound = data["position_bound_by_time"].values[i][scans]
    names, order = paper.banks(data), lessons.order(data, i)
    shown = paper.picked(order)
    handles: list[Any] = [
        Line2D([], [], linewidth=1.8, label=names[b], **paper.look(b)) for b in shown
    ]
    if np.isfinite(bound).any():
        least = Line2D(
            [], [], color=canvas.INK, linewidth=1.4, linestyle=":", label="Cramér-Rao bound"
        )
        handles.append(least)
    handles.append(Patch(color="#E4E4E4", label="consistent"))
    figure = canvas.figure(paper.WIDTH, 5.0 + paper.rows(handles))
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.0, 1.0])
    unit = Unit(float(np.nanquantile(rmse[shown], 0.9)))
    for b in shown:
        band = [data[f"position_rmse_by_time_{end}"].values[i, b][scans] for end in ("low", "high")]
        _line(top, clock(times), unit(rmse[b][scans]), unit(band), b)
    if np.isfinite(bound).any():
        top.plot(clock(times), unit(bound), color=canvas.INK, linewidth=1.4, linestyle=":")
    known = np.append(rmse[shown].ravel(), bound)
    paper.scaled(top.yaxis, known)
    if top.get_yscale() == "linear":
        top.set_ylim(0.0, None)
    paper.dress(top, "", f"position RMSE [{unit.name}]")
    _consistency(below, data, i, shown, clock(times), scans)
    if len(times) > 1:
        below.set_xlim(*clock([times[0], times[-1]]))
    paper.dress(below, clock.label, "NEES / expected")
    paper.legend(figure, handles)
    sure = f"{100 * data.attrs['confidence']:g} %"
    what = words.scenario(data, i)
    ends = [f"{names[b]} {words.number(_last(rmse[b]))} m" for b in shown]
    return paper.finish(
        figure,
        f"errors-{i + 1:03d}",
        f"Error over time, {what}",
        f"Root mean square over the runs with {sure} intervals at each scan. Below: squared error "
        f"over what the covariance promises; above the grey band a filter is too sure of itself."
        + paper.left_out(order, shown),
        f"Position RMSE over time in {what}. At the last scan: {words.listed(ends)}.",
        i,
    )


def _last(row: Array) -> float:
    known = row[np.isfinite(row)]
    return float(known[-1]) if len(known) else float("nan")


def _line(ax: Axes, times: Array, value: Array, band: Array, b: int) -> None:
    ax.fill_between(times, band[0], band[1], color=paper.colour(b), alpha=0.18, linewidth=0.0)
    ax.plot(times, value, linewidth=1.6, **paper.look(b))


def _consistency(
    ax: Axes, data: xr.Dataset, i: int, shown: list[int], times: Array, scans: Any
) -> None:
    """NEES over its expectation on the region of a consistent filter."""
    ratio, low, high = (
        data[f"nees_ratio_by_time{end}"].values[i][shown][:, scans] for end in ("", "_low", "_high")
    )
    known = np.isfinite(low).any(axis=0)
    if known.any():
        least, most = np.nanmin(low[:, known], axis=0), np.nanmax(high[:, known], axis=0)
        ax.fill_between(times[known], least, most, color="#E4E4E4", linewidth=0.0)
    for b, row in zip(shown, ratio, strict=True):
        ax.plot(times, row, linewidth=1.4, **paper.look(b))
    ax.axhline(1.0, color=canvas.INK, linewidth=0.8)
    ax.set_yscale("log")
    canvas.plain_log(ax.yaxis)
    every = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if len(every):
        ax.set_ylim(min(0.5, 0.8 * every.min()), max(2.0, 1.25 * every.max()))


def ribbons(data: xr.Dataset, i: int) -> Picture | None:
    """Draw the mode probabilities of every bank of several modes; None where there is none."""
    names = paper.banks(data)
    modes = [[mode for mode in words.strings(row) if mode] for row in data["mode_name"].values]
    probability = data["mode_probability"].values[i]
    order = [
        b for b in lessons.order(data, i) if len(modes[b]) > 1 and np.isfinite(probability[b]).any()
    ]
    several = sorted(order[:MOST_RIBBONS])
    if not several:
        return None
    times = data["time_s"].values[i]
    scans = np.isfinite(times)
    times, clock = times[scans], Clock(times[scans])
    every = list(dict.fromkeys(mode for b in several for mode in modes[b]))
    colours = {mode: canvas.MODES[k % len(canvas.MODES)] for k, mode in enumerate(every)}
    handles = [Patch(color=colours[mode], label=mode) for mode in every]
    figure = canvas.figure(paper.WIDTH, 1.0 + 1.35 * len(several) + paper.rows(handles))
    axes = figure.subplots(len(several), 1, sharex=True, squeeze=False)[:, 0]
    for ax, b in zip(axes, several, strict=True):
        shares = np.nan_to_num(probability[b][scans, : len(modes[b])])
        ax.stackplot(
            clock(times), shares.T, colors=[colours[mode] for mode in modes[b]], linewidth=0.0
        )
        ax.set_ylim(0.0, 1.0)
        ax.set_yticks([0.0, 0.5, 1.0])
        paper.dress(ax, clock.label if ax is axes[-1] else "", "", names[b])
    if len(times) > 1:
        axes[-1].set_xlim(*clock([times[0], times[-1]]))
    axes[len(axes) // 2].set_ylabel("mean probability", color=canvas.INK)
    paper.legend(figure, handles)
    what = words.scenario(data, i)
    told = []
    for b in several:
        mean = np.nanmean(probability[b][scans, : len(modes[b])], axis=0)
        j = int(np.argmax(mean))
        told.append(f"{names[b]} mostly {modes[b][j]} ({words.percent(float(mean[j]))})")
    return paper.finish(
        figure,
        f"modes-{i + 1:03d}",
        f"Mode probabilities, {what}",
        "Mean over the runs."
        + (f" The best {MOST_RIBBONS} of {len(order)}." if len(order) > len(several) else ""),
        f"Mode probabilities over time in {what}: {words.listed(told)}.",
        i,
    )
