"""From the rows of a recording to the scans of one target."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa import registry
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.recording import schema
from imm_tdoa.recording.sections import Noise
from imm_tdoa.recording.table import Table
from imm_tdoa.scans import Scans

if TYPE_CHECKING:
    from imm_tdoa.recording.recording import Recording

ORDER = ("toa", "range_rate", "height", "tdoa", "fdoa")
COARSEST = 0.05  # largest step of a double, in standard deviations, that a time may be held in


@attrs.frozen(eq=False)
class _Rows:
    """The rows of one table that are the target's: values, own sigmas, and where they belong."""

    name: str
    table: Table
    index: Index
    values: Array
    scan: Index

    @property
    def own_sigma(self) -> Array:
        """Standard deviations (N,) that the rows bring themselves; NaN where they do not."""
        column = schema.SIGMA[self.name]
        if column not in self.table:
            return np.full(len(self.index), np.nan)
        return np.asarray(self.table[column][self.index])

    def column(self, name: str) -> NDArray[Any]:
        """One column, of the target's rows."""
        return self.table[name][self.index]


@attrs.frozen(eq=False)
class _Part:
    """One measurement model with its columns of the scans."""

    model: MeasurementModel
    values: Array
    pairs: Index | None = None


def scans(recording: Recording, target: str) -> Scans:
    """Return the scans of `target`; see `Recording.scans`, which checks what it is given."""
    times, tables = _scan_times(recording, target)
    parts = [
        (_pair_part if "reference" in rows.table else _station_part)(recording, rows, times)
        for rows in tables
    ]
    models = [part.model for part in parts]
    measurement = models[0] if len(models) == 1 else registry.load("stack")(*models)
    values = np.concatenate([part.values for part in parts], axis=1)
    return Scans.checked(measurement, times, values, _all_pairs(parts, len(times)))


def _scan_times(recording: Recording, target: str) -> tuple[Array, list[_Rows]]:
    """Gather the rows of one emission, or of one time, into scans; return the scans' times (T,).

    A scan of an emission has the time of its earliest row. Differences join the first scan of
    exactly their time.
    """
    found = recording.measured
    tables = [(name, found[name]) for name in ORDER if name in found]
    index = {name: _of_target(recording, table, target) for name, table in tables}
    first: list[float] = []  # time of each scan, in the order in which they are found
    scan: dict[str, list[int]] = {}
    emissions: dict[str, int] = {}
    for name, table in tables:
        if "emission" in table:
            keys = table["emission"][index[name]].tolist()
            scan[name] = [emissions.setdefault(key, len(emissions)) for key in keys]
            first.extend([np.inf] * (len(emissions) - len(first)))
            for k, t in zip(scan[name], table["time_s"][index[name]].tolist(), strict=True):
                first[k] = min(first[k], t)
    at_time: dict[float, int] = {}
    for k, t in enumerate(first):
        at_time.setdefault(t, k)
    for name, table in tables:
        if "emission" not in table:
            scan[name] = []
            for t in table["time_s"][index[name]].tolist():
                if t not in at_time:
                    at_time[t] = len(first)
                    first.append(t)
                scan[name].append(at_time[t])
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    rows = [
        _Rows(name, table, i, table[schema.VALUE[name]][i], rank[scan[name]])
        for name, table, i in ((name, table, index[name]) for name, table in tables)
        if len(i)
    ]
    return np.array(first)[order], rows


def _of_target(recording: Recording, table: Table, target: str) -> Index:
    if not recording.labelled or "target" not in table:
        return np.arange(len(table))
    return np.flatnonzero(table["target"] == target)


def _station_part(recording: Recording, rows: _Rows, times: Array) -> _Part:
    """Arrival times, range rates (a column per station) or heights (one column)."""
    stations = recording.stations
    sigma = _row_sigma(recording.noise, rows)
    if rows.name == "height":
        column, width = np.zeros(len(rows.index), dtype=np.int64), 1
    else:
        number = {name: i for i, name in enumerate(stations.names)}
        column = np.array([number[n] for n in rows.column("station").tolist()], dtype=np.int64)
        width = len(stations)
    given = _sampled(sigma, rows, column, width, times)
    if rows.name == "toa":
        _refuse_coarse(rows, sigma)
        model = registry.load("toa")(stations, speed=recording.speed_mps, **given)
    elif rows.name == "range_rate":
        model = registry.load("range-rate")(stations, **given)
    else:
        model = registry.load("height")(frame=recording.frame, **given)
    return _Part(model, _spread(rows, column, width, len(times)))


def _pair_part(recording: Recording, rows: _Rows, times: Array) -> _Part:
    """Differences of arrival times or of range rates."""
    stations, noise = recording.stations, recording.noise
    number = {name: i for i, name in enumerate(stations.names)}
    ends = [[number[n] for n in rows.column(c).tolist()] for c in ("station", "reference")]
    pairs = np.array(ends, dtype=np.int64).T
    column, table = _pair_columns(pairs, rows.scan, len(times))
    time = rows.name == "tdoa"
    name, per_pair = ("tdoa", "tdoa_sigma") if time else ("fdoa", "difference_sigma")
    single, differenced = _pair_defaults(noise, time)
    if single is not None and differenced is None and np.isnan(rows.own_sigma).all():
        given = {"toa_sigma" if time else "range_rate_sigma": single}
    else:
        given = _sampled(_row_sigma(noise, rows), rows, column, table.shape[-2], times)
        given[per_pair] = given.pop("sigma")
    if time:
        given["speed"] = recording.speed_mps
    fixed = table.ndim == 2
    model = registry.load(name)(stations, pairs=table if fixed else table[0], **given)
    values = _spread(rows, column, table.shape[-2], len(times))
    return _Part(model, values, table)


