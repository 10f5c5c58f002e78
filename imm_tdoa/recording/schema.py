"""Which columns the tables of a recording have, and what may stand in them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import AXES
from imm_tdoa.recording.table import Table

Kind = Literal["name", "number", "value", "sigma"]

MEASURED = ("tdoa", "toa", "fdoa", "range_rate")
TABLES = (*MEASURED, "height", "truth")
GEODETIC = ("lat_deg", "lon_deg", "height_m")
VALUE = {
    "tdoa": "tdoa_s",
    "toa": "toa_s",
    "fdoa": "range_rate_difference_mps",
    "range_rate": "range_rate_mps",
    "height": "height_m",
}
SIGMA = {
    "tdoa": "sigma_s",
    "toa": "sigma_s",
    "fdoa": "sigma_mps",
    "range_rate": "sigma_mps",
    "height": "sigma_m",
}
WHO = {
    "tdoa": ("station", "reference"),
    "toa": ("emission", "station"),
    "fdoa": ("station", "reference"),
    "range_rate": ("emission", "station"),
    "height": ("emission",),
}


@attrs.frozen
class Column:
    """A column: its name, what it holds, and whether a table must have it.

    ``name`` is a name; ``number`` a finite number; ``value`` what was measured, NaN or an empty
    cell where it is missing; ``sigma`` a number above zero, empty where the row has none.
    """

    name: str
    kind: Kind
    required: bool = True


def positions(dims: int) -> tuple[str, ...]:
    """Names of the position columns, ``x_m y_m [z_m]``."""
    return tuple(f"{axis}_m" for axis in AXES[:dims])


def velocities(dims: int) -> tuple[str, ...]:
    """Names of the velocity columns, ``vx_mps vy_mps [vz_mps]``."""
    return tuple(f"v{axis}_mps" for axis in AXES[:dims])


def columns(table: str, dims: int, *, flat_truth: bool = False) -> tuple[Column, ...]:
    """Return the columns of a table other than the stations', in the order they are written.

    Parameters
    ----------
    table : str
        One of `TABLES`.
    dims : int
        Number of space dimensions.
    flat_truth : bool
        Whether the truth may go without a z, because scoring does not use it.
    """
    if table == "truth":
        place = [Column(n, "number", n != "z_m" or not flat_truth) for n in positions(dims)]
        speed = [Column(n, "number", False) for n in velocities(dims)]
        return (Column("time_s", "number"), Column("target", "name"), *place, *speed)
    return (
        Column("time_s", "number"),
        *(Column(name, "name") for name in WHO[table]),
        Column(VALUE[table], "value"),
        Column(SIGMA[table], "sigma", False),
        Column("target", "name", False),
    )


def station_columns(names: Iterable[str]) -> tuple[Column, ...]:
    """Return the columns of a stations table that has columns of these `names`."""
    given = set(names)
    dims = 3 if given & {"z_m", "vz_mps"} else 2
    geodetic = bool(given & set(GEODETIC)) and not given & set(positions(3))
    place = GEODETIC if geodetic else positions(dims)
    moving = "time_s" in given
    speed = velocities(dims) if moving and not geodetic else ()
    return (
        *([Column("time_s", "number")] if moving else []),
        Column("station", "name"),
        *(Column(name, "number") for name in place),
        *(Column(name, "number", False) for name in speed),
    )


def check_columns(given: Iterable[str], wanted: Iterable[Column], place: str) -> None:
    """Refuse missing, unknown and repeated columns; `place` leads the message."""
    names, wanted = list(given), tuple(wanted)
    text = ", ".join(c.name if c.required else f"[{c.name}]" for c in wanted)
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{place}: {name}: this column appears twice")
        if name not in {c.name for c in wanted}:
            raise ValueError(f"{place}: {name!r}: unknown column; expected {text}")
    for column in wanted:
        if column.required and column.name not in names:
            raise ValueError(f"{place}: {column.name}: missing column; expected {text}")
    speeds = [name for name in velocities(3) if name in names]
    whole = velocities(sum(name in names for name in positions(3)))
    for name in (*whole, *speeds):
        if speeds and (name not in names or name not in whole):
            raise ValueError(f"{place}: {name}: expected the velocities {', '.join(whole)} or none")


def check_values(table: Table, wanted: Iterable[Column]) -> Table:
    """Return the table with its columns in order and of the right type, or raise.

    Raises
    ------
    ValueError
        No rows, text in a column of numbers, an infinite or missing coordinate or time, a standard
        deviation that is not above zero, a name that is empty or has blanks around it.
    """
    if len(table) == 0:
        raise ValueError(f"{table.file}: no rows; leave the table out where it has none")
    checked: dict[str, NDArray[Any]] = {}
    for column in wanted:
        if column.name in table:
            values = table[column.name]
            if (values.dtype.kind == "U") != (column.kind == "name"):
                what = "names" if column.kind == "name" else "numbers"
                raise ValueError(f"{table.file}: {column.name}: expected {what}, got {values[:3]}")
            _check_kind(table, column, values)
            checked[column.name] = values
    return Table(checked, file=table.file, lines=table.lines)


def _check_kind(table: Table, column: Column, values: NDArray[Any]) -> None:
    if column.kind == "name":
        for name in dict.fromkeys(values.tolist()):
            if not name or name != name.strip() or not name.isprintable():
                row = int(np.argmax(values == name))
                raise ValueError(
                    f"{table.place(row, column.name)}: expected a name of printable characters "
                    f"without blanks around it, got {name!r}"
                )
        return
    bad, expected = {
        "number": (~np.isfinite(values), "a finite number"),
        "value": (np.isinf(values), "a finite number (empty where it is missing)"),
        "sigma": (~(np.isnan(values) | ((values > 0) & np.isfinite(values))), "a number above 0"),
    }[column.kind]
    if np.any(bad):
        row = int(np.argmax(bad))
        raise ValueError(
            f"{table.place(row, column.name)}: expected {expected}, got {float(values[row])!r}"
        )


def known(names: Iterable[str], limit: int = 8) -> str:
    """Return names as a list for a message, the first of many."""
    names = list(names)
    return ", ".join(names[:limit]) + (f" and {len(names) - limit} more" if names[limit:] else "")
