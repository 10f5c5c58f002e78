"""False alarms: rows that are no emitter's."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.simulate.errors import silent
from imm_tdoa.simulate.reception import TIME_DIGITS, Schedule, scan_times, station_paths
from imm_tdoa.simulate.rows import Columns, paired
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.streams import Streams

NOBODY = ""  # the target of a false alarm


def false_alarms(scenario: Scenario, plan: Schedule, streams: Streams) -> Columns:
    """Return the false alarms of all scans as columns (N,), those of `rows.measured`."""
    take = _arrivals if scenario.sampling.rows == "toa" else _differences
    return take(scenario, plan, streams)


def _arrivals(scenario: Scenario, plan: Schedule, streams: Streams) -> Columns:
    """False arrival times, each an emission of its own at a moment of its own."""
    assert scenario.clutter.window_s is not None
    low, high = scenario.clutter.window_s
    parts = []
    for name in scenario.station_names:
        rates = np.full(len(plan.times), scenario.clutter.of(name))
        scan, value, rate = _drawn(scenario, streams, name, rates)
        late = streams.of("false moment", name).random(len(scan)) * scenario.sampling.jitter_s
        times = np.round(plan.times[scan] + late, TIME_DIGITS)
        columns: Columns = {
            "scan": scan,
            "time_s": times,
            "emission": np.array([f"\x1f{name}-{i}" for i in range(len(scan))], dtype=str),
            "station": np.full(len(scan), name),
            "value": low + (high - low) * value,
            "rate": rate,
        }
        parts.append(_kept(columns, ~silent(scenario.dropouts, name, times)))
    return _joined(parts)


def _differences(scenario: Scenario, plan: Schedule, streams: Streams) -> Columns:
    """False differences, at the moments of the scans."""
    times = scan_times(scenario, plan, streams, NOBODY)
    number = np.arange(len(times))
    pairs, labels = paired(scenario, streams, NOBODY, number)
    reach, awake = _reach(scenario, times), _awake(scenario, times)
    names = np.array(scenario.station_names)
    parts = []
    for i, label in enumerate(labels):
        station, reference = pairs[:, i, 0], pairs[:, i, 1]
        rates = np.array([scenario.clutter.of(name) for name in names])[station]
        scan, value, rate = _drawn(scenario, streams, label, rates)
        station, reference = station[scan], reference[scan]
        if scenario.clutter.window_s is not None:
            low, high = (np.full(len(scan), end) for end in scenario.clutter.window_s)
        else:
            high = reach[scan, station, reference]
            low = -high
        columns: Columns = {
            "scan": scan,
            "time_s": times[scan],
            "station": names[station],
            "reference": names[reference],
            "value": low + (high - low) * value,
            "rate": rate,
        }
        parts.append(_kept(columns, awake[scan, station] & awake[scan, reference]))
    return _joined(parts)


def _drawn(
    scenario: Scenario, streams: Streams, label: str, rates: Array
) -> tuple[Index, Array, Array]:
    """Draw scans, values within their window as parts of it, and range rates, (N,) each.

    Of each stream one number is for one scan or false alarm: more scans change nothing in those
    before.
    """
    count = streams.of("false alarms", label).poisson(rates)
    scan = np.repeat(np.arange(len(rates)), count)
    value = streams.of("false value", label).random(len(scan))
    low, high = scenario.clutter.range_rate_window_mps or (0.0, 0.0)
    rate = low + (high - low) * streams.of("false rate", label).random(len(scan))
    return scan, value, rate


def _reach(scenario: Scenario, times: Array) -> Array:
    """Return what the signal takes between two stations (K, S, S) at `times` (K,), s."""
    place, _ = station_paths(scenario, times)
    apart = place[:, :, None] - place[:, None, :]
    result: Array = np.linalg.norm(apart, axis=-1) / scenario.speed_mps
    return result


def _awake(scenario: Scenario, times: Array) -> Mask:
    """Return which stations (K, S) are not silent at `times` (K,)."""
    quiet = [silent(scenario.dropouts, name, times) for name in scenario.station_names]
    return ~np.stack(quiet, axis=-1)


def _kept(columns: Columns, keep: Mask) -> Columns:
    return {name: column[keep] for name, column in columns.items()}


def _joined(parts: list[Columns]) -> Columns:
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    count = len(columns["scan"])
    return {**columns, "moment": np.full(count, np.nan), "target": np.full(count, NOBODY)}
