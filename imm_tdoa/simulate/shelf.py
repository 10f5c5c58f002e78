"""Where scenarios come from: those that ship with the package, and TOML files."""

from __future__ import annotations

from pathlib import Path

from imm_tdoa import _structure
from imm_tdoa._shelf import Shelf
from imm_tdoa.simulate.scenario import Scenario

SHELF = Shelf("scenario", "shipped scenario", "simulate/scenarios")


def scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that ship with the package."""
    return SHELF.names()


def load(name_or_path: str | Path) -> Scenario:
    """Return a shipped scenario or one from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        The name of a shipped scenario (`scenarios` lists them), or the path of a file. A shipped
        name goes before a file of the same name; write ``./name`` for the file.

    Raises
    ------
    ValueError
        Neither shipped nor a file; a file that is no scenario. The message says where in the
        file (``scenario.toml: targets[0].legs[1].duration_s: …``), what was wrong and what was
        expected.
    """
    found = SHELF.find(name_or_path)
    return read(found.text, found.file)


def read(text: str, file: str = "scenario") -> Scenario:
    """Return the scenario that a text describes.

    Parameters
    ----------
    text : str
        TOML, as in a scenario file.
    file : str
        What messages call it.

    Raises
    ------
    ValueError
        What is wrong with it, and where.
    """
    return _structure.structure(_structure.parse(text, file), Scenario, file)
