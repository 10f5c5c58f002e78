"""What the pictures of a study share: width, colours, and the bytes they end in."""

from __future__ import annotations

import io
import struct
import textwrap
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.study.report.words import strings

WIDTH = 5.8  # inches: text of 10 points stays readable on a telephone
DPI = 190
# Okabe & Ito's palette, what is hard to see as a line on white last
BANKS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222", "#9A9A9A")
STYLES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
MARKS = "osD^vPX*"
MOST = 8  # banks in one picture of lines
SPREAD = 30.0  # a range this wide wants a logarithmic axis


@attrs.frozen
class Picture:
    """A finished picture.

    Attributes
    ----------
    name : str
        Of its file, without ending.
    scenario : int or None
        Which one it is about; None for the whole study.
    title, caption : str
        What it shows, and how to read it.
    alt : str
        What it says, in words, for those who do not see it.
    png : bytes
        The picture.
    size : tuple of int
        Width and height, pixels.
    """

    name: str
    scenario: int | None
    title: str
    caption: str
    alt: str
    png: bytes = attrs.field(repr=False)
    size: tuple[int, int]


def finish(
    figure: Figure, name: str, title: str, caption: str, alt: str, scenario: int | None = None
) -> Picture:
    """Return a figure as a picture."""
    heading = figure.suptitle(
        textwrap.fill(title, 68), x=0.015, ha="left", fontsize=10.5, color=canvas.INK
    )
    heading.set_linespacing(1.1)
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(w_pad=0.09, h_pad=0.07)
    store = io.BytesIO()
    figure.savefig(store, dpi=DPI, format="png", facecolor="white")
    png = store.getvalue()
    width, height = struct.unpack(">II", png[16:24])  # of its header
    return Picture(name, scenario, title, caption, alt, png, (width, height))


def look(b: int) -> dict[str, Any]:
    """Return colour and line of bank number `b`, the same in every picture."""
    return {
        "color": BANKS[b % len(BANKS)],
        "linestyle": STYLES[b // len(BANKS) % len(STYLES)],
    }


def colour(b: int) -> str:
    """Return the colour of bank number `b`."""
    return BANKS[b % len(BANKS)]


def mark(b: int) -> str:
    """Return the marker of bank number `b`."""
    return MARKS[b % len(MARKS)]


def legend(figure: Figure, handles: Sequence[Any]) -> None:
    """Put the legend beneath the picture, in as many columns as fit."""
    longest = max((len(str(handle.get_label())) for handle in handles), default=1)
    columns = max(1, min(len(handles), 3, int(70 / (longest + 6))))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=columns,
        frameon=False,
        fontsize=9.5,
        labelcolor=canvas.INK,
        handlelength=2.2,
        columnspacing=1.4,
    )


def rows(handles: Sequence[Any]) -> float:
    """Return how many inches a legend takes."""
    longest = max((len(str(handle.get_label())) for handle in handles), default=1)
    columns = max(1, min(len(handles), 3, int(70 / (longest + 6))))
    return 0.2 * -(-len(handles) // columns) + 0.15


def scaled(axis: Axis, values: Array) -> None:
    """Make an axis of positive figures logarithmic where they spread far."""
    known = values[np.isfinite(values) & (values > 0.0)]
    if len(known) and known.max() > SPREAD * known.min():
        if axis is axis.axes.yaxis:
            axis.axes.set_yscale("log")
        else:
            axis.axes.set_xscale("log")
        canvas.plain_log(axis)


def dress(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Name axes as the house does, in a size for narrow pictures."""
    canvas.dress(ax, x, y, title, size=10)
    ax.tick_params(labelsize=9)


def picked(order: Sequence[int], most: int = MOST) -> list[int]:
    """Return which of the banks, best first, a picture has room for: the first and the last."""
    few = list(order) if len(order) <= most else [*order[: most - 1], order[-1]]
    return sorted(few)


def left_out(order: Sequence[int], shown: Sequence[int]) -> str:
    """Say that some banks are not in a picture; nothing where all are."""
    missing = len(order) - len(shown)
    return f" Shown are the best and the last; {missing} between are left out." if missing else ""


def banks(data: xr.Dataset) -> list[str]:
    """Return the names of the banks."""
    return strings(data["bank"].values)


def file_name(text: str) -> str:
    """Return a name as part of a file's name."""
    kept = "".join(c if c.isalnum() or c in "-+." else "_" for c in text).strip("._")
    return kept or "study"
