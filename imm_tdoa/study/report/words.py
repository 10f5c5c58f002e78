"""Figures as words: numbers with their units, percentages, lists."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import xarray as xr

from imm_tdoa.study.sweep import SHORT

UNIT = {"position": "m", "velocity": "m/s"}


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many digits that count, `-` where there is none."""
    if not math.isfinite(value):
        return "-"
    if value != 0.0 and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    places = max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0
    text = f"{value:.{places}f}"
    if value and places and abs(float(text)) >= 10.0 ** (digits - places):
        text = f"{value:.{places - 1}f}"  # 9.996 has become 10.00
    return text


def length(value: float, unit: str) -> str:
    """Return a figure with its unit, thousands of metres as kilometres."""
    if unit.startswith("m") and abs(value) >= 1e4:
        return f"{number(value / 1e3)} k{unit}"
    return f"{number(value)} {unit}"


def measured(value: float, low: float, high: float, unit: str = "") -> tuple[str, str]:
    """Return a figure and its interval as text, to two digits of what is uncertain.

    The unit is written once to each; thousands of metres become kilometres.
    """
    if unit.startswith("m") and abs(value) >= 1e4:
        unit = f"k{unit}"
        value, low, high = value / 1e3, low / 1e3, high / 1e3
    tail = f" {unit}" if unit else ""
    half = 0.5 * (high - low)
    if not (math.isfinite(half) and math.isfinite(value)):
        return f"{number(value)}{tail}", "-"
    if not half > 1e-9 * abs(value):
        return f"{number(value)}{tail}", f"{number(low)} to {number(high)}{tail}"
    places = 1 - math.floor(math.log10(half))
    if places > 6 or abs(value) >= 1e7:
        return f"{number(value)}{tail}", f"{number(low)} to {number(high)}{tail}"
    places = max(places, 0)
    return f"{value:.{places}f}{tail}", f"{low:.{places}f} to {high:.{places}f}{tail}"


def percent(share: float) -> str:
    """Return a share as per cent; a digit after the point below ten."""
    value = 100.0 * share
    if not math.isfinite(value):
        return "-"
    near_an_end = 0.0 < abs(value) < 9.95 or 99.0 < value < 100.0
    return f"{value:.1f} %" if near_an_end else f"{value:.0f} %"


def seconds(value: float) -> str:
    """Return a duration in the unit that reads best."""
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if abs(value) * factor >= 1.0:
            return f"{number(value * factor)} {unit}"
    return f"{number(value * 1e9)} ns"


def p_value(p: float) -> str:
    """Return a p-value."""
    return f"p = {p:.2g}" if p >= 1e-3 else "p < 0.001"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names as a list in words."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def some(names: Sequence[str], most: int = 4) -> str:
    """Return names as a list in words, of long ones only the beginning."""
    if len(names) <= most:
        return listed(names)
    return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} others"


def count(n: int, word: str) -> str:
    """Return how many there are of something."""
    return f"{n} {word}" if n == 1 else f"{n} {word}s"


def figure(data: xr.Dataset, name: str, *at: int) -> tuple[float, float, float]:
    """Return a figure of the Dataset with the ends of its interval."""
    return tuple(float(data[name + end].values[at]) for end in ("", "_low", "_high"))  # type: ignore[return-value]


def has(data: xr.Dataset, name: str, *at: int) -> bool:
    """Whether the Dataset knows a figure there."""
    return name in data and bool(math.isfinite(float(data[name].values[at])))


def scenario(data: xr.Dataset, i: int) -> str:
    """Return what a scenario is called in a sentence or a heading: its point alone where it can."""
    name, base = str(data["scenario"].values[i]), str(data["base"].values[i])
    if len(set(data["base"].values.tolist())) > 1:
        return name
    return name.removeprefix(base).strip() or name


def quantity(key: str) -> str:
    """Return what a swept parameter is called, without its unit: ``toa sigma``."""
    return re.sub(r"_(s|m|mps|mps2|hz|rad)$", "", key).replace("_", " ")


def axis(key: str) -> str:
    """Return a swept parameter as the label of an axis: ``toa sigma [ns]``."""
    unit = SHORT.get(key, ("", 1.0, ""))[2].strip()
    return f"{quantity(key)} [{unit}]" if unit else quantity(key)


def scale(key: str) -> float:
    """Return the factor from a parameter's value to what axes and sentences show."""
    return SHORT.get(key, ("", 1.0, ""))[1]


def plain(key: str, value: float) -> str:
    """Return the value of a swept parameter as an axis shows it, without its unit."""
    return f"{value * scale(key):.6g}"


def amount(key: str, value: float) -> str:
    """Return the value of a swept parameter with its unit: ``70 ns``."""
    return f"{plain(key, value)}{SHORT.get(key, ('', 1.0, ''))[2]}"


def strings(values: Any) -> list[str]:
    """Return an array of names as a list."""
    return [str(value) for value in values]
