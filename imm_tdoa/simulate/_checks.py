"""Validators of attrs fields: messages start with the field's name and say what was expected."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping
from typing import Any

import attrs

Vector = tuple[float, ...]


def vector(value: Any) -> Any:
    """Convert numbers in a list or array to a tuple of floats; leave the rest to `is_vector`."""
    if value is None or isinstance(value, str):
        return value
    try:
        return tuple(float(v) for v in value)
    except (TypeError, ValueError):
        return value


def sequence(value: Any) -> Any:
    """Convert a sequence to a tuple; leave the rest to `all_are`."""
    return tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else value


def all_are(kind: type) -> Any:
    """Accept a sequence of instances of `kind`."""

    def check(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
        if not isinstance(value, tuple):
            raise ValueError(f"{field.name}: expected a sequence, got {value!r}")
        for i, item in enumerate(value):
            if not isinstance(item, kind):
                raise ValueError(f"{field.name}[{i}]: expected a {kind.__name__}, got {item!r}")

    return check


def is_a(kind: type) -> Any:
    """Accept an instance of `kind`, or None where that is the default."""

    def check(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
        if not isinstance(value, kind) and not (value is None and field.default is None):
            raise ValueError(f"{field.name}: expected a {kind.__name__}, got {value!r}")

    return check


def is_vector(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept one, two or three finite numbers, or None where that is the default."""
    if value is None and field.default is None:
        return
    if not isinstance(value, tuple) or not all(_is_number(v) for v in value):
        raise ValueError(f"{field.name}: expected a list of finite numbers, got {value!r}")


def above_zero(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a number above 0, or None where that is the default."""
    if value is None and field.default is None:
        return
    _number(field.name, value)
    if not value > 0.0:
        raise ValueError(f"{field.name}: expected a number above 0, got {value:g}")


def at_least_zero(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a number of at least 0."""
    _number(field.name, value)
    if not value >= 0.0:
        raise ValueError(f"{field.name}: expected a number of at least 0, got {value:g}")


def finite(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a finite number, or None where that is the default."""
    if value is not None or field.default is not None:
        _number(field.name, value)


def whole(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a whole number of at least 0."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{field.name}: expected a whole number of at least 0, got {value!r}")


def probability(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a number from 0 to 1."""
    _probability(field.name, value)


def probabilities(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a mapping from names to numbers from 0 to 1."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{field.name}: expected probabilities by {field.name}, got {value!r}")
    for name, p in value.items():
        _probability(f"{field.name}.{name}", p)


def rates(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept a mapping from names to numbers of at least 0."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{field.name}: expected rates by station, got {value!r}")
    for name, rate in value.items():
        _number(f"{field.name}.{name}", rate)
        if rate < 0.0:
            raise ValueError(f"{field.name}.{name}: expected a number of at least 0, got {rate:g}")


def is_interval(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept ``[low, high]`` with low < high, or None where that is the default."""
    if value is None and field.default is None:
        return
    _two(field.name, value)
    if not value[0] < value[1]:
        raise ValueError(f"{field.name}: expected [low, high] with low < high, got {list(value)}")


def is_range(of_low: Any = None) -> Any:
    """Accept ``[low, high]`` with low <= high; `of_low` checks low alone."""

    def check(owner: Any, field: attrs.Attribute[Any], value: Any) -> None:
        _two(field.name, value)
        if not value[0] <= value[1]:
            raise ValueError(
                f"{field.name}: expected [low, high] with low at most high, got {list(value)}"
            )
        if of_low is not None:
            of_low(owner, field.evolve(name=f"{field.name}[0]"), value[0])

    return check


def name(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
    """Accept text that is not empty and fits in a cell of a table."""
    if not isinstance(value, str) or value != value.strip() or not value.isprintable() or not value:
        raise ValueError(
            f"{field.name}: expected a name of printable characters, not empty and without "
            f"spaces around it, got {value!r}"
        )


def one_of(*choices: Any) -> Any:
    """Accept one of `choices`."""

    def check(_: Any, field: attrs.Attribute[Any], value: Any) -> None:
        if value not in choices or isinstance(value, bool):
            listed = ", ".join(repr(c) for c in choices)
            raise ValueError(f"{field.name}: expected one of {listed}, got {value!r}")

    return check


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    return math.isfinite(float(value))


def _number(name: str, value: Any) -> None:
    if not _is_number(value):
        raise ValueError(f"{name}: expected a finite number, got {value!r}")


def _two(name: str, value: Any) -> None:
    if not isinstance(value, tuple) or len(value) != 2 or not all(_is_number(v) for v in value):
        got = list(value) if isinstance(value, tuple) else value
        raise ValueError(f"{name}: expected two finite numbers [low, high], got {got!r}")


def _probability(name: str, value: Any) -> None:
    _number(name, value)
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name}: expected a probability from 0 to 1, got {value:g}")
