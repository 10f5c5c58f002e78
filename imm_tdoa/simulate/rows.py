"""From what stations take to the rows of the files: differences, clocks, lost rows."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.geometry import difference
from imm_tdoa.simulate.errors import clock_offsets, gross
from imm_tdoa.simulate.reception import Reception, outlier_sizes
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.streams import Streams
from imm_tdoa.stations import pair_index

ARRIVAL_DIGITS, RATE_DIGITS, HEIGHT_DIGITS = 13, 6, 4

Columns = dict[str, Any]


class _Rows(NamedTuple):
    """The rows (T, m) of one target: their ends, their values, and whether they are there.

    Row by row a `label` (m,) names what is drawn for it. To `time` comes `shift` (T,) to make it
    a moment of the scan, comparable between targets.
    """

    ends: dict[str, NDArray[np.str_]]
    labels: tuple[str, ...]
    time: Array
    rate: Array
    shift: Array
    present: Mask


def measured(scenario: Scenario, target: Reception, streams: Streams) -> Columns:
    """Return the rows of one target as columns (N,), in order of time.

    They are those of the files, ``time_s``, ``emission`` (of arrival times), ``station`` and
    ``reference``, ``target``; and ``scan``, its number; ``value`` and ``rate``, time and range
    rate; ``moment`` of the value in the scan, by which rows that fall together are found.
    """
    toa = scenario.sampling.rows == "toa"
    take = _arrivals if toa else _differences
    rows = _with_errors(scenario, target.name, take(scenario, target, streams), streams)
    present = rows.present
    scan, _ = np.nonzero(present)
    emission = {"emission": emissions(target)[scan]} if toa else {}
    return {
        "scan": target.number[scan],
        "time_s": target.times[scan],
        **emission,
        **{key: names[present] for key, names in rows.ends.items()},
        "value": rows.time[present],
        "rate": rows.rate[present],
        "moment": (rows.time + rows.shift[:, None])[present],
        "target": np.full(len(scan), target.name),
    }


def emissions(target: Reception) -> NDArray[np.str_]:
    """Return the names (T,) of a target's emissions."""
    return np.array([f"{target.name}-{k}" for k in target.number], dtype=str)


def written(scenario: Scenario, rows: Columns) -> dict[str, Columns]:
    """Return the columns of the measured tables that `rows` make, rounded."""
    toa = scenario.sampling.rows == "toa"
    first, second = ("toa", "range_rate") if toa else ("tdoa", "fdoa")
    start = [key for key in ("time_s", "emission", "station", "reference") if key in rows]

    def table(name: str, key: str, digits: int) -> Columns:
        return {
            **{k: rows[k] for k in start},
            name: np.round(rows[key], digits),
            **({"target": rows["target"]} if scenario.labelled else {}),
        }

    tables = {first: table(f"{first}_s", "value", ARRIVAL_DIGITS)}
    if scenario.sampling.range_rate:
        name = "range_rate_mps" if toa else "range_rate_difference_mps"
        tables[second] = table(name, "rate", RATE_DIGITS)
    return tables


def _arrivals(scenario: Scenario, target: Reception, streams: Streams) -> _Rows:
    """Arrival times and range rates, of clocks that nobody knows."""
    elapsed = target.times - scenario.sampling.start_s
    offset, rate_offset = clock_offsets(scenario.clock, streams, target.name, elapsed)
    names = scenario.station_names
    return _Rows(
        {"station": np.broadcast_to(np.array(names), target.arrival.shape)},
        names,
        target.arrival + offset[:, None],
        target.rate + rate_offset[:, None],
        target.late - offset,
        target.heard,
    )


def _differences(scenario: Scenario, target: Reception, streams: Streams) -> _Rows:
    """Differences, in which the emitter's clock cancels."""
    names = scenario.station_names
    pairs, labels = paired(scenario, streams, target.name, target.number)
    scan = np.arange(len(target.times))[:, None]
    station, reference = pairs[..., 0], pairs[..., 1]
    return _Rows(
        {"station": np.array(names)[station], "reference": np.array(names)[reference]},
        labels,
        difference(target.arrival, pairs),
        difference(target.rate, pairs),
        np.zeros(len(target.times)),
        target.heard[scan, station] & target.heard[scan, reference],
    )


def paired(
    scenario: Scenario, streams: Streams, who: str, number: Index
) -> tuple[Index, tuple[str, ...]]:
    """Return the pairs (T, m, 2) of a target's scans of these numbers (T,), and their labels."""
    names = scenario.station_names
    if scenario.sampling.rows != "tdoa-one-pair":
        fixed = pair_index(scenario.sampling.rows.removeprefix("tdoa-"), len(names))
        labels = tuple(f"{names[i]} - {names[j]}" for i, j in fixed)
        return np.broadcast_to(fixed, (len(number), *fixed.shape)), labels
    every = np.array([(j, i) for i, j in combinations(range(len(names)), 2)], dtype=np.int64)
    if scenario.common_scans:
        drawn = streams.of("pair").integers(len(every), size=int(number.max(initial=-1)) + 1)
        drawn = drawn[number]
    else:
        drawn = streams.of("pair", who).integers(len(every), size=len(number))
    return every[drawn][:, None, :], ("pair",)


def _with_errors(scenario: Scenario, who: str, rows: _Rows, streams: Streams) -> _Rows:
    """Add the errors that single rows have; lose some rows, undetected or later."""
    noise, outliers, T = scenario.noise, scenario.outliers, len(rows.time)
    stations = rows.ends["station"]
    likely = {name: scenario.detection.of(name, who) for name in scenario.station_names}
    size_s, size_mps = outlier_sizes(scenario)
    time, rate, present = rows.time.copy(), rows.rate.copy(), rows.present.copy()
    for i, label in enumerate(rows.labels):
        if noise.tdoa_sigma_s is not None:
            unit = streams.of("difference", who, label).standard_normal(T)
            time[:, i] += noise.tdoa_sigma_s * unit
        if outliers.row > 0.0:
            rng = streams.of("row outlier", who, label)
            time[:, i] += gross(rng, T, outliers.row, size_s, outliers.late)
            rng = streams.of("row rate outlier", who, label)
            rate[:, i] += gross(rng, T, outliers.row, size_mps, False)
        if scenario.dropouts.row > 0.0:
            rng = streams.of("row dropout", who, label)
            present[:, i] &= rng.random(T) >= scenario.dropouts.row
        p = np.array([likely[station] for station in stations[:, i].tolist()])
        if np.any(p < 1.0):
            present[:, i] &= streams.of("detection", who, label).random(T) < p
    return rows._replace(time=time, rate=rate, present=present)


def heights(scenario: Scenario, target: Reception, rows: Columns, streams: Streams) -> Columns:
    """Heights that the emitter reports, where an emission has any of its `rows`."""
    assert scenario.height is not None
    received = np.isin(target.number, rows["scan"])
    frame, sigma = scenario.frame.axes(), scenario.height.sigma_m
    position = target.truth.position
    height = position[:, 2] if frame is None else frame.height(position)[0]
    noisy = height + sigma * streams.of("height", target.name).standard_normal(len(height))
    count = int(np.count_nonzero(received))
    return {
        "time_s": target.times[received],
        "emission": emissions(target)[received],
        "height_m": np.round(noisy[received], HEIGHT_DIGITS),
        "sigma_m": np.full(count, sigma),
        "target": np.full(count, target.name),
    }
