"""Tables as CSV, with the exact line in every message."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.recording import schema
from imm_tdoa.recording.table import Table


def read(path: Path, wanted: Any) -> Table:
    """Read a CSV table.

    Parameters
    ----------
    path : Path
        The file.
    wanted : callable
        From the names in the header to the columns (`schema.Column`) that the table may have.

    Raises
    ------
    ValueError
        ``file:line: column: what``: no header, columns missing or unknown, a row that is too
        short or too long, text where a number should be.
    """
    header, rows, lines = _rows(path)
    columns = wanted(header)
    schema.check_columns(header, columns, f"{path.name}:1")
    kinds = {column.name: column.kind for column in columns}
    table: dict[str, NDArray[Any]] = {}
    for i, name in enumerate(header):
        cells = [row[i] for row in rows]
        if kinds[name] == "name":
            table[name] = np.array(cells, dtype=str)
        else:
            empty = kinds[name] in ("value", "sigma")
            table[name] = _numbers(cells, lines, f"{path.name}:{{}}: {name}", empty)
    return Table(table, file=path.name, lines=np.array(lines, dtype=np.int64))


def write(path: Path, table: Table) -> None:
    """Write a CSV table; numbers so that they read back exactly, a missing one as nothing."""
    columns = []
    for name in table:
        values = table[name].tolist()
        if table[name].dtype.kind == "f":
            values = ["" if value != value else repr(value) for value in values]
        columns.append(values)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(list(table))
        writer.writerows(zip(*columns, strict=True))


def _rows(path: Path) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, rows, and the line of each row; blank lines are passed over."""
    rows, lines = [], []
    line = 0
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            for cells in reader:
                line = reader.line_num
                if cells:
                    rows.append(cells)
                    lines.append(line)
    except csv.Error as error:
        raise ValueError(f"{path.name}:{line + 1}: no CSV: {error}") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name}: expected text in UTF-8, {error}") from error
    if not rows:
        raise ValueError(f"{path.name}:1: the file is empty; expected a header of column names")
    header = rows[0]
    for number, cells in zip(lines[1:], rows[1:], strict=True):
        if len(cells) < len(header):
            raise ValueError(
                f"{path.name}:{number}: {header[len(cells)]}: the row ends before this column, "
                f"after {len(cells)} of {len(header)} fields; is the file cut off?"
            )
        if len(cells) > len(header):
            raise ValueError(
                f"{path.name}:{number}: expected {len(header)} fields, got {len(cells)}"
            )
    return header, rows[1:], lines[1:]


def _numbers(cells: list[str], lines: list[int], place: str, empty: bool) -> NDArray[Any]:
    numbers = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            if empty and not cell:
                numbers[i] = np.nan
            elif "_" in cell:  # Python would read 1_000 as a thousand
                raise ValueError(cell)
            else:
                numbers[i] = float(cell)
        except ValueError:
            what = repr(cell) if cell else "an empty cell"
            raise ValueError(f"{place.format(lines[i])}: expected a number, got {what}") from None
    return numbers
