"""Scans of which nobody knows who sent what: what `imm_tdoa.Tracker` takes.

>>> measurement, scans = unlabelled(read("folder"))
>>> tracker = Tracker(bank, measurement)
>>> for scan in scans:
...     tracks = tracker.step(scan)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa import _validate, registry
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.recording import gather, schema
from imm_tdoa.recording.recording import Recording
from imm_tdoa.recording.table import Table


@attrs.frozen(eq=False)
class Scan:
    """What was measured at one time, row by row, in any order.

    Parameters
    ----------
    time : float
        Time, s.
    values : (K,)
        Measured values in the measurement's own units (seconds for arrivals); NaN is missing.
    row : (K,) int
        Row of the measurement model that each value is of (which station or pair).
    emission : (K,) int, optional
        Values with the same number came from one emission and stay together. Needed where rows
        share an unknown offset (arrival times).
    sweep : bool
        Whether every target had its chance to be heard, so that missing rows count against it.
        False for single messages that come when they come.
    target : (K,) str, optional
        Who it was, where somebody knows. The tracker never looks at it; scoring does.

    Raises
    ------
    ValueError
        Shapes that do not fit, infinite values, a time that is no finite number, a row number
        that is negative or no integer.
    """

    time: float
    values: Array
    row: Index
    emission: Any = attrs.field(default=None, kw_only=True)
    sweep: bool = attrs.field(default=True, kw_only=True)
    target: Any = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("time", float(_validate.array("time", self.time, ())))
        put("values", _validate.array("values", self.values, ("K",), finite=False))
        put("row", _numbers("row", self.row, len(self.values)))
        if self.emission is not None:
            put("emission", _numbers("emission", self.emission, len(self.values)))
        if self.target is not None:
            target = np.asarray(self.target, dtype=str)
            if target.shape != self.values.shape:
                raise ValueError(f"target: expected {len(self.values)} names, got {target.shape}")
            put("target", target)

    def __len__(self) -> int:
        return len(self.values)


def _numbers(name: str, value: Any, count: int) -> Index:
    array = np.asarray(value)
    if array.size == 0:
        array = array.astype(np.int64)
    if array.shape != (count,):
        raise ValueError(f"{name}: expected {count} numbers, got shape {array.shape}")
    if not np.issubdtype(array.dtype, np.integer) or np.any(array < 0):
        raise ValueError(f"{name}: expected whole numbers from 0, got {value!r}")
    return array.astype(np.int64)


@attrs.frozen(eq=False)
class UnlabelledScans:
    """Scans in the order of time; unpacks as ``measurement, scans``.

    Attributes
    ----------
    measurement : MeasurementModel
        What is measured, a row per station, per pair of stations, per height.
    scans : tuple of Scan
        One per time; messages of arrival times are scans that are no sweep.
    ignored : mapping of str to int
        Rows that could not be used, by reason.
    """

    measurement: MeasurementModel
    scans: tuple[Scan, ...]
    ignored: Mapping[str, int]

    def __iter__(self) -> Iterator[Any]:
        return iter((self.measurement, self.scans))


def without_labels(recording: Recording) -> Recording:
    """Return the recording as if nobody knew whose the rows are.

    The names stay in its tables, hidden from a tracker; `unlabelled` hands them to scoring.

    Parameters
    ----------
    recording : Recording
        One that says whose its rows are, or not.
    """
    return attrs.evolve(recording, labelled=False)


def unlabelled(recording: Recording) -> UnlabelledScans:
    """Return all rows of a recording as scans of rows without owner.

    Rows of one emission stay together; those of emissions at exactly the same time make one
    scan. Differences of the same ``time_s`` make a scan in which every target could be heard.
    Standard deviations are those of `Recording.scans`; where rows of one pair or station at the
    same time have different ones, all get the larger.

    Parameters
    ----------
    recording : Recording
        Whose rows; labels are put aside for scoring.

    Raises
    ------
    ValueError
        Rows that have no standard deviation; arrival times too far from their zero.
    """
    found = {name: recording.measured[name] for name in gather.ORDER if name in recording.measured}
    stamps = {name: _stamps(found, table) for name, table in found.items()}
    clock = np.unique(np.concatenate(list(stamps.values())))
    parts: list[_Part] = []
    ignored: dict[str, int] = {}
    start = 0
    for name, table in found.items():
        scan = np.searchsorted(clock, stamps[name])
        values = table[schema.VALUE[name]]
        rows = gather._Rows(name, table, np.arange(len(table)), values, scan)
        model, column, lost = _model(recording, rows, clock)
        if np.any(lost):
            reason = f"{name}: pair that only repeats others"
            ignored[reason] = int(np.count_nonzero(lost))
        parts.append(_Part(model, rows, column + start, ~lost))
        start += model.size
    models = [part.model for part in parts]
    measurement = models[0] if len(models) == 1 else registry.load("stack")(*models)
    return UnlabelledScans(measurement, _scans(parts, clock), ignored)


class _Part(NamedTuple):
    """The rows of one table: their model, their columns (N,), and which are kept (N,)."""

    model: MeasurementModel
    rows: gather._Rows
    column: Index
    kept: Mask


def _stamps(found: Mapping[str, Table], table: Table) -> Array:
    """Time (N,) of each row: with emissions that of the earliest row of its emission."""
    own: Array = table["time_s"]
    if "emission" not in table:
        return own
    tables = [t for t in found.values() if "emission" in t]
    every = np.concatenate([t["emission"] for t in tables])
    known, number = np.unique(every, return_inverse=True)
    first = np.full(len(known), np.inf)
    np.minimum.at(first, number, np.concatenate([t["time_s"] for t in tables]))
    result: Array = first[np.searchsorted(known, table["emission"])]
    return result


def _model(
    recording: Recording, rows: gather._Rows, clock: Array
) -> tuple[MeasurementModel, Index, Mask]:
    """Measurement model of one table, the column (N,) of each row, and which rows go (N,)."""
    number = {name: i for i, name in enumerate(recording.stations.names)}
    if "reference" not in rows.table:
        column = np.zeros(len(rows.index), dtype=np.int64)
        if rows.name != "height":
            column = np.array([number[n] for n in rows.column("station").tolist()])
        part = gather._station_part(recording, rows, clock)
        return part.model, column, np.zeros(len(rows.index), dtype=bool)
    ends = [[number[n] for n in rows.column(c).tolist()] for c in ("station", "reference")]
    pairs, column, count = np.unique(
        np.array(ends, dtype=np.int64).T, axis=0, return_inverse=True, return_counts=True
    )
    column = column.reshape(-1)
    tree = _spanning(pairs, np.argsort(-count, kind="stable"))
    lost = ~tree[column]
    column = np.where(lost, 0, (np.cumsum(tree) - 1)[column])
    return _pair_model(recording, rows, pairs[tree], column, lost, clock), column, lost


def _pair_model(
    recording: Recording,
    rows: gather._Rows,
    pairs: Index,
    column: Index,
    lost: Mask,
    clock: Array,
) -> MeasurementModel:
    """Model of differences between `pairs`, its noise as `Recording.scans` has it."""
    time = rows.name == "tdoa"
    name, per_pair = ("tdoa", "tdoa_sigma") if time else ("fdoa", "difference_sigma")
    single, differenced = gather._pair_defaults(recording.noise, time)
    if single is not None and differenced is None and np.isnan(rows.own_sigma).all():
        given = {"toa_sigma" if time else "range_rate_sigma": single}
    else:
        used = np.where(lost, np.nan, rows.values)
        kept = attrs.evolve(rows, values=used)
        given = gather._sampled(
            gather._row_sigma(recording.noise, kept), kept, column, len(pairs), clock
        )
        given[per_pair] = given.pop("sigma")
    if time:
        given["speed"] = recording.speed_mps
    model: MeasurementModel = registry.load(name)(recording.stations, pairs=pairs, **given)
    return model


def _spanning(pairs: Index, order: Index) -> Mask:
    """Which pairs (m,) are not the sum of others taken before them in `order`."""
    tree = list(range(int(pairs.max(initial=0)) + 1))
    kept = np.zeros(len(pairs), dtype=bool)
    for i in order.tolist():
        a, b = (tree[int(k)] for k in pairs[i])
        kept[i] = a != b
        tree = [b if root == a else root for root in tree]
    return kept


def _scans(parts: list[_Part], clock: Array) -> tuple[Scan, ...]:
    """All rows, scan by scan: first the messages of a time, then its differences."""
    columns: dict[str, list[Any]] = {k: [] for k in ("scan", "value", "row", "message", "who")}
    for _, rows, column, kept in parts:
        use = kept & np.isfinite(rows.values)
        columns["scan"].append(rows.scan[use])
        columns["value"].append(np.asarray(rows.values)[use])
        columns["row"].append(column[use])
        loose = "emission" not in rows.table
        names = np.full(len(rows.index), "") if loose else rows.column("emission")
        columns["message"].append(names[use])
        who = rows.column("target") if "target" in rows.table else np.full(len(rows.index), "")
        columns["who"].append(who[use])
    scan, value, row, message, who = (np.concatenate(columns[k]) for k in columns)
    loose = message == ""
    result = []
    order = np.lexsort((np.arange(len(scan)), loose, scan))
    key = 2 * scan[order] + loose[order]
    cuts = np.flatnonzero(np.diff(key)) + 1
    for part in np.split(order, cuts):
        if not len(part):
            continue
        owners: Any = who[part] if np.any(who[part] != "") else None
        emission = None
        if not loose[part[0]]:
            emission = np.unique(message[part], return_inverse=True)[1].reshape(-1)
        time = float(clock[scan[part[0]]])
        result.append(
            Scan(
                time,
                value[part],
                row[part],
                emission=emission,
                sweep=emission is None,
                target=owners,
            )
        )
    return tuple(result)
