"""What all pictures share: colours, units, the file they end in."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from imm_tdoa.contract import Array
from imm_tdoa.recording import _atomic

# Okabe & Ito's palette: told apart by every kind of colour vision.
TRACK = "#0072B2"
TRUTH = "#9A9A9A"
STATION = "#D55E00"
START = "#009E73"
INK = "#222222"
FIX = "#0072B2"
MIRROR = "#CC79A7"
MODES = ("#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#F0E442", "#0072B2", "#D55E00", "#9A9A9A")
HALO = (withStroke(linewidth=2.5, foreground="white"),)
DPI = 130


class Unit:
    """Metres or kilometres, whichever reads better for lengths up to `extent` m."""

    def __init__(self, extent: float) -> None:
        self.name, self.factor = ("km", 1e-3) if extent >= 5000.0 else ("m", 1.0)

    def __call__(self, length: Any) -> Any:
        """Return a length in m in this unit."""
        return np.asarray(length) * self.factor

    def text(self, length: float) -> str:
        """Return a length in m as text with its unit."""
        return f"{float(f'{length * self.factor:.3g}'):.12g} {self.name}"


class Clock:
    """Seconds as they are, or after the first where they count from long before."""

    def __init__(self, times: Array) -> None:
        first, last = (float(t) for t in (np.nanmin(times), np.nanmax(times)))
        self.zero = first if first > 10.0 * max(last - first, 1.0) else 0.0
        self.label = f"time after {self.zero:.10g} s [s]" if self.zero else "time [s]"

    def __call__(self, times: Any) -> Any:
        """Return times in s on this clock."""
        return np.asarray(times) - self.zero


def plain_log(axis: Axis) -> None:
    """Make a logarithmic axis show plain numbers, more of them where there are few decades."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=9))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def figure(width: float, height: float) -> Figure:
    """Return an empty figure of `width` by `height` inches that lays itself out."""
    result = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(result)
    return result


def dress(ax: Axes, x: str, y: str, title: str = "", size: int = 11) -> None:
    """Name the axes and draw a light grid."""
    ax.set_xlabel(x, color=INK)
    ax.set_ylabel(y, color=INK)
    if title:
        ax.set_title(title, loc="left", fontsize=size, color=INK)
    ax.grid(True, color="#E3E3E3", linewidth=0.7)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def legend(ax: Axes, handles: Sequence[Any], note: str = "") -> None:
    """Fill axes beside a picture with its legend, and what else there is to say beneath."""
    ax.axis("off")
    if note:
        lines = (textwrap.fill(line, 27) for line in note.splitlines())
        handles = [*handles, *(Line2D([], [], linestyle="", label=line) for line in lines)]
    box = ax.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(-0.05, 1.02),
        frameon=False,
        fontsize=9,
        borderaxespad=0.0,
        labelcolor=INK,
        labelspacing=0.7,
    )
    box.set_in_layout(False)  # its column is wide enough; it must not squeeze the picture


def finish(figure: Figure, path: str | Path | None) -> Figure:
    """Write the figure to `path` where one is given, all at once, and return it."""
    if path is None:
        return figure
    with _atomic.file(Path(path)) as draft:
        kind = draft.suffix[1:] or "png"
        figure.savefig(draft, dpi=DPI, format=kind, facecolor="white")
    return figure