def _pair_columns(pairs: Index, scan: Index, T: int) -> tuple[Index, Index]:
    """Return the column (N,) of each row and the pairs of the columns, (m, 2) or (T, m, 2).

    A column keeps its pair where that takes no more columns than the fullest scan has rows.
    """
    width = int(np.bincount(scan).max())
    columns: dict[tuple[int, int], int] = {}
    numbered = [columns.setdefault((a, b), len(columns)) for a, b in pairs.tolist()]
    if len(columns) == width:
        return np.array(numbered, dtype=np.int64), np.array(list(columns), dtype=np.int64)
    used = [0] * T
    table = np.tile(np.array([1, 0], dtype=np.int64), (T, width, 1))  # [1, 0] where NaN pads
    column = np.empty(len(scan), dtype=np.int64)
    for row, k in enumerate(scan.tolist()):
        column[row] = used[k]
        table[k, used[k]] = pairs[row]
        used[k] += 1
    return column, table


def _all_pairs(parts: list[_Part], T: int) -> Index | None:
    """Pairs (T, m, 2) of all parts that have pairs, in order; None where none of them changes."""
    tables = [part.pairs for part in parts if part.pairs is not None]
    if all(table.ndim == 2 for table in tables):
        return None
    return np.concatenate([np.broadcast_to(t, (T, *t.shape[-2:])) for t in tables], axis=1)


def _spread(rows: _Rows, column: Index, width: int, T: int) -> Array:
    values = np.full((T, width), np.nan)
    values[rows.scan, column] = rows.values
    return values


def _sampled(sigma: Array, rows: _Rows, column: Index, width: int, times: Array) -> dict[str, Any]:
    """Arguments of a model: one sigma where all rows have the same, else sampled (K, width)."""
    there = sigma[np.isfinite(rows.values)]
    if len(there) == 0 or np.all(there == there[0]):
        return {"sigma": float(there[0]) if len(there) else 1.0}
    stamps, of_scan = np.unique(times, return_inverse=True)
    table = np.full((len(stamps), width), -np.inf)
    np.maximum.at(table, (of_scan[rows.scan], column), np.where(np.isnan(sigma), -np.inf, sigma))
    return {"sigma": np.where(np.isinf(table), np.nan, table), "sigma_times": stamps}


def _row_sigma(noise: Noise, rows: _Rows) -> Array:
    """Standard deviation (N,) of each row: its own, or that of [noise], with floor and bias."""
    own = rows.own_sigma
    if rows.name in ("tdoa", "fdoa"):
        single, differenced = _pair_defaults(noise, rows.name == "tdoa")
        default = np.sqrt(2.0) * single if differenced is None and single else differenced
    elif rows.name == "toa":
        default = _effective(noise, noise.toa_sigma_s)
    else:
        default = noise.range_rate_sigma_mps if rows.name == "range_rate" else None
    if rows.name in ("tdoa", "toa"):
        own = _effective(noise, own)
    sigma = np.where(np.isnan(own), np.nan if default is None else default, own)
    lacking = np.isnan(sigma) & np.isfinite(rows.values)
    if np.any(lacking):
        row = int(rows.index[np.argmax(lacking)])
        keys = {
            "toa": "toa_sigma_s",
            "tdoa": "toa_sigma_s or tdoa_sigma_s",
            "range_rate": "range_rate_sigma_mps",
            "fdoa": "range_rate_sigma_mps",
        }
        why = f"[noise] has no {keys[rows.name]}" if rows.name in keys else "[noise] has none"
        raise ValueError(
            f"{rows.table.place(row, schema.SIGMA[rows.name])}: expected a standard deviation: "
            f"the row has none, and {why}"
        )
    return sigma


def _pair_defaults(noise: Noise, time: bool) -> tuple[Any, Any]:
    """Standard deviations that [noise] gives rows of differences: per station, per pair."""
    if time:
        return _effective(noise, noise.toa_sigma_s), _effective(noise, noise.tdoa_sigma_s)
    return noise.range_rate_sigma_mps, None


def _effective(noise: Noise, sigma: Any) -> Any:
    """Standard deviation of a time with its floor, and the lasting error in quadrature."""
    if sigma is None:
        return None
    sigma = np.maximum(sigma, noise.sigma_floor_s or 0.0)
    return np.hypot(sigma, noise.bias_sigma_s or 0.0)


def _refuse_coarse(rows: _Rows, sigma: Array) -> None:
    """Refuse arrival times so far from their zero that a double cannot hold them."""
    step = np.spacing(np.abs(np.where(np.isnan(rows.values), 0.0, rows.values)))
    coarse = step > COARSEST * np.where(np.isnan(sigma), np.inf, sigma)
    if np.any(coarse):
        k = int(np.argmax(coarse))
        raise ValueError(
            f"{rows.table.place(int(rows.index[k]), 'toa_s')}: at {float(rows.values[k])!r} s "
            f"numbers are held in steps of {float(step[k]):.2g} s, too coarse for a standard "
            f"deviation of {float(sigma[k]):.2g} s; count arrivals from a nearer zero (each "
            f"emission may have its own)"
        )
