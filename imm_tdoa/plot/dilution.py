"""A map of how well stations can locate: the geometric dilution of precision, and fixes on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from imm_tdoa import _validate, bounds
from imm_tdoa.contract import Array
from imm_tdoa.locate import Fix
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.plot.maps import Box, name_points, settle
from imm_tdoa.plot.receivers import Receivers
from imm_tdoa.stations import Stations

CELLS = 160  # of the map along its longer side
LEVELS = (1, 1.5, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 200, 300, 500, 1000, 3000, 10000)
WORST = 1000.0  # dilution from which on a place counts as not determined


def gdop(
    stations: Stations,
    fixes: Fix | Any = None,
    extent: Sequence[float] | None = None,
    *,
    truth: Any = None,
    height: float | None = None,
    time: float = 0.0,
    title: str = "",
    path: str | Path | None = None,
) -> Figure:
    """Draw the geometric dilution of precision (`bounds.gdop`), stations, and fixes.

    Parameters
    ----------
    stations : Stations
        The receivers; all of them count, also those that a fix did not have.
    fixes : Fix or (N, d), optional
        Fixes to mark, and their mirror solutions where a `Fix` has any.
    extent : (x from, x to, y from, y to), optional
        What to show, m; default the fixes and, where they fit, the stations.
    truth : (K, d), optional
        True positions to mark.
    height : float, optional
        z of the map for three dimensions, m; default the median of the fixes, else of the
        stations.
    time : float
        When, for moving stations, s.
    title : str
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
        Stations on a line, or an extent without area.
    """
    d = stations.dims
    if d == 1:
        raise ValueError("stations: a map needs 2 or 3 dimensions, got 1")
    points, mirror = _places(fixes, d)
    true = np.zeros((0, d)) if truth is None else np.asarray(truth, dtype=float).reshape(-1, d)
    receivers = Receivers.during(stations, np.array([time]))
    if extent is not None:
        left, right, bottom, top = (float(v) for v in _validate.array("extent", extent, (4,)))
        if right <= left or top <= bottom:
            raise ValueError(f"extent: expected (x from, x to, y from, y to), got {list(extent)}")
        box = shown = Box(np.array([left, bottom]), np.array([right, top]))
        far = receivers.part(~box.holds(receivers.places))
    else:
        box = _box(points, true, receivers)
        shown, far = receivers.fitted(box)
    unit = Unit(shown.width)
    figure = canvas.figure(11.0, 7.0)
    grid = figure.add_gridspec(2, 2, width_ratios=[3.4, 1.0], height_ratios=[1.0, 0.045])
    ax, side = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    scale = figure.add_subplot(grid[1, 0])
    handles: list[Any] = []
    if len(true):
        handles += ax.plot(
            *unit(true[:, :2].T),
            linestyle="",
            marker="o",
            color="white",
            markeredgecolor=canvas.INK,
            markeredgewidth=0.8 if len(true) <= 200 else 0.2,
            markersize=6 if len(true) <= 200 else 5,
            label="truth",
            zorder=4,
        )
    handles += _mark_fixes(ax, unit, points, mirror)
    drawn = receivers.draw(ax, unit)
    handles += drawn if np.any(shown.holds(receivers.places)) else []
    heard = int(np.count_nonzero(receivers.ever_heard))
    notes = [f"dilution with all {heard} stations: error of a fix over error of a range"]
    outside = int(np.count_nonzero(~shown.grown(0.08).holds(points[:, :2])))
    if outside:
        notes.append(f"{outside} of {len(points)} fixes lie outside the map")
    if far.names:
        notes.append(far.far_away(box))
    if d == 3:
        z = _level(points, receivers, height)
        notes.append(f"at z = {Unit(abs(z)).text(z)}, error of all three axes")
    canvas.legend(side, handles, "\n".join(notes))
    canvas.dress(ax, f"x [{unit.name}]", f"y [{unit.name}]", title)
    settle(figure, [(ax, shown, unit)])
    ax.grid(False)
    _dilution(figure, ax, scale, stations, unit, None if d == 2 else z, time)
    name_points(
        figure,
        ax,
        unit(receivers.places),
        receivers.names,
        colour=canvas.INK,
        keep_clear=unit(points[:: max(len(points) // 300, 1), :2]),
    )
    return canvas.finish(figure, path)


def _places(fixes: Any, d: int) -> tuple[Array, Array]:
    """Finite fixes (N, d) and mirror solutions (M, d)."""
    if fixes is None:
        return np.zeros((0, d)), np.zeros((0, d))
    points = fixes.position if isinstance(fixes, Fix) else fixes
    mirror = fixes.mirror if isinstance(fixes, Fix) else None
    points = _validate.array("fixes", points, (None, d), finite=False).reshape(-1, d)
    mirror = np.zeros((0, d)) if mirror is None else np.asarray(mirror).reshape(-1, d)
    return tuple(a[np.isfinite(a).all(axis=-1)] for a in (points, mirror))  # type: ignore[return-value]


def _box(points: Array, truth: Array, receivers: Receivers) -> Box:
    if not len(points) and not len(truth):
        every = Box.of(receivers.places)
        return every.grown(0.25)
    core = Box.around(points[:, :2], truth[:, :2] if len(truth) else None)
    return core


def _level(points: Array, receivers: Receivers, height: float | None) -> float:
    """The z of the map, m."""
    if height is not None:
        return float(height)
    return float(np.median(points[:, 2] if len(points) else receivers.paths[0, :, 2]))


def _mark_fixes(ax: Axes, unit: Unit, points: Array, mirror: Array) -> list[Any]:
    many = len(points) > 200
    handles: list[Any] = []
    for places, marker, colour, text in (
        (mirror, "x", canvas.MIRROR, "mirror solutions"),
        (points, "o", canvas.FIX, "fixes"),
    ):
        if len(places):
            handles += ax.plot(
                *unit(places[:, :2].T),
                linestyle="",
                marker=marker,
                markersize=3.5 if many else 6,
                color=colour,
                alpha=0.8,
                label=f"{text} ({len(places)})",
                zorder=5,
                markeredgecolor=colour if marker == "x" else "white",
                markeredgewidth=1.0 if marker == "x" else 0.4,
            )
    return handles[::-1]


def _dilution(
    figure: Figure,
    ax: Axes,
    scale: Axes,
    stations: Stations,
    unit: Unit,
    z: float | None,
    time: float,
) -> None:
    """Fill the map with colours and contour lines of equal dilution."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    step = max(right - left, top - bottom) / CELLS
    x = np.linspace(left, right, max(int((right - left) / step), 2))
    y = np.linspace(bottom, top, max(int((top - bottom) / step), 2))
    where = np.stack(np.meshgrid(x, y), axis=-1) / unit.factor
    if z is not None:
        where = np.concatenate([where, np.full((*where.shape[:-1], 1), z)], axis=-1)
    value = bounds.gdop(stations, where, time=time)
    value = np.ma.masked_greater(value, WORST)
    ax.set_facecolor("#D0D0D0")
    if value.count() == 0:
        scale.axis("off")
        ax.set_title(f"{ax.get_title(loc='left')}\nno position is determined here", loc="left")
        return
    low, high = float(value.min()), float(value.max())
    norm = LogNorm(0.98 * low, max(1.02 * high, 1.1 * low))
    shades = ax.pcolormesh(
        x, y, value, norm=norm, cmap="viridis_r", alpha=0.55, shading="nearest", zorder=0
    )
    levels = [level for level in LEVELS if low < level < high]
    if len(levels) >= 1:
        lines = ax.contour(x, y, value, levels=levels, colors=canvas.INK, linewidths=0.6, zorder=1)
        ax.clabel(lines, fmt="%g", fontsize=8)
    if high < 1.02 * low:
        scale.axis("off")
        scale.text(0.5, 0.0, f"dilution {low:.3g} all over this map", ha="center", fontsize=10)
        return
    bar = figure.colorbar(shades, cax=scale, orientation="horizontal")
    bar.set_label("geometric dilution of precision [1]; grey: no position determined")
    canvas.plain_log(bar.ax.xaxis)
