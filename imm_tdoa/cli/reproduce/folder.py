"""What every ``imm-tdoa reproduce`` leaves in its folder: tables, pictures, summary.json."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from imm_tdoa.cli import output


def write(
    home: Path,
    tables: Mapping[str, Mapping[str, Any]],
    pictures: Mapping[str, Callable[[Path], Any]],
    summary: Mapping[str, Any],
) -> list[str]:
    """Write all of it and return the files' names.

    Parameters
    ----------
    home : Path
        The folder; it need not exist yet.
    tables : mapping
        Columns of each CSV file.
    pictures : mapping
        What draws each PNG file, given its path.
    summary : mapping
        What summary.json holds besides the names.
    """
    from imm_tdoa.recording.table import Table

    home.mkdir(parents=True, exist_ok=True)
    for name, columns in tables.items():
        output.write_table(home / name, Table(columns))
    for name, draw in pictures.items():
        draw(home / name)
    files = sorted([*tables, *pictures, "summary.json"])
    output.write_json(home / "summary.json", {**summary, "files": files})
    return files
