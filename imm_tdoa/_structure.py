"""TOML to frozen attrs classes: every fault with its exact place, nothing silently coerced."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

import attrs
from cattrs import BaseConverter, BaseValidationError, Converter, ForbiddenExtraKeysError
from cattrs.errors import (
    ClassValidationError,
    IterableValidationError,
    IterableValidationNote,
)
from cattrs.gen import make_dict_structure_fn

T = TypeVar("T")

_TOML_PLACE = re.compile(r"^(.*) \(at (?:line (\d+), column (\d+)|(end of document))\)$")
_OWN_PLACE = re.compile(r"[a-z]\w*(\[\d+\]|\.\w+)*: ")
_MANY = {float: "numbers", int: "whole numbers", str: "texts in quotes"}


def read(path: Path) -> str:
    """Return the text of a file, or raise ``file:line: what`` where it is no UTF-8."""
    try:
        return path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise ValueError(f"{path.name}:{line}: expected UTF-8 text: {error.reason}") from error


def parse(text: str, file: str) -> dict[str, Any]:
    """Return the tables of TOML `text`, or raise ``file:line:column: what``."""
    try:
        return tomllib.loads(text)
    except ValueError as error:
        found = _TOML_PLACE.match(str(error))
        if found is None:
            raise ValueError(f"{file}: {error}") from error
        what, line, column, end = found.groups()
        if end:
            line = text.rstrip().count("\n") + 1
            raise ValueError(f"{file}:{line}: {what} (at the end of the file)") from error
        raise ValueError(f"{file}:{line}:{column}: {what}") from error


def structure(table: Mapping[str, Any], cls: type[T], file: str) -> T:
    """Return `cls` made of `table`.

    Parameters
    ----------
    table : mapping
        What TOML holds: tables, lists, text, numbers, booleans.
    cls : type
        A frozen attrs class; its validators start their messages with the field's name.
    file : str
        What messages call the table.

    Raises
    ------
    ValueError
        An unknown or missing key, a value of the wrong kind, or one that a validator refused,
        with its place: ``file: targets[0].legs[1].duration_s: expected a number above 0, got -3``.
    """
    try:
        return _CONVERTER.structure(table, cls)
    except BaseValidationError as error:
        raise ValueError(f"{file}: {_first_fault(error)}") from error


def near(word: str, words: Iterable[str]) -> str:
    """Return a hint at the one of `words` that looks like `word`, or nothing."""
    found = difflib.get_close_matches(word, list(words), n=1)
    return f" (did you mean {found[0]!r}?)" if found else ""


def _first_fault(error: BaseException, place: str = "") -> str:
    """Return the first thing wrong, with its place below `place`."""
    if isinstance(error, IterableValidationError | ClassValidationError):
        noted, plain = error.group_exceptions()
        if plain:  # the class as a whole: unknown keys and what its own validators refused
            first = plain[0]
            return _first_fault(first, place) if _structural(first) else _join(place, first)
        inner, note = noted[0]
        return _first_fault(inner, place + _step(error, note, place))
    if isinstance(error, ForbiddenExtraKeysError):
        key = min(error.extra_fields)
        known = [a.name for a in attrs.fields(error.cl)]
        dot = "." if place else ""
        return f"{place}{dot}{key}: unknown key{near(key, known)}; there are: {', '.join(known)}"
    if isinstance(error, KeyError):
        return f"{place}: missing"
    return f"{place}: {error}"


def _structural(error: BaseException) -> bool:
    return isinstance(error, BaseValidationError | ForbiddenExtraKeysError)


def _step(error: BaseValidationError, note: Any, place: str) -> str:
    if isinstance(error, ClassValidationError):
        return f".{note.name}" if place else str(note.name)
    return f"[{note.index}]" if isinstance(note.index, int) else f".{note.index}"


def _join(place: str, error: BaseException) -> str:
    """Put `place` before a message that may begin with a place of its own."""
    if not place:
        return str(error)
    return f"{place}{'.' if _OWN_PLACE.match(str(error)) else ': '}{error}"


def _number(value: Any, _: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"expected a number, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {value!r}")
    return float(value)


def _whole(value: Any, _: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"expected a whole number, got {value!r}")
    return value


def _truth(value: Any, _: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"expected true or false, got {value!r}")
    return value


def _text(value: Any, _: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expected text in quotes, got {value!r}")
    return value


def _a_list(wanted: Any, converter: BaseConverter) -> Callable[[Any, Any], Any]:
    item_type = get_args(wanted)[0]
    item = converter.get_structure_hook(item_type)

    def hook(value: Any, _: Any) -> Any:
        if not isinstance(value, list):
            raise ValueError(f"expected {_list_of(item_type)}, got {value!r}")
        return tuple(_each(enumerate(value), item, item_type))

    return hook


def _list_of(item: Any) -> str:
    if attrs.has(item) or get_origin(item) is Mapping:
        return "tables in double brackets"
    if get_origin(item) is tuple:
        return f"a list of lists of {_MANY.get(get_args(item)[0], 'values')}"
    return f"a list of {_MANY.get(item, 'values')}"


def _a_mapping(wanted: Any, converter: BaseConverter) -> Callable[[Any, Any], Any]:
    item_type = get_args(wanted)[1]
    item = converter.get_structure_hook(item_type)

    def hook(value: Any, _: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError(f"expected a table, got {value!r}")
        return dict(zip(value, _each(value.items(), item, item_type), strict=True))

    return hook


def _a_class(cls: Any, converter: BaseConverter) -> Callable[[Any, Any], Any]:
    fill = make_dict_structure_fn(cls, converter, _cattrs_forbid_extra_keys=True)

    def hook(value: Any, _: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError(f"expected a table, got {value!r}")
        return fill(value, cls)

    return hook


def _made_of(origin: Any) -> Callable[[Any], bool]:
    def check(wanted: Any) -> bool:
        return get_origin(wanted) is origin

    return check


def _each(items: Iterable[tuple[int | str, Any]], hook: Any, cls: Any) -> list[Any]:
    """Structure each item; a fault carries its index, as cattrs' own do."""
    result = []
    for index, value in items:
        try:
            result.append(hook(value, cls))
        except Exception as error:
            note = IterableValidationNote(f"at {index!r}", index, cls)
            error.__notes__ = [*getattr(error, "__notes__", []), note]
            raise IterableValidationError("item", [error], cls) from None
    return result


def _converter() -> Converter:
    converter = Converter(forbid_extra_keys=True, detailed_validation=True)
    converter.register_structure_hook(float, _number)
    converter.register_structure_hook(int, _whole)
    converter.register_structure_hook(bool, _truth)
    converter.register_structure_hook(str, _text)
    converter.register_structure_hook_factory(_made_of(tuple), _a_list)
    converter.register_structure_hook_factory(_made_of(Mapping), _a_mapping)
    converter.register_structure_hook_factory(attrs.has, _a_class)
    return converter


_CONVERTER = _converter()
