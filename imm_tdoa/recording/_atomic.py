"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def file(path: Path) -> Iterator[Path]:
    """Yield a path to write to, which replaces `path` when all went well."""
    path = path.resolve()
    workshop = _workshop(path)
    try:
        yield workshop / path.name
        (workshop / path.name).replace(path)
    finally:
        shutil.rmtree(workshop, ignore_errors=True)


@contextmanager
def folder(path: Path, replaced: Callable[[str], bool]) -> Iterator[Path]:
    """Yield an empty folder to write to, which becomes `path` when all went well.

    What `path` holds already moves along, but for the names that are `replaced`.
    """
    path = path.resolve()
    workshop = _workshop(path)
    draft, old = workshop / "new", workshop / "old"
    draft.mkdir()
    try:
        yield draft
        if path.exists():
            path.rename(old)
            try:
                draft.rename(path)
            except OSError:
                old.rename(path)
                raise
            for item in old.iterdir():
                if not replaced(item.name):
                    item.rename(path / item.name)
            shutil.rmtree(old)
        else:
            draft.rename(path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if not old.exists():  # else it holds what could not be moved along
            workshop.rmdir()


def _workshop(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
