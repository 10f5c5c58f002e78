"""From what stations take to the rows of the files: differences, clocks, lost rows."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import Array, Mask
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

    Row by row a `label` (m,) names what is drawn for it.
    """

    ends: dict[str, NDArray[np.str_]]
    labels: tuple[str, ...]
    time: Array
    rate: Array
    present: Mask


def measured(scenario: Scenario, target: Reception, streams: Streams) -> dict[str, Columns]:
    """Return the columns of each measured table of one target, its rows in order of time."""
    toa = scenario.sampling.rows == "toa"
    take = _arrivals if toa else _differences
    rows = _with_errors(scenario, target.name, take(scenario, target, streams), streams)
    emission = np.array([f"{target.name}-{k}" for k in target.number], dtype=str)
    start: Columns = {"time_s": target.times, **({"emission": emission} if toa else {})}

    def table(name: str, values: Array, digits: int) -> Columns:
        present = rows.present
        scan, _ = np.nonzero(present)
        return {
            **{key: column[scan] for key, column in start.items()},
            **{key: names[present] for key, names in rows.ends.items()},
            name: np.round(values[present], digits),
            "target": np.full(len(scan), target.name),
        }

    first, second = ("toa", "range_rate") if toa else ("tdoa", "fdoa")
    tables = {first: table(f"{first}_s", rows.time, ARRIVAL_DIGITS)}
    if scenario.sampling.range_rate:
        name = "range_rate_mps" if toa else "range_rate_difference_mps"
        tables[second] = table(name, rows.rate, RATE_DIGITS)
    if scenario.height is not None:
        received: Mask = np.any(rows.present, axis=1)
        tables["height"] = _heights(scenario, target, emission, received, streams)
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
        target.heard,
    )


def _differences(scenario: Scenario, target: Reception, streams: Streams) -> _Rows:
    """Differences, in which the emitter's clock cancels."""
    names, T = scenario.station_names, len(target.times)
    if scenario.sampling.rows == "tdoa-one-pair":
        every = np.array([(j, i) for i, j in combinations(range(len(names)), 2)], dtype=np.int64)
        drawn = streams.of("pair", target.name).integers(len(every), size=T)
        pairs, labels = every[drawn][:, None, :], ["pair"]
    else:
        kind = scenario.sampling.rows.removeprefix("tdoa-")
        fixed = pair_index(kind, len(names))
        labels = [f"{names[i]} - {names[j]}" for i, j in fixed]
        pairs = np.broadcast_to(fixed, (T, *fixed.shape))
    scan = np.arange(T)[:, None]
    station, reference = pairs[..., 0], pairs[..., 1]
    return _Rows(
        {"station": np.array(names)[station], "reference": np.array(names)[reference]},
        tuple(labels),
        difference(target.arrival, pairs),
        difference(target.rate, pairs),
        target.heard[scan, station] & target.heard[scan, reference],
    )


def _with_errors(scenario: Scenario, who: str, rows: _Rows, streams: Streams) -> _Rows:
    """Add the errors that single rows have, and lose some rows."""
    noise, outliers, T = scenario.noise, scenario.outliers, len(rows.time)
    size_s, size_mps = outlier_sizes(scenario)
    time, rate, present = rows.time.copy(), rows.rate.copy(), rows.present.copy()
    for i, label in enumerate(rows.labels):
        if noise.tdoa_sigma_s is not None:
            unit = streams.of("difference", who, label).standard_normal(T)
            time[:, i] += noise.tdoa_sigma_s * unit
        rng = streams.of("row outlier", who, label)
        time[:, i] += gross(rng, T, outliers.row, size_s, outliers.late)
        rng = streams.of("row rate outlier", who, label)
        rate[:, i] += gross(rng, T, outliers.row, size_mps, False)
        rng = streams.of("row dropout", who, label)
        present[:, i] &= rng.random(T) >= scenario.dropouts.row
    return rows._replace(time=time, rate=rate, present=present)


def _heights(
    scenario: Scenario,
    target: Reception,
    emission: NDArray[np.str_],
    received: Mask,
    streams: Streams,
) -> Columns:
    """Heights that the emitter reports, where the emission was `received` (T,) at all."""
    assert scenario.height is not None
    frame, sigma = scenario.frame.axes(), scenario.height.sigma_m
    position = target.truth.position
    height = position[:, 2] if frame is None else frame.height(position)[0]
    noisy = height + sigma * streams.of("height", target.name).standard_normal(len(height))
    count = int(np.count_nonzero(received))
    return {
        "time_s": target.times[received],
        "emission": emission[received],
        "height_m": np.round(noisy[received], HEIGHT_DIGITS),
        "sigma_m": np.full(count, sigma),
        "target": np.full(count, target.name),
    }
