"""Comparing what a model gives with what a law demands, and saying where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.testing.laws import ViolationError

TOLERANCE = 1e-9  # of the magnitude of what is added up, some 1e6 roundings
ROUNDING = 1e-13  # of the largest entry: what a matrix routine leaves where a zero should be


def show(value: Any) -> str:
    """Return a number, an array or anything else in few characters."""
    if isinstance(value, np.ndarray) and value.ndim:
        return "[" + ", ".join(show(v) for v in value) + "]"
    if isinstance(value, float | np.floating | np.ndarray) and np.asarray(value).dtype.kind == "f":
        return f"{float(value):.6g}"
    return str(value)


def finite(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return `value` as a float array of this shape and finite, or raise `ViolationError`."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ViolationError(f"{name} is no array of numbers but {type(value).__name__}") from None
    if array.shape != shape:
        raise ViolationError(f"{name} has shape {array.shape}, expected {shape}")
    if not np.all(np.isfinite(array)):
        raise ViolationError(f"{name} is not finite: {show(array)}")
    return array


def agree(
    left_name: str,
    left: Any,
    right_name: str,
    right: Any,
    *,
    scale: Any = None,
    tolerance: float = TOLERANCE,
    slack: Any = 0.0,
    names: Sequence[str] = (),
) -> None:
    """Raise `ViolationError` unless both are the same to ``tolerance * scale + slack``.

    The slack includes the rounding of the largest entry.

    Parameters
    ----------
    left_name, right_name : str
        What the two are, for the message.
    left, right : array
        Of the same shape.
    scale : array, optional
        Magnitude of the terms behind each entry; default the larger of the two.
    tolerance : float
        Relative to `scale`.
    slack : array
        Absolute allowance, for what is only known approximately.
    names : sequence of str
        Names of the rows (and columns), for the message.
    """
    a, b = np.asarray(left, dtype=float), np.asarray(right, dtype=float)
    if a.shape != b.shape:
        raise ViolationError(f"{left_name} has shape {a.shape}, but {right_name} {b.shape}")
    size = np.maximum(np.abs(a), np.abs(b)) if scale is None else np.asarray(scale, dtype=float)
    with np.errstate(invalid="ignore"):
        gap = np.abs(a - b)
    rounding = ROUNDING * np.max(size, initial=0.0, where=np.isfinite(size))
    allowed = np.broadcast_to(tolerance * size + slack + rounding, gap.shape)
    wrong = ~(gap <= allowed) & ~((a == b) | (np.isnan(a) & np.isnan(b)))
    if not np.any(wrong):
        return
    size = np.broadcast_to(size, gap.shape)
    with np.errstate(all="ignore"):
        relative = np.where(wrong, gap / np.where(size > 0.0, size, 1.0), -1.0)
    worst = np.unravel_index(
        int(np.argmax(np.where(np.isnan(relative), np.inf, relative))), a.shape
    )
    count = int(np.count_nonzero(wrong))
    more = f"; {count} entries differ, this one most" if count > 1 else ""
    raise ViolationError(
        f"{left_name}{_place(worst, names)} is {show(a[worst])}, "
        f"but {right_name}{_place(worst, names)} is {show(b[worst])} "
        f"(they differ by {show(gap[worst])}{more})"
    )


def _place(index: tuple[Any, ...], names: Sequence[str]) -> str:
    if not index:
        return ""
    last = [names[i] if len(names) > i else str(int(i)) for i in index[-2:]]
    return "[" + ", ".join([*(str(int(i)) for i in index[:-2]), *last]) + "]"
