"""Where a study's results lie: one file per chunk, whole or not there at all.

A folder holds ``study.toml`` (all that the study is, a study file itself), ``engines.json``,
``chunks/<scenario>-<first run>.npz`` with ``…-cost.json`` beside it, and
``bounds/<scenario>.npz``. Whatever interrupts a study, the files that are there are complete.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from imm_tdoa import _structure
from imm_tdoa.contract import Array
from imm_tdoa.study.chunk import Chunk
from imm_tdoa.study.engines import Engine
from imm_tdoa.study.plan import Study, differences
from imm_tdoa.study.planfile import parse
from imm_tdoa.study.scenarios import ScenarioCase, key_of

OWN = ("chunks", "bounds", "study.toml", "engines.json")
_DRAFT = ".draft-"


class Store:
    """A study's folder.

    Parameters
    ----------
    folder : Path
        Where it is, or will be.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def __repr__(self) -> str:
        return f"Store({str(self.folder)!r})"

    @property
    def study(self) -> Study:
        """The study that lies here."""
        path = self.folder / "study.toml"
        if not path.is_file():
            raise ValueError(f"study: {str(self.folder)!r} holds no study")
        return parse(_structure.read(path), str(path))

    def open(self, study: Study, *, restart: bool = False) -> None:
        """Make the folder, or find out what of the same study it holds.

        More runs than before go on from those that are there; words for readers may change.

        Parameters
        ----------
        study : Study
            What is to be run.
        restart : bool
            Delete what is there of a study.

        Raises
        ------
        ValueError
            It holds another study, and `restart` is not set; the message names what differs.
        """
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"--out: expected a folder, {str(self.folder)!r} is a file")
        if restart:
            self.clear()
        path = self.folder / "study.toml"
        if path.is_file():
            old = _structure.parse(_structure.read(path), str(path))
            self._refuse_other(study, old)
        for place in (self.folder, self.folder / "chunks", self.folder / "bounds"):
            place.mkdir(parents=True, exist_ok=True)
            for draft in place.glob(f"{_DRAFT}*"):
                draft.unlink(missing_ok=True)
        _write(path, lambda file: file.write(study.text.encode()))

    def _refuse_other(self, study: Study, old: Mapping[str, Any]) -> None:
        new = dict(study.table)
        before = int(old.get("runs", study.runs))
        if before <= study.runs:
            old, new = {**old, "runs": study.runs}, {**new, "runs": study.runs}
        changed = differences(old, new)
        if changed:
            more = f" (and {len(changed) - 3} more)" if len(changed) > 3 else ""
            raise ValueError(
                f"{self.folder}: holds results of another study: {'; '.join(changed[:3])}{more}; "
                f"give another folder, or --restart to delete these results"
            )

    def clear(self) -> None:
        """Delete what a study wrote here, and nothing else."""
        for name in OWN:
            place = self.folder / name
            if place.is_dir():
                shutil.rmtree(place)
            else:
                place.unlink(missing_ok=True)

    def chunks(self, scenario: str) -> list[Path]:
        """Return the files of a scenario's chunks, in the order of their runs.

        Parameters
        ----------
        scenario : str
            Name of the scenario.
        """
        pattern = re.compile(re.escape(key_of(scenario)) + r"-(\d{8,})\.npz")
        place = self.folder / "chunks"
        files = place.iterdir() if place.is_dir() else ()
        found = {int(m[1]): f for f in files if (m := pattern.fullmatch(f.name))}
        return [found[first] for first in sorted(found)]

    def load(self, path: str | Path) -> dict[str, Any]:
        """Return the arrays of a chunk's file.

        Parameters
        ----------
        path : str or Path
            One of `chunks`.

        Returns
        -------
        dict of str to array
            As `Chunk` holds them, the runs in ``runs``.
        """
        with np.load(path, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}

    def cost(self, path: str | Path) -> Array:
        """Return the seconds (B,) that each bank's filter took, for a chunk's file.

        Parameters
        ----------
        path : str or Path
            One of `chunks`.
        """
        cost = json.loads(_cost_of(Path(path)).read_text("utf-8"))
        return np.array(cost["seconds"], dtype=float)

    def steps(self, path: str | Path) -> int:
        """Return the number of steps that each bank's filter took, for a chunk's file.

        Parameters
        ----------
        path : str or Path
            One of `chunks`.
        """
        return int(json.loads(_cost_of(Path(path)).read_text("utf-8"))["steps"])

    def save(self, study: Study, chunk: Chunk) -> Path:
        """Write a chunk and return its file, which is on the disk by then.

        Parameters
        ----------
        study : Study
            What is being run.
        chunk : Chunk
            What was computed of it.
        """
        case = study.scenarios[chunk.task.scenario]
        path = self.folder / "chunks" / f"{case.key}-{chunk.task.first:08d}.npz"
        cost = {"seconds": list(chunk.seconds), "steps": chunk.steps}
        _write(_cost_of(path), lambda file: file.write(json.dumps(cost).encode()))
        _write(path, lambda file: np.savez(file, **chunk.arrays))
        return path

    def missing(self, study: Study, case: ScenarioCase) -> list[tuple[int, int]]:
        """Return the chunks of a scenario that are not there, whole and of the right runs.

        Parameters
        ----------
        study : Study
            What is to be run.
        case : ScenarioCase
            One of its scenarios.

        Returns
        -------
        list of (int, int)
            First run of each chunk and the run after its last.
        """
        there = {path.name: path for path in self.chunks(case.name)}
        result = []
        for first, last in study.chunks(case):
            path = there.get(f"{case.key}-{first:08d}.npz")
            if path is None or self._runs(path) != (first, last):
                result.append((first, last))
        return result

    def _runs(self, path: Path) -> tuple[int, int] | None:
        """Return the runs of a chunk's file, None if it is damaged or has no cost beside it."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                first, last = arrays["runs"]
            self.cost(path)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        return int(first), int(last)

    def bound(self, scenario: str) -> dict[str, Any]:
        """Return the arrays of `bounds.bound` of a scenario.

        Parameters
        ----------
        scenario : str
            Name of the scenario.
        """
        return self.load(self._bound(scenario))

    def has_bound(self, scenario: str) -> bool:
        """Return whether the bound of a scenario is there.

        Parameters
        ----------
        scenario : str
            Name of the scenario.
        """
        return self._bound(scenario).is_file()

    def save_bound(self, scenario: str, arrays: Mapping[str, Any]) -> None:
        """Write the bound of a scenario.

        Parameters
        ----------
        scenario : str
            Name of the scenario.
        arrays : mapping of str to array
            As `bound` returns them.
        """
        _write(self._bound(scenario), lambda file: np.savez(file, **arrays))

    def _bound(self, scenario: str) -> Path:
        return self.folder / "bounds" / f"{key_of(scenario)}.npz"

    @property
    def engines(self) -> tuple[Engine, ...]:
        """What computes each bank's filter; empty before the study has begun."""
        path = self.folder / "engines.json"
        return tuple(json.loads(path.read_text("utf-8"))) if path.is_file() else ()

    def save_engines(self, engines: Sequence[Engine]) -> None:
        """Write what computes each bank's filter: a study goes on with what it began with.

        Parameters
        ----------
        engines : sequence of str
            One per bank.
        """
        text = json.dumps(list(engines))
        _write(self.folder / "engines.json", lambda file: file.write(text.encode()))


def _cost_of(path: Path) -> Path:
    return path.with_name(f"{path.name.removesuffix('.npz')}-cost.json")


def _write(path: Path, fill: Callable[[BinaryIO], object]) -> None:
    """Write a file that appears whole, and stays, or not at all."""
    draft = path.with_name(f"{_DRAFT}{os.getpid()}-{path.name}")
    try:
        with draft.open("wb") as file:
            fill(file)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise
    finally:
        draft.unlink(missing_ok=True)
    _sync(path.parent)


def _sync(folder: Path) -> None:
    """Bring a folder's entries to the disk, where the system can."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
