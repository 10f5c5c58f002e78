"""Tables as Parquet, by pyarrow, which is an extra."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.recording import schema
from imm_tdoa.recording.table import Table


def _pyarrow(path: Path) -> tuple[ModuleType, ModuleType]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ValueError(
            f"{path.name}: Parquet needs pyarrow: install imm-tdoa[parquet], or use CSV"
        ) from error
    return pyarrow, pyarrow.parquet


def read(path: Path, wanted: Any) -> Table:
    """Read a Parquet table with the columns of the CSV one; a message's line is the row.

    Parameters
    ----------
    path : Path
        The file.
    wanted : callable
        From the names of its columns to those (`schema.Column`) that the table may have.

    Raises
    ------
    ValueError
        ``file:row: column: what``; no pyarrow; a file that is no Parquet.
    """
    pyarrow, parquet = _pyarrow(path)
    try:
        with path.open("rb") as file:
            data = parquet.read_table(file)
    except (pyarrow.ArrowException, OSError) as error:
        raise ValueError(f"{path.name}: no Parquet: {error}") from error
    columns = wanted(data.column_names)
    schema.check_columns(data.column_names, columns, path.name)
    kinds = {column.name: column.kind for column in columns}
    table = {
        name: _column(pyarrow, data.column(name), kinds[name], f"{path.name}:{{}}: {name}")
        for name in data.column_names
    }
    return Table(table, file=path.name, lines=np.arange(1, data.num_rows + 1))


def write(path: Path, table: Table) -> None:
    """Write a Parquet table; a missing number is a null."""
    pyarrow, parquet = _pyarrow(path)
    data = {
        name: pyarrow.array(table[name].tolist(), pyarrow.string())
        if table[name].dtype.kind == "U"
        else pyarrow.array(table[name], mask=np.isnan(table[name]))
        for name in table
    }
    parquet.write_table(pyarrow.table(data), path)


def _column(pyarrow: Any, column: Any, kind: str, place: str) -> NDArray[Any]:
    types, given = pyarrow.types, column.type
    if types.is_dictionary(given):
        column, given = column.cast(given.value_type), given.value_type
    if kind == "name":
        if not (types.is_string(given) or types.is_large_string(given) or types.is_integer(given)):
            raise ValueError(f"{place.format(1)}: expected names, got a column of {given}")
    elif not (types.is_floating(given) or types.is_integer(given) or types.is_null(given)):
        raise ValueError(f"{place.format(1)}: expected numbers, got a column of {given}")
    values = column.to_pylist()
    if kind in ("name", "number") and None in values:
        what = "a name" if kind == "name" else "a number"
        raise ValueError(f"{place.format(values.index(None) + 1)}: expected {what}, got null")
    if kind == "name":
        return np.array([str(value) for value in values], dtype=str)
    return np.array([np.nan if value is None else float(value) for value in values])
