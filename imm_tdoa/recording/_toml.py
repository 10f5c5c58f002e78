"""Writing TOML (the standard library only reads it)."""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {"\\": "\\\\", '"': '\\"', "\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f"}
_ESCAPES["\r"] = "\\r"


def dumps(data: Mapping[str, Any]) -> str:
    """Return `data` as TOML text that `tomllib` reads back exactly.

    Raises
    ------
    ValueError
        A value that TOML cannot hold, named by its key.
    """
    return "\n".join(_table(data, ())).lstrip("\n") + "\n"


def _table(data: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    inner = {key: v for key, v in data.items() if isinstance(v, Mapping)}
    lines = [f"{_key(k)} = {_value(v, (*path, k))}" for k, v in data.items() if k not in inner]
    if path and (lines or not inner):
        lines = ["", f"[{'.'.join(_key(k) for k in path)}]", *lines]
    for key, value in inner.items():
        lines += _table(value, (*path, key))
    return lines


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise ValueError(f"expected text as a key of recording.toml, got {key!r}")
    return key if _BARE.fullmatch(key) else _text(key)


def _value(value: Any, path: tuple[str, ...]) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int() if -(2**63) <= value < 2**63:
            return str(int(value))
        case float():
            return repr(float(value))
        case str() if "\n" in value:
            return _long_text(value)
        case str():
            return _text(value)
        case datetime.datetime() | datetime.date() | datetime.time():
            return value.isoformat()
        case Mapping():
            items = (f"{_key(k)} = {_value(v, (*path, k))}" for k, v in value.items())
            return "{" + ", ".join(items) + "}"
        case Sequence() if not isinstance(value, bytes | bytearray):
            return "[" + ", ".join(_value(v, path) for v in value) + "]"
    raise ValueError(f"{'.'.join(path)}: a recording.toml cannot hold {value!r}")


def _text(text: str) -> str:
    return f'"{"".join(_escaped(c) for c in text)}"'


def _long_text(text: str) -> str:
    lines = ("".join(_escaped(c) for c in line) for line in text.split("\n"))
    return '"""\n' + "\n".join(lines) + '"""'


def _escaped(c: str) -> str:
    if c in _ESCAPES:
        return _ESCAPES[c]
    return f"\\u{ord(c):04x}" if ord(c) < 0x20 or ord(c) == 0x7F else c
