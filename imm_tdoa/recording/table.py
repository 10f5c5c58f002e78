"""A table of a recording: named columns that know which file and line they came from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa._brief import brief
from imm_tdoa.contract import Index

ColumnArray = NDArray[np.float64] | NDArray[np.str_]


def _columns(given: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    columns = {}
    for name, values in given.items():
        array = np.array(values)
        if array.ndim != 1:
            raise ValueError(f"{name}: expected one column of values, got shape {array.shape}")
        kind = array.dtype.kind
        text = kind in "UT" or (kind == "O" and all(isinstance(v, str) for v in array))
        if not text and kind not in "iuf":
            raise ValueError(f"{name}: expected numbers or names, got {array.dtype} {array[:3]}")
        array = array.astype(str if text else float)
        array.setflags(write=False)
        columns[name] = array
    lengths = {len(array) for array in columns.values()}
    if len(lengths) > 1:
        got = ", ".join(f"{name} {len(array)}" for name, array in columns.items())
        raise ValueError(f"columns: expected columns of one length, got {got}")
    return columns


@attrs.frozen(eq=False)
class Table:
    """Columns of equal length by name, as float or string arrays.

    Parameters
    ----------
    columns : mapping of str to (N,) array-like
        Numbers in the unit that the column's name carries, or names (strings).
    file : str, optional
        File that the table came from, for messages.
    lines : (N,) int, optional
        Line of that file (row, counted from 1, of a Parquet file) of each row.

    Raises
    ------
    ValueError
        Columns of different lengths, of more than one dimension, of neither numbers nor names.
    """

    columns: Mapping[str, NDArray[Any]] = attrs.field(converter=_columns)
    file: str = attrs.field(default="", kw_only=True)
    lines: Index | None = attrs.field(default=None, kw_only=True, repr=False)

    __repr__ = brief

    def __len__(self) -> int:
        return next((len(array) for array in self.columns.values()), 0)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def place(self, row: int, column: str) -> str:
        """Return ``file:line: column`` of a row (``file[row]: column`` where no line is known).

        Parameters
        ----------
        row : int
            Which row.
        column : str
            Which column.
        """
        where = self.file or "table"
        where += f"[{row}]" if self.lines is None else f":{int(self.lines[row])}"
        return f"{where}: {column}"
