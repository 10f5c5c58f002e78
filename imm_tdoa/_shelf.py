"""TOML files by name: those that ship with the package, and the user's."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import NamedTuple

import attrs

from imm_tdoa import _structure


class Found(NamedTuple):
    """A file's text, what messages call it, and its folder; a shipped file has none."""

    text: str
    file: str
    folder: Path | None


@attrs.frozen
class Shelf:
    """A folder of the package with TOML files that go by their names.

    Parameters
    ----------
    what : str
        What such a file describes; every message begins with it.
    kind : str
        What one that ships is called.
    folder : str
        Where they are inside the package.
    """

    what: str
    kind: str
    folder: str

    def names(self) -> tuple[str, ...]:
        """Return the names of the files that ship."""
        files = self._place().iterdir()
        return tuple(sorted(f.name.removesuffix(".toml") for f in files if _is_toml(f.name)))

    def find(self, name_or_path: str | Path, beside: Path | None = None) -> Found:
        """Return a shipped file by name, or a file by path; the shipped one goes first.

        Parameters
        ----------
        name_or_path : str or Path
            A name that `names` lists, or a path.
        beside : Path, optional
            A folder where a relative path is looked for first.

        Raises
        ------
        ValueError
            Neither; a folder; a file that is no UTF-8.
        """
        names = self.names()
        if isinstance(name_or_path, str) and name_or_path in names:
            file = f"{name_or_path}.toml"
            return Found(self._place().joinpath(file).read_text("utf-8"), file, None)
        path = Path(name_or_path)
        if beside is not None and (beside / path).is_file():
            path = beside / path
        if path.is_file():
            return Found(_structure.read(path), path.name, path.parent)
        if path.is_dir():
            raise ValueError(
                f"{self.what}: {str(name_or_path)!r} is a folder; expected a TOML file"
            )
        if isinstance(name_or_path, Path) or _is_toml(path.name) or len(path.parts) != 1:
            raise ValueError(f"{self.what}: there is no file {str(name_or_path)!r}")
        raise ValueError(
            f"{self.what}: no {self.kind} and no file is called {name_or_path!r}"
            f"{_structure.near(name_or_path, names)}; there are: {', '.join(names)}"
        )

    def _place(self) -> Traversable:
        return resources.files("imm_tdoa").joinpath(*self.folder.split("/"))


def _is_toml(name: str) -> bool:
    return name.endswith(".toml")
