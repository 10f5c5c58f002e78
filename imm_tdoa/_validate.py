"""Checks at the door: arguments become read-only float arrays, or an error that names them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imm_tdoa.contract import Array

SMALL = 10_000  # numbers, of which a mask takes no memory worth sparing


def array(
    name: str,
    value: Any,
    shape: Sequence[int | str | None] | None = None,
    *,
    finite: bool = True,
    copy: bool = True,
) -> Array:
    """Return `value` as a read-only float array, or raise a ValueError that names it.

    Parameters
    ----------
    name : str
        What the caller calls the argument.
    value : array-like
        Numbers.
    shape : sequence, optional
        Expected trailing axes: an int fixes a length, a letter leaves it open and names it in
        the message. ``None`` as the first entry allows any leading batch axes.
    finite : bool
        Refuse NaN and infinity; when False only infinity is refused (NaN means missing).
    copy : bool
        Copy what is an array of floats already; without, large data is not kept twice.
    """
    try:
        result = np.array(value, dtype=float) if copy else np.asarray(value, dtype=float).view()
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected numbers, got {value!r}") from error
    if shape is not None:
        batch = len(shape) > 0 and shape[0] is None
        wanted = list(shape[1:] if batch else shape)
        got = result.shape[result.ndim - len(wanted) :] if batch else result.shape
        fits = len(got) == len(wanted)
        for want, there in zip(wanted, got, strict=False):
            fits = fits and (want == there or not isinstance(want, int))
        if not fits or (batch and result.ndim < len(wanted)):
            text = ", ".join(str(w) for w in wanted) + ("," if len(wanted) == 1 else "")
            text = f"({'..., ' if batch else ''}{text})"
            raise ValueError(f"{name}: expected shape {text}, got {result.shape}")
    if finite and not np.isfinite(result).all():
        raise ValueError(f"{name}: expected finite numbers, {_first_bad(~np.isfinite(result))}")
    if not finite and result.size and _infinite(result):
        raise ValueError(
            f"{name}: infinite values are refused (NaN marks a missing value), "
            f"{_first_bad(np.isinf(result))}"
        )
    result.setflags(write=False)
    return result


def _infinite(a: Array) -> bool:
    """Whether any number is infinite; no array as large as a large `a` is made to find out."""
    if a.size < SMALL:
        return bool(np.isinf(a).any())
    return bool(np.isinf(np.fmax.reduce(a, axis=None)) or np.isinf(np.fmin.reduce(a, axis=None)))


def _first_bad(bad: np.ndarray[Any, np.dtype[np.bool_]]) -> str:
    if bad.ndim == 0:
        return "this one is not"
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    return f"the one at index {index if len(index) > 1 else index[0]} is not"


def non_negative(name: str, value: float) -> float:
    """Return `value` as a float at least zero and finite, or raise."""
    number = _number(name, value)
    if number < 0.0:
        raise ValueError(f"{name}: expected a number of at least 0, got {value!r}")
    return number


def positive(name: str, value: float) -> float:
    """Return `value` as a float above zero and finite, or raise."""
    number = _number(name, value)
    if number <= 0.0:
        raise ValueError(f"{name}: expected a number above 0, got {value!r}")
    return number


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool | str) or np.ndim(value) != 0:
        raise ValueError(f"{name}: expected one number, got {value!r}")
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected one number, got {value!r}") from error
    if not np.isfinite(number):
        raise ValueError(f"{name}: expected a finite number, got {value!r}")
    return number


def time_step(dt: float | Array) -> Array:
    """Return `dt` (s) as an array, refusing negative and non-finite steps."""
    step = np.asarray(dt, dtype=float)
    if not np.all(step >= 0.0) or not np.all(np.isfinite(step)):
        raise ValueError(f"dt: expected a finite time step of at least 0 s, got {dt!r}")
    return step


def dimensions(dims: int) -> int:
    """Return the number of space dimensions, refusing anything but 1, 2 and 3."""
    if isinstance(dims, bool) or dims not in (1, 2, 3):
        raise ValueError(f"dims: expected 1, 2 or 3 space dimensions, got {dims!r}")
    return int(dims)


def covariance(name: str, value: Any, n: int) -> Array:
    """Return (..., n, n) symmetric positive semi-definite covariances, or raise."""
    P = array(name, value, (None, n, n))
    scale = np.sqrt(np.abs(np.einsum("...ii->...i", P)))
    bound = 1e-9 * scale[..., :, None] * scale[..., None, :] + 1e-300
    if np.any(np.abs(P - np.swapaxes(P, -1, -2)) > bound):
        raise ValueError(f"{name}: expected a symmetric matrix")
    if np.any(np.einsum("...ii->...i", P) < 0.0):
        raise ValueError(f"{name}: a variance on its diagonal is negative")
    unit = np.where(scale > 0.0, scale, 1.0)
    correlation = P / (unit[..., :, None] * unit[..., None, :])
    if np.any(np.linalg.eigvalsh(correlation) < -1e-9 * n):
        raise ValueError(f"{name}: expected a positive semi-definite matrix")
    return P


def one_of(name: str, value: Any, choices: Sequence[Any]) -> None:
    """Raise a ValueError that lists the choices unless `value` is one of them."""
    if value not in choices:
        shown = ", ".join(repr(choice) for choice in choices)
        raise ValueError(f"{name}: expected one of {shown}, got {value!r}")


def fitting(**shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return what the batch axes of the named arguments broadcast to, or raise."""
    first, *others = shapes.values()
    if all(shape == first for shape in others):
        return first
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        text = ", ".join(f"{name.replace('_', ' ')} {shape}" for name, shape in shapes.items())
        raise ValueError(f"batch axes do not fit together: {text}") from None


def refuse_backwards(name: str, of: str, before: Array, after: Array) -> None:
    """Raise if a time `after` (...) lies before the time `before` (...)."""
    back = np.asarray(after < before)
    if back.any():
        before, after = np.broadcast_arrays(before, after)
        raise ValueError(
            f"{name}: expected a time at or after the {of}'s, {before[back][0]:g} s, "
            f"got {after[back][0]:g} s"
        )
