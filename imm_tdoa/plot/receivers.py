"""The stations on a map: which of them fit on it, and a small map of them all."""

from __future__ import annotations

import attrs
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from imm_tdoa.contract import Array, Mask
from imm_tdoa.plot.canvas import STATION, TRACK, Unit, dress
from imm_tdoa.plot.maps import Box
from imm_tdoa.stations import Stations

OVERVIEW = 300.0  # stations further off than this many track widths are not drawn at all


@attrs.frozen(eq=False)
class Receivers:
    """Where stations were during some times: names, and paths (K, S, d), m, NaN where unheard."""

    names: tuple[str, ...]
    paths: Array

    @classmethod
    def during(cls, stations: Stations | None, times: Array) -> Receivers:
        """Sample the stations at up to 60 of `times` (T,) s."""
        if stations is None:
            return cls((), np.zeros((1, 0, 2)))
        some = np.asarray(times)[np.unique(np.linspace(0, len(times) - 1, 60).astype(int))]
        where = stations.at(some if stations.moving else some[:1])[0]
        return cls(stations.names, where.reshape(-1, len(stations), stations.dims))

    def part(self, which: Mask) -> Receivers:
        """Return some of them (S,)."""
        names = tuple(n for n, keep in zip(self.names, which, strict=True) if keep)
        return Receivers(names, self.paths[:, which])

    def fitted(self, box: Box, share: float = 0.25) -> tuple[Box, Receivers]:
        """Return the box of a map, and those that are not on it.

        All of them are on the map where `box`, that of the tracks, keeps this `share` of its
        width; else the map is that of the tracks alone.
        """
        heard = self.part(self.ever_heard)
        grown = box.joined(heard.paths[..., :2].reshape(-1, 2))
        if grown.width <= box.width / share:
            return grown, self.part(np.zeros(len(self.names), dtype=bool))
        return box, heard.part(~box.holds(heard.places))

    @property
    def ever_heard(self) -> Mask:
        """Which of them (S,) were anywhere."""
        return np.asarray(np.isfinite(self.paths).all(axis=-1).any(axis=0))

    @property
    def places(self) -> Array:
        """Where on the map each was first (S, 2), m."""
        return self._first[:, :2]

    @property
    def _first(self) -> Array:
        first = np.argmax(np.isfinite(self.paths).all(axis=-1), axis=0)
        return np.asarray(self.paths[first, np.arange(len(self.names))])

    def distances(self, box: Box) -> Array:
        """Distance (S,) of each from the middle of the box, on the ground (z = 0), m."""
        middle = np.zeros(self.paths.shape[-1])
        middle[:2] = 0.5 * (box.low + box.high)
        return np.asarray(np.linalg.norm(self._first - middle, axis=-1))

    def draw(self, ax: Axes, unit: Unit, size: float = 9.0) -> list[Line2D]:
        """Mark the stations and return what the legend says of them."""
        if not self.names:
            return []
        for path in np.moveaxis(self.paths, 1, 0):
            if len(path) > 1:
                ax.plot(*unit(path[:, :2].T), color=STATION, linewidth=1.0, alpha=0.7)
        text = "stations" if len(self.names) > 1 else "station"
        return ax.plot(
            *unit(self.places.T),
            linestyle="",
            marker="^",
            markersize=size,
            color=STATION,
            markeredgecolor="white",
            label=text,
            zorder=6,
        )

    def far_away(self, box: Box) -> str:
        """Say that they are not on the map, and how far off they are."""
        distance = self.distances(box)
        unit = Unit(float(distance.max()))
        low, high = (f"{float(f'{unit(d):.3g}'):,.0f}" for d in (distance.min(), distance.max()))
        count = f"{len(self.names)} stations" if len(self.names) > 1 else "1 station"
        reach = low if low == high else f"{low} to {high}"
        return f"{count} not shown: {reach} {unit.name} away".replace(",", "\u202f")


def overview(ax: Axes, shown: Box, every: Receivers) -> tuple[Box, Unit]:
    """Draw a small map of all stations, the large map's frame on it; return what it shows."""
    box = shown.joined(every.places)
    unit = Unit(box.width)
    every.draw(ax, unit, size=5.0)
    corner, size = unit(shown.low), unit(shown.high - shown.low)
    ax.add_patch(Rectangle(tuple(corner), *size, fill=False, edgecolor=TRACK, linewidth=1.5))
    if np.max(size) < 0.04 * unit(box.width):
        ax.plot(*(corner + 0.5 * size), "s", color=TRACK, markersize=5)
    dress(ax, f"x [{unit.name}]", f"y [{unit.name}]", "all stations", size=9)
    ax.tick_params(labelsize=7)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(4))
    for text in (ax.xaxis.label, ax.yaxis.label):
        text.set_fontsize(8)
    return box.grown(0.1), unit
