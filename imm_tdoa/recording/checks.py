"""What must hold between the rows of a table: order, stations that exist, nothing twice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.recording.schema import known
from imm_tdoa.recording.table import Table


def check_measured(table: Table, stations: Sequence[str], *, labelled: bool) -> None:
    """Check the rows of a measured table against the names of the `stations`.

    Where rows are not `labelled`, two emitters may make two differences of one pair at one time.

    Raises
    ------
    ValueError
        Times that decrease, an unknown station, a station paired with itself, a row
        that repeats an earlier one.
    """
    check_sorted(table)
    for column in ("station", "reference"):
        if column in table:
            _check_stations(table, column, stations)
    who = [table["target"].tolist() if "target" in table else [""] * len(table)]
    if "reference" in table:
        ends = table["station"], table["reference"]
        same = ends[0] == ends[1]
        if np.any(same):
            row = int(np.argmax(same))
            raise ValueError(
                f"{table.place(row, 'reference')}: expected another station than "
                f"{str(ends[0][row])!r}, which cannot be paired with itself"
            )
        # A pair read backwards is the same measurement with the other sign.
        who += [table["time_s"].tolist(), [frozenset(p) for p in zip(*ends, strict=True)]]
        if labelled:
            refuse_repeated(table, who, "station", "the same time, pair of stations and target")
    elif "station" in table:
        who += [table["emission"].tolist(), table["station"].tolist()]
        refuse_repeated(table, who, "station", "the same emission, station and target")
    else:
        who += [table["emission"].tolist()]
        refuse_repeated(table, who, "emission", "the same emission and target")


def check_sorted(table: Table) -> None:
    """Refuse times that decrease from row to row."""
    time = table["time_s"]
    falls = np.diff(time) < 0.0
    if np.any(falls):
        row = int(np.argmax(falls)) + 1
        raise ValueError(
            f"{table.place(row, 'time_s')}: expected times that do not decrease, "
            f"got {float(time[row])!r} after {float(time[row - 1])!r}"
        )


def check_increasing(table: Table, who: str) -> None:
    """Refuse times that do not increase among the rows of one station or target."""
    time, names = table["time_s"], table[who]
    for name in dict.fromkeys(names.tolist()):
        rows = np.flatnonzero(names == name)
        stays = np.diff(time[rows]) <= 0.0
        if np.any(stays):
            k = int(np.argmax(stays))
            before, row = float(time[rows[k]]), int(rows[k + 1])
            got = float(time[row])
            what = "this time appears twice" if got == before else f"it follows {before!r}"
            raise ValueError(
                f"{table.place(row, 'time_s')}: expected increasing times of {who} {name!r}, "
                f"got {got!r}; {what}"
            )


def refuse_repeated(table: Table, keys: Iterable[Sequence[Any]], column: str, what: str) -> None:
    """Refuse a row whose keys an earlier row has; `what` says what the keys are."""
    seen: dict[Any, int] = {}
    for row, key in enumerate(zip(*keys, strict=True)):
        first = seen.setdefault(key, row)
        if first != row:
            where = "" if table.lines is None else f" in line {int(table.lines[first])}"
            raise ValueError(
                f"{table.place(row, column)}: duplicate row: {what} appeared before{where}"
            )


def _check_stations(table: Table, column: str, stations: Sequence[str]) -> None:
    names: NDArray[Any] = table[column]
    strange = ~np.isin(names, np.array(stations, dtype=str))
    if np.any(strange):
        row = int(np.argmax(strange))
        raise ValueError(
            f"{table.place(row, column)}: unknown station {str(names[row])!r}; "
            f"there are {known(stations)}"
        )
