"""Banks from TOML files, and the presets that ship with the package.

A bank file holds what `imm_tdoa.bank.Bank` takes::

    mean_sojourn_s = [30.0, 60.0]        # s: one time, or one per mode
    mixing = "birth"

    [birth_std]                          # what a switch of mode brings, standard deviations
    velocity = 12.0                      # m/s

    [[modes]]
    model = "static"                     # the name of any registered motion model
    psd = 0.0                            # every other key is a parameter of the model

    [[modes]]
    model = "constant-velocity"
    name = "driving"                     # optional: what the mode is called in tables and pictures
    psd = 1.0
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from imm_tdoa import _structure, registry
from imm_tdoa._shelf import Shelf
from imm_tdoa._structure import near
from imm_tdoa.bank import Bank

SHELF = Shelf("bank", "preset", "presets")


def _mode_tables(_: Any, __: Any, value: tuple[Mapping[str, Any], ...]) -> None:
    if not value:
        raise ValueError("modes: expected at least one [[modes]] table, got none")
    for i, mode in enumerate(value):
        if "model" not in mode:
            raise ValueError(f"modes[{i}].model: missing; expected the name of a motion model")
        for key in ("model", "name"):
            if not isinstance(mode.get(key, ""), str):
                raise ValueError(f"modes[{i}].{key}: expected text in quotes, got {mode[key]!r}")


def _times(_: Any, __: Any, value: Any) -> None:
    for i, time in enumerate(value if isinstance(value, list) else [value]):
        if isinstance(time, bool) or not isinstance(time, int | float | None):
            place = f"mean_sojourn_s[{i}]" if isinstance(value, list) else "mean_sojourn_s"
            expected = "a number" if isinstance(value, list) else "a number or a list of numbers"
            raise ValueError(f"{place}: expected {expected}, s, got {time!r}")


@attrs.frozen
class _File:
    """The content of a bank file, as far as it can be checked without knowing the models."""

    modes: tuple[Mapping[str, Any], ...] = attrs.field(validator=_mode_tables, default=())
    mean_sojourn_s: Any = attrs.field(validator=_times, default=None)
    transition: tuple[tuple[float, ...], ...] | None = None
    prior: tuple[float, ...] | None = None
    mixing: str = "birth"
    birth_std: Mapping[str, float] = attrs.field(factory=dict)


def presets() -> tuple[str, ...]:
    """Return the names of the banks that ship with the package."""
    return SHELF.names()


def load(name_or_path: str | Path) -> Bank:
    """Return the bank of a preset or of a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        The name of a preset (`presets` lists them), or the path of a bank file. A preset goes
        before a file of the same name; write ``./name`` for the file.

    Raises
    ------
    ValueError
        Neither a preset nor a file; a file that is no bank. The message says where in the file
        (``bank.toml: modes[1].psd: …``), what was wrong and what was expected.
    """
    found = SHELF.find(name_or_path)
    return parse(found.text, found.file)


def parse(text: str, file: str = "bank") -> Bank:
    """Return the bank that a text describes.

    Parameters
    ----------
    text : str
        TOML, as in a bank file.
    file : str
        What messages call it.

    Raises
    ------
    ValueError
        What is wrong with it, and where.
    """
    content = _structure.structure(_structure.parse(text, file), _File, file)
    models = [_model(mode, f"{file}: modes[{i}]") for i, mode in enumerate(content.modes)]
    names = _mode_names(content.modes, file)
    try:
        return Bank(
            models,
            mean_sojourn=content.mean_sojourn_s,
            transition=content.transition,
            prior=content.prior,
            mixing=content.mixing,  # type: ignore[arg-type]
            birth_std=content.birth_std,
            names=names,
        )
    except ValueError as error:
        message = re.sub(r"\bmean_sojourn\b", "mean_sojourn_s", str(error))
        raise ValueError(f"{file}: {message}") from error


def _model(mode: Mapping[str, Any], place: str) -> Any:
    """The motion model of one [[modes]] table, or an error that says where it went wrong."""
    name, motions = mode["model"], registry.names("motion")
    if name not in motions:
        if name in registry.names():
            what = f"{name!r} is a measurement model, not a motion model"
        else:
            what = f"no plug-in provides {name!r}{near(name, motions)}"
        raise ValueError(f"{place}.model: {what}; there are: {', '.join(motions)}")
    cls = registry.load(name)
    takes = _parameters(cls)
    given = {key: value for key, value in mode.items() if key not in ("model", "name")}
    for key in given:
        if key not in takes:
            raise ValueError(
                f"{place}.{key}: the model {name!r} has no such parameter{near(key, takes)}; "
                f"it takes: {', '.join(takes)}"
            )
    try:
        return cls(**given)
    except (ValueError, TypeError) as error:
        text = str(error)
        joint = "." if any(text.startswith(f"{key}:") for key in given) else ": "
        raise ValueError(f"{place}{joint}{text}") from error


def _parameters(cls: Any) -> list[str]:
    variadic = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    every = inspect.signature(cls).parameters.values()
    return [p.name for p in every if p.kind not in variadic]


def _mode_names(modes: Sequence[Mapping[str, Any]], file: str) -> tuple[str, ...]:
    """Names of the modes, the model's where none is given; empty where none is given at all."""
    if not any("name" in mode for mode in modes):
        return ()
    plain = [mode.get("name", mode["model"]) for mode in modes]
    names: list[str] = []
    for i, (mode, name) in enumerate(zip(modes, plain, strict=True)):
        repeats = plain.count(name) > 1
        if repeats and "name" in mode:
            raise ValueError(f"{file}: modes[{i}].name: the name {name!r} appears twice")
        names.append(f"{name}-{plain[: i + 1].count(name)}" if repeats else name)
    return tuple(names)
