"""``recording.toml``: its frozen classes, and errors that name the exact key."""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Mapping
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import attrs
import cattrs
from cattrs.errors import BaseValidationError, ForbiddenExtraKeysError
from cattrs.gen import make_dict_structure_fn

from imm_tdoa import _validate
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.recording.sections import Noise, TruthScoring

FILE = "recording.toml"
FORMAT = 1


@attrs.frozen
class Frame:
    """``[frame]``: local axes, or east-north-up at an origin."""

    kind: str = "local"
    origin_lat_deg: float | None = None
    origin_lon_deg: float | None = None
    origin_height_m: float | None = None

    def __attrs_post_init__(self) -> None:
        if self.kind not in ("local", "enu"):
            raise ValueError(f"kind: expected 'local' or 'enu', got {self.kind!r}")
        for key in ("origin_lat_deg", "origin_lon_deg", "origin_height_m"):
            given = getattr(self, key) is not None
            if self.kind == "local" and given:
                raise ValueError(f"{key}: a local frame has no origin; set kind = 'enu'")
            if self.kind == "enu" and not given:
                raise ValueError(f"{key}: missing; an ENU frame needs its origin")
        try:
            self.axes()
        except ValueError as error:
            raise ValueError(f"origin_{error}") from error

    def axes(self) -> EastNorthUp | None:
        """Return the frame; None where it is local."""
        origin = (self.origin_lat_deg, self.origin_lon_deg, self.origin_height_m)
        given = [value for value in origin if value is not None]
        return EastNorthUp(*given) if given else None


@attrs.frozen
class Settings:
    """The keys of ``recording.toml``."""

    format: int
    title: str = ""
    speed_mps: float = 299792458.0
    dims: int | None = None
    labelled: bool = True
    frame: Frame = attrs.field(factory=Frame)
    noise: Noise = attrs.field(factory=Noise)
    truth: TruthScoring = attrs.field(factory=TruthScoring)
    source: dict[str, Any] = attrs.field(factory=dict)
    notes: dict[str, Any] = attrs.field(factory=dict)

    def __attrs_post_init__(self) -> None:
        if self.format != FORMAT:
            raise ValueError(f"format: expected {FORMAT}, got {self.format!r}")
        if self.dims not in (None, 2, 3):
            raise ValueError(f"dims: expected 2 or 3, got {self.dims!r}")
        _validate.positive("speed_mps", self.speed_mps)


def parse(text: str) -> Settings:
    """Return the settings of a recording from the text of its ``recording.toml``.

    Raises
    ------
    ValueError
        ``recording.toml: noise.toa_sigma_s: expected a number, got 'abc'``, and the like for
        unknown and missing keys; the line, where the text is no TOML.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        line = found[1] if found else str(text.count("\n") + 1)
        raise ValueError(f"{FILE}:{line}: no TOML: {error}") from error
    if "format" not in data:
        raise ValueError(f"{FILE}: format: missing; expected format = {FORMAT}")
    try:
        return _converter().structure(data, Settings)
    except BaseValidationError as error:
        raise ValueError(f"{FILE}: {_first(error, '')}") from error


class _WrongTypeError(ValueError):
    """A value of the wrong type."""


@functools.cache
def _converter() -> cattrs.Converter:
    """A converter that never turns one type into another."""
    converter = cattrs.Converter(forbid_extra_keys=True)
    converter.register_structure_hook(float, _number)
    converter.register_structure_hook(int, _strict("a whole number", int))
    converter.register_structure_hook(str, _strict("text", str))
    converter.register_structure_hook(bool, _strict("true or false", bool))
    converter.register_structure_hook_func(_is_free, _strict("a table", dict))
    converter.register_structure_hook_func(_is_names, _names)
    for cls in (Frame, Noise, TruthScoring, Settings):
        converter.register_structure_hook(cls, _table(cls, converter))
    return converter


def _strict(what: str, kind: type) -> Any:
    def hook(value: Any, _: Any) -> Any:
        if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
            raise _WrongTypeError(f"expected {what}, got {value!r}")
        return value

    return hook


def _number(value: Any, _: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _WrongTypeError(f"expected a number, got {value!r}")
    return float(value)


def _is_free(kind: Any) -> bool:
    return bool(kind == dict[str, Any])


def _is_names(kind: Any) -> bool:
    options = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return tuple[str, ...] in options


def _names(value: Any, _: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise _WrongTypeError(f"expected a list of names, got {value!r}")
    return tuple(value)


def _table(cls: type, converter: cattrs.Converter) -> Any:
    structure: Any = make_dict_structure_fn(cls, converter, _cattrs_forbid_extra_keys=True)

    def hook(value: Any, kind: Any) -> Any:
        if not isinstance(value, Mapping):
            raise _WrongTypeError(f"expected a table, got {value!r}")
        return structure(value, kind)

    return hook


def _first(error: BaseException, path: str) -> str:
    """Return ``key.key: what`` of the first fault inside a cattrs error group."""
    if isinstance(error, cattrs.ClassValidationError):
        placed, loose = error.group_exceptions()
        if placed:
            inner, note = placed[0]
            return _first(inner, f"{path}{'.' if path else ''}{note.name}")
        return _first(loose[0], path)
    dot = "." if path else ""
    if isinstance(error, ForbiddenExtraKeysError):
        key = min(error.extra_fields)
        expected = ", ".join(get_type_hints(error.cl))
        return f"{path}{dot}{key}: unknown key; expected one of {expected}"
    if isinstance(error, _WrongTypeError):
        return f"{path}: {error}"
    return f"{path}{dot}{error}"  # a class's own check, which names its field
