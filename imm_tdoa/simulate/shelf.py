"""Where scenarios come from: those that ship with the package, and TOML files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from imm_tdoa import _structure
from imm_tdoa.simulate.scenario import Scenario

_SHELF = resources.files("imm_tdoa.simulate").joinpath("scenarios")


def scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that ship with the package."""
    return tuple(sorted(f.name[:-5] for f in _SHELF.iterdir() if f.name.endswith(".toml")))


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
    if isinstance(name_or_path, str) and name_or_path in scenarios():
        text = _SHELF.joinpath(f"{name_or_path}.toml").read_text("utf-8")
        return read(text, f"{name_or_path}.toml")
    path = Path(name_or_path)
    if path.is_dir():
        raise ValueError(f"scenario: {str(name_or_path)!r} is a folder; expected a TOML file")
    if path.is_file():
        return read(_structure.read(path), path.name)
    if isinstance(name_or_path, Path) or path.suffix == ".toml" or len(path.parts) != 1:
        raise ValueError(f"scenario: there is no file {str(name_or_path)!r}")
    raise ValueError(
        f"scenario: no scenario ships under the name {name_or_path!r} and there is no such "
        f"file{_structure.near(name_or_path, scenarios())}; there are: {', '.join(scenarios())}"
    )


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
