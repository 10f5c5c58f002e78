"""A large map with its legend beside it: the ground of pictures of many targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imm_tdoa.contract import Array, Mask
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.plot.maps import Box, name_points, settle
from imm_tdoa.plot.receivers import Receivers
from imm_tdoa.stations import Stations

LABELLED = 12  # targets in a legend, and named at their ends; more would not be legible


def most(lines: Mapping[str, Array]) -> Array:
    """Return the points (N, 2) of the targets that are not far from where most of them are."""
    middle = np.array([np.nanmedian(line, axis=0) for line in lines.values()])
    core = Box.of(np.quantile(middle, [0.1, 0.9], axis=0))
    core = core.joined(np.concatenate([*(x for x in lines.values())])) if len(lines) < 5 else core
    near = core.grown(1.0).holds(middle)
    return np.concatenate([x for x, keep in zip(lines.values(), near, strict=True) if keep])


class Sheet:
    """A map with its legend beside it, large enough for `points` (N, 2) and stations near them."""

    def __init__(self, points: Array, stations: Stations | None, times: Array, title: str) -> None:
        self.points, self.box = points, Box.of(points)
        self.receivers = Receivers.during(stations, times)
        self.shown, self.far = self.receivers.fitted(self.box)
        self.unit = Unit(self.shown.width)
        self.figure = canvas.figure(11.0, 7.0)
        grid = self.figure.add_gridspec(1, 2, width_ratios=[3.4, 1.0])
        self.ax: Axes = self.figure.add_subplot(grid[0, 0])
        self.side: Axes = self.figure.add_subplot(grid[0, 1])
        canvas.dress(self.ax, f"x [{self.unit.name}]", f"y [{self.unit.name}]", title)

    def mark_ends(self, lines: list[Array]) -> list[Line2D]:
        """Mark where lines (T, 2) start and end."""
        size = 7 if len(lines) <= LABELLED else 4
        handles = []
        for row, marker, colour, word in (
            (0, "o", canvas.START, "start"),
            (-1, "s", canvas.INK, "end"),
        ):
            ends = np.array([line[row] for line in lines]).reshape(-1, 2)
            handles += self.ax.plot(
                *self.unit(ends.T),
                linestyle="",
                marker=marker,
                color=colour,
                markersize=size,
                markeredgecolor="white" if len(lines) <= LABELLED else colour,
                label=word,
                zorder=7,
            )
        return handles if lines else []

    def finished(
        self,
        handles: list[Any],
        lines: Mapping[str, Array],
        note: str,
        named: int = LABELLED,
        colours: Sequence[str] | None = None,
    ) -> Figure:
        """Add stations, legend and names, those of lines where there are at most so many."""
        stations = self.receivers.draw(self.ax, self.unit)
        self.side.axis("off")
        settle(self.figure, [(self.ax, self.shown, self.unit)])
        inside = self._in_view(self.receivers)
        handles += stations if np.any(inside) else []
        far = self.far.part(~self._in_view(self.far))
        if far.names:
            note += f"\n{far.far_away(self.box)}"
        canvas.legend(self.side, handles, note.strip())
        clear = self.unit(self.points[:: max(len(self.points) // 300, 1)])
        names, places = self.receivers.names, self.unit(self.receivers.places)
        taken = name_points(
            self.figure, self.ax, places, names, colour=canvas.STATION, keep_clear=clear
        )
        if 1 < len(lines) <= named:
            ends = self.unit(np.array([line[-1] for line in lines.values()]))
            name_points(
                self.figure,
                self.ax,
                ends,
                list(lines),
                colour=canvas.INK if colours is None else colours,
                keep_clear=clear,
                taken=taken,
            )
        return self.figure

    def _in_view(self, receivers: Receivers) -> Mask:
        """Return which stations (S,) the map shows, now that it has grown to fill its axes."""
        view = np.array([self.ax.get_xlim(), self.ax.get_ylim()]).T
        return np.asarray(Box(*view).holds(self.unit(receivers.places)), dtype=bool)
