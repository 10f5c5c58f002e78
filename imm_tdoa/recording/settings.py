"""``recording.toml``: its frozen classes, read and written; errors name the exact key."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any

import attrs
import tomli_w

from imm_tdoa import _structure, _validate
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
    source: Mapping[str, Any] = attrs.field(factory=dict)
    notes: Mapping[str, Any] = attrs.field(factory=dict)

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
        unknown and missing keys; line and column, where the text is no TOML.
    """
    data = _structure.parse(text, FILE)
    if "format" not in data:
        raise ValueError(f"{FILE}: format: missing; expected format = {FORMAT}")
    return _structure.structure(data, Settings, FILE)


def dumps(data: Mapping[str, Any]) -> str:
    """Return `data` as TOML text that reads back exactly.

    Raises
    ------
    ValueError
        A value that TOML cannot hold, named by its key: ``notes.a: a recording.toml cannot hold
        None``.
    """
    for key, value in data.items():
        _refuse_foreign(value, _named(key))
    text = tomli_w.dumps(data)
    # Over several lines the writer makes "\n" of "\r\n"; such text stays on one line, escaped.
    return text if r"\r\n" in text else tomli_w.dumps(data, multiline_strings=True)


def _refuse_foreign(value: Any, place: str) -> None:
    match value:
        case Mapping():
            for key, inner in value.items():
                _refuse_foreign(inner, f"{place}.{_named(key)}")
        case list() | tuple():
            for i, inner in enumerate(value):
                _refuse_foreign(inner, f"{place}[{i}]")
        case bool() | str() | float() | datetime.date():
            pass
        case datetime.time(tzinfo=None):
            pass
        case int() if -(2**63) <= value < 2**63:
            pass
        case _:
            raise ValueError(f"{place}: a {FILE} cannot hold {value!r}")


def _named(key: Any) -> str:
    if not isinstance(key, str):
        raise ValueError(f"expected text as a key of {FILE}, got {key!r}")
    return key
