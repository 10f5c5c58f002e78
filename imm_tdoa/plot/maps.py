"""Pieces of a map: how large it is, and labels that keep clear of each other."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from imm_tdoa.contract import Array, Mask
from imm_tdoa.plot.canvas import HALO, INK, Unit


@attrs.frozen(eq=False)
class Box:
    """A rectangle of the map: corners `low` and `high` (2,), m."""

    low: Array
    high: Array

    @classmethod
    def of(cls, points: Array, least: float = 1.0) -> Box:
        """Return the box of all finite `points` (N, 2), at least `least` m across."""
        points = points[np.isfinite(points).all(axis=-1)]
        if not len(points):
            return cls(np.full(2, -least / 2), np.full(2, least / 2))
        low, high = points.min(axis=0), points.max(axis=0)
        short = np.maximum(0.2 * max(float(np.max(high - low)), least) - (high - low), 0.0)
        return cls(low - short / 2, high + short / 2)

    @classmethod
    def around(cls, points: Array, truth: Array | None = None, least: float = 1.0) -> Box:
        """Return the box of the truth (K, 2) and of `points` (N, 2), gross errors left out.

        Points count that lie no further from the box of the truth than it is wide; without
        truth, from the box of the middle 96 % of the points no further than twice its width.
        """
        points = points[np.isfinite(points).all(axis=-1)]
        if truth is not None and np.isfinite(truth).all(axis=-1).any():
            core = cls.of(truth, least)
            return core.joined(points[core.grown(1.0).holds(points)])
        if not len(points):
            return cls.of(points, least)
        core = cls.of(np.quantile(points, [0.02, 0.98], axis=0), least)
        return cls.of(points[core.grown(2.0).holds(points)], least)

    def grown(self, widths: float) -> Box:
        """Return the box with a margin of so many of its widths."""
        return Box(self.low - widths * self.width, self.high + widths * self.width)

    @property
    def width(self) -> float:
        """The longer side, m."""
        return float(np.max(self.high - self.low))

    def joined(self, points: Array) -> Box:
        """Return the box that holds all of `points` (N, 2) too."""
        points = points[np.isfinite(points).all(axis=-1)]
        return Box(
            np.minimum(self.low, points.min(axis=0, initial=np.inf)),
            np.maximum(self.high, points.max(axis=0, initial=-np.inf)),
        )

    def holds(self, points: Array) -> Mask:
        """Return which of `points` (..., 2) lie inside."""
        return np.asarray(np.all((points >= self.low) & (points <= self.high), axis=-1))


def settle(figure: Figure, maps: Sequence[tuple[Axes, Box, Unit]], margin: float = 0.08) -> None:
    """Make maps show their boxes, one metre east as long as one metre north.

    Axes keep their places and the maps grow to fill them, so everything that decides the layout
    must be there already. Tick labels follow the limits and take room of their own: twice is
    enough.
    """
    layout = figure.get_layout_engine()
    corners = []
    for _, box, unit in maps:
        edge = margin * box.width
        corners.append((unit(box.low - edge), unit(box.high + edge)))
    for _ in range(2):
        for (ax, *_), (low, high) in zip(maps, corners, strict=True):
            room = ax.get_window_extent()
            scale = max((high[0] - low[0]) / room.width, (high[1] - low[1]) / room.height)
            half = 0.5 * scale * np.array([room.width, room.height])
            middle = 0.5 * (low + high)
            ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
            ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
        if layout is not None:
            layout.execute(figure)
    for ax, *_ in maps:
        ax.set_aspect("equal", adjustable="box")


def name_points(
    figure: Figure,
    ax: Axes,
    points: Array,
    texts: Sequence[str],
    *,
    colour: str | Sequence[str] = INK,
    keep_clear: Array | None = None,
    taken: list[Bbox] | None = None,
) -> list[Bbox]:
    """Write a text beside each point where it covers nothing; leave out what finds no room.

    Parameters
    ----------
    figure, ax
        Where; the layout must be settled.
    points : (N, 2)
        What the texts belong to, in the axes' units.
    texts : sequence of str
        What to write.
    colour : str or sequence of str
        Colour of the texts, or of each.
    keep_clear : (M, 2), optional
        Points that texts should not cover, in the axes' units.
    taken : list of Bbox, optional
        Room that other texts take (pixels).

    Returns
    -------
    list of Bbox
        Room taken now.
    """
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    taken = list(taken or [])
    every = points if keep_clear is None else np.concatenate([points, keep_clear])
    pixels = ax.transData.transform(every[np.isfinite(every).all(axis=-1)])
    inks = [colour] * len(texts) if isinstance(colour, str) else colour
    for point, text, ink in zip(points, texts, inks, strict=True):
        if not np.all(np.isfinite(point)) or not ax.viewLim.contains(*point):
            continue
        best = None
        for dx, dy in ((7, 5), (-7, 5), (7, -5), (-7, -5), (0, 9), (0, -9), (14, 0), (-14, 0)):
            note = ax.annotate(
                text,
                point,
                xytext=(dx, dy),
                textcoords="offset points",
                ha="left" if dx > 0 else "right" if dx < 0 else "center",
                va="bottom" if dy > 0 else "top" if dy < 0 else "center",
                fontsize=8,
                color=ink,
                zorder=9,
                path_effects=HALO,
                in_layout=False,
            )
            box = note.get_window_extent(renderer)
            middle, half = np.array([box.x0 + box.x1, box.y0 + box.y1]) / 2, np.array(box.size) / 2
            inside = ax.bbox.contains(box.x0, box.y0) and ax.bbox.contains(box.x1, box.y1)
            if inside and not any(box.overlaps(other) for other in taken):
                covered = np.count_nonzero(np.all(np.abs(pixels - middle) <= half + 2.0, axis=-1))
                if best is None or covered < best[0]:
                    if best is not None:
                        best[1].remove()
                    best = (covered, note, box)
                    continue
            note.remove()
        if best is not None:
            taken.append(best[2])
    return taken
