"""The picture of an error: how large it is, and how large the track itself says it may be."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

from imm_tdoa import _validate, metrics
from imm_tdoa.bounds import PosteriorBound
from imm_tdoa.contract import AXES, Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.agreement import OUTSIDE, pooled
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.recording import Recording
from imm_tdoa.scoring import Errors, against_points, against_truth
from imm_tdoa.track import Track

LEAST = "#7B3294"  # told apart from the error, the track's bound and what lies outside it
STEEP = 12.0  # a curve whose ends differ by more than this factor is drawn on a log scale


def error(
    track: Track | Mapping[str, Track],
    recording: Recording | None = None,
    *,
    target: str | None = None,
    truth: tuple[Any, Any] | None = None,
    bound: PosteriorBound | tuple[Any, Any] | None = None,
    title: str | None = None,
    path: str | Path | None = None,
) -> Figure:
    """Draw the position error over time against the track's own 95 % bound.

    Without truth: the bound, and the normalised innovation squared over its 95 % limit. Of
    several tracks: every error against its own bound.

    Parameters
    ----------
    track : Track or mapping of name to Track
        One track, or several, which are drawn together.
    recording : Recording, optional
        Gives truth and title.
    target : str, optional
        Whose track it is; may be left out where the recording has only one.
    truth : (times (K,), positions (K, d)), optional
        Truth of a single track, s and m, instead of the recording's; straight in between.
    bound : PosteriorBound or (times (K,), rms (K,)), optional
        Least root-mean-square error that a single track could have (`bounds.pcrlb`), s and m;
        drawn dashed, not where it is infinite or NaN.
    title : str, optional
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
        A `bound` for several tracks, or one that is no list of times and errors.
    """
    if title is None:
        title = "" if recording is None else recording.title
    least = None if bound is None else _least(bound)
    if isinstance(track, Mapping) and len(track) != 1:
        if bound is not None:
            raise ValueError(f"bound: expected a single track to compare with, got {len(track)}")
        return canvas.finish(pooled(track, recording, title), path)
    if isinstance(track, Mapping):
        target, track = next(iter(track.items()))
    found = None
    if truth is not None:
        found = against_points(track, *truth)
    elif recording is not None:
        found = against_truth(track, recording, target)
    return canvas.finish(_one(track, found, least, title), path)


def _least(bound: Any) -> tuple[Array, Array]:
    """Return times (K,) and root-mean-square errors (K,) of a bound."""
    pair = (bound.times, bound.position_rms) if isinstance(bound, PosteriorBound) else bound
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise ValueError(f"bound: expected a PosteriorBound or (times, rms), got {bound!r}")
    times = _validate.array("bound: times", pair[0], ("K",))
    try:
        rms = np.array(pair[1], dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"bound: expected numbers for rms, got {pair[1]!r}") from error
    if rms.shape != times.shape:
        raise ValueError(
            f"bound: expected one error for each of the {len(times)} times of one trajectory, "
            f"got shape {rms.shape}"
        )
    return times, np.where(np.isfinite(rms), rms, np.nan)


def _one(
    track: Track, errors: Errors | None, least: tuple[Array, Array] | None, title: str
) -> Figure:
    figure = canvas.figure(11.0, 4.2 if errors is not None else 6.0)
    grid = figure.add_gridspec(1 if errors is not None else 2, 2, width_ratios=[3.4, 1.0])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    clock = Clock(track.times)
    if errors is None:
        bound = metrics.error_radius(track.position_covariance)
        canvas.legend(side, _bound(ax, clock, track.times, bound, None, least))
        what = f"{title}\n" if title else ""
        canvas.dress(
            ax, clock.label, ax.get_ylabel(), f"{what}no truth: the track's own 95 % bound"
        )
        below, beside = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
        canvas.legend(beside, _consistency(below, clock, track))
        if len(track.times) > 1:
            below.set_xlim(*clock([track.times[0], track.times[-1]]))
    else:
        kind = _kind(errors, track.space.dims)
        handles = _bound(ax, clock, errors.times, errors.bound, errors.distance, least)
        canvas.legend(side, handles)
        what = f"{title}\n" if title else ""
        canvas.dress(ax, clock.label, ax.get_ylabel(), f"{what}{_verdict(errors, kind)}")
        ax.set_ylabel(f"{kind} error [{ax.get_ylabel()}]")
    if len(track.times) > 1:
        ax.set_xlim(*clock([track.times[0], track.times[-1]]))
    return figure


def _kind(errors: Errors, dims: int) -> str:
    if len(errors.axes) == dims:
        return "position"
    return "horizontal" if errors.axes == AXES[:2] else " and ".join(errors.axes)


def _verdict(errors: Errors, kind: str) -> str:
    inside = errors.distance <= errors.bound
    rmse = float(metrics.rmse(errors.position))
    return (
        f"{100.0 * np.mean(inside):.0f} % of {len(inside)} {kind} errors inside the "
        f"track's own 95 % bound; RMSE {Unit(rmse).text(rmse)}"
    )


def _bound(
    ax: Axes,
    clock: Clock,
    times: Array,
    bound: Array,
    distance: Array | None,
    least: tuple[Array, Array] | None,
) -> list[Any]:
    """Draw the bound as an area and the error on it; leave the unit as the y label."""
    known = np.concatenate([x for x in (bound, distance, least and least[1]) if x is not None])
    known = known[np.isfinite(known) & (known > 0.0)]
    quantiles = np.quantile(known, [0.01, 0.5, 1.0]) if len(known) else np.array([0.1, 1.0, 1.0])
    low, middle, high = (float(q) for q in quantiles)
    unit, when = Unit(high), clock(times)
    floor = 0.0
    if high > STEEP * middle:
        ax.set_yscale("log")
        canvas.plain_log(ax.yaxis)
        floor = 0.5 * float(low)
        ax.set_ylim(unit(floor), 1.6 * unit(high))
    else:
        ax.set_ylim(0.0, 1.08 * unit(high))
    area = ax.fill_between(
        when,
        np.full(len(when), unit(floor)),
        unit(np.maximum(bound, floor)),
        facecolor=canvas.TRACK,
        alpha=0.25,
        linewidth=0.0,
        label="the track's own 95 % bound",
    )
    ax.plot(when, unit(bound), color=canvas.TRACK, linewidth=1.0)
    below: list[Any] = []
    if least is not None:
        below = ax.plot(
            clock(least[0]),
            unit(least[1]),
            color=LEAST,
            linewidth=1.8,
            linestyle="--",
            zorder=4,
            label="least possible RMS error\n(Cramér-Rao)",
        )
    ax.set_ylabel(unit.name)
    if distance is None:
        ax.set_ylabel(f"95 % bound [{unit.name}]")
        return [area, *below]
    outside = distance > bound
    dots = "." if len(times) <= 100 else ""
    line = ax.plot(
        when, unit(distance), color=canvas.INK, linewidth=1.1, marker=dots, label="error"
    )
    beyond = ax.plot(
        when[outside],
        unit(distance[outside]),
        linestyle="",
        marker="o",
        color=OUTSIDE,
        markersize=3.5 if len(times) < 300 else 1.8,
        label="error outside the bound",
        zorder=5,
    )
    return [*line, *(beyond if np.any(outside) else []), area, *below]


def _consistency(ax: Axes, clock: Clock, track: Track) -> list[Any]:
    """Draw the normalised innovation squared over its 95 % limit."""
    dof = np.where(track.nis_dof > 0, track.nis_dof, 1)
    ratio = np.where(track.nis_dof > 0, track.nis / chi2.ppf(0.95, dof), np.nan)
    there = np.isfinite(ratio) & (ratio > 0.0)
    inside = there & (ratio <= 1.0)
    handles: list[Any] = []
    for rows, colour, word in (
        (inside, canvas.TRACK, "scan as foreseen"),
        (there & ~inside, OUTSIDE, "scan beyond the limit"),
    ):
        handles += ax.plot(
            clock(track.times[rows]),
            ratio[rows],
            linestyle="",
            marker="o",
            markersize=3.0,
            color=colour,
            label=word,
        )
    ax.axhline(1.0, color=canvas.INK, linewidth=1.0)
    ax.set_yscale("log")
    canvas.plain_log(ax.yaxis)
    if np.any(there):
        least, most = (float(q) for q in np.quantile(ratio[there], [0.005, 1.0]))
        ax.set_ylim(0.7 * least, 1.5 * max(most, 1.0))
    count = int(np.count_nonzero(there))
    share = 100.0 * int(np.count_nonzero(inside)) / max(count, 1)
    canvas.dress(
        ax,
        clock.label,
        "NIS / its 95 % limit [1]",
        f"{share:.0f} % of {count} scans as foreseen (95 % expected)",
    )
    return handles
