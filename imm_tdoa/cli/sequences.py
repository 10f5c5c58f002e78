"""A fix per scan of a recording from filtered sequences of time differences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa.cli import output
from imm_tdoa.cli.fixes import Fixes
from imm_tdoa.contract import Array, Index
from imm_tdoa.locate import Fix
from imm_tdoa.recording import Recording
from imm_tdoa.scans import Scans
from imm_tdoa.sequence_filter import FilteredSequence, SequenceFilter
from imm_tdoa.stations import Stations

OPTION = "--sequence-filter"
SETTINGS: dict[str, Any] = {"rule": "iso", "multiplier": "auto", "gate": 3.0}


@attrs.frozen(eq=False)
class Adjacent:
    """Time differences (T, m) of adjacent stations, s, and what `SequenceFilter` is made with."""

    stations: Stations
    tdoa: Array
    noise: dict[str, Any]


def filtered_fixes(recording: Recording, target: str) -> tuple[Fixes, FilteredSequence]:
    """Filter the sequences of `target` and locate every scan from them.

    Arrival times are differenced between stations that follow each other in stations.csv, those
    left out that never heard the target; differences of tdoa.csv are taken as they are where they
    join the stations to one chain, or, with one standard deviation for all arrivals, where they
    have one reference.

    Raises
    ------
    ValueError
        No time differences, differences that cannot be arranged so, no scan with enough of them.
    """
    if recording.toa is None and recording.tdoa is None:
        raise ValueError(f"{OPTION}: the recording has no time differences of arrival")
    alone = attrs.evolve(recording, range_rate=None, fdoa=None, height=None)
    if recording.toa is not None:
        alone = attrs.evolve(alone, tdoa=None)
    scans = alone.scans(target)
    adjacent = _of_arrivals(scans) if _has_arrivals(scans) else _of_differences(scans)
    d = recording.dims
    most = int(np.max(np.count_nonzero(np.isfinite(adjacent.tdoa), axis=-1), initial=0))
    if most < d:
        raise ValueError(
            f"{OPTION}: no scan of target {target!r} has {d} differences of stations next to each "
            f"other in stations.csv, the fullest {most}; locate without it takes any stations"
        )
    stage = SequenceFilter(
        adjacent.stations, speed=recording.speed_mps, **adjacent.noise, **SETTINGS
    )
    result = stage.run(scans.times, adjacent.tdoa)
    good = np.asarray(np.isfinite(result.position).all(axis=-1))
    rows = np.count_nonzero(result.measured, axis=-1)
    fix = Fix(
        position=result.position,
        velocity=None,
        covariance=result.covariance,
        converged=good,
        iterations=np.zeros(len(good), dtype=np.int64),
        chi2=np.full(len(good), np.nan),
        dof=np.maximum(rows - d, 0),
    )
    return Fixes(scans.times, fix), result


def facts(recording: Recording, target: str, result: FilteredSequence) -> dict[str, Any]:
    """Return what the summary says of a target's filter; errors are those without it."""
    running = result.measured & (result.gain < 1.0)
    true, _ = recording.truth_at(target, result.times)
    axes = recording.truth_scoring.axes or ("x", "y", "z")
    i = [k for k, axis in enumerate("xyz"[: recording.dims]) if axis in axes]
    error = np.linalg.norm((result.raw_position - true)[:, i], axis=-1)
    error = error[np.isfinite(error)]
    quartiles = [float(q) for q in np.quantile(error, [0.25, 0.5, 0.75])] if len(error) else None
    return {
        "differences": int(np.count_nonzero(result.measured)),
        "gate_failures": int(np.count_nonzero(result.gated)),
        "median_gain": float(np.median(result.gain[running])) if np.any(running) else None,
        "unfiltered_position_error_quartiles_m": quartiles,
    }


def notes(targets: Mapping[str, Mapping[str, Any]], shown: int) -> list[str]:
    """Return what is printed of the filters of up to `shown` targets."""
    lines = []
    for name, found in list(targets.items())[:shown]:
        failures = found["gate_failures"] / max(found["differences"], 1)
        line = f"{name}: gate failed at {failures:.1%} of the differences"
        if found["median_gain"] is not None:
            line += f", median gain {output.number(found['median_gain'])}"
        quartiles = found["unfiltered_position_error_quartiles_m"]
        if quartiles is not None:
            line += ", error without the filter " + " / ".join(map(output.number, quartiles)) + " m"
        lines.append(line)
    return lines


def _has_arrivals(scans: Scans) -> bool:
    return isinstance(scans.measurement, registry.load("toa"))


def _of_arrivals(scans: Scans) -> Adjacent:
    measurement: Any = scans.measurement
    noise = {"toa_sigma": measurement.sigma, "sigma_times": measurement.sigma_times}
    return _differenced(measurement.stations, scans.values, noise)


def _differenced(stations: Stations, arrival: Array, noise: dict[str, Any]) -> Adjacent:
    """Difference arrivals (T, S) between stations that follow each other, of those that heard."""
    some = np.flatnonzero(np.isfinite(arrival).any(axis=0))
    arrival = arrival[:, some]
    sigma = np.asarray(noise["toa_sigma"])
    if sigma.ndim and sigma.shape[-1] == len(stations):
        noise = {**noise, "toa_sigma": sigma[..., some]}
    return Adjacent(arranged(stations, some), arrival[:, :-1] - arrival[:, 1:], noise)


def _of_differences(scans: Scans) -> Adjacent:
    measurement: Any = scans.measurement
    if scans.pairs is not None:
        raise ValueError(
            f"{OPTION}: expected differences of the same pairs of stations in every scan, they "
            f"change; locate without it takes any"
        )
    pairs, stations = np.asarray(measurement.pairs), measurement.stations
    per_arrival = measurement.toa_sigma is not None
    star = np.all(pairs[:, 1] == pairs[0, 1]) and len(np.unique(pairs[:, 0])) == len(pairs)
    if per_arrival and star:
        arrival = np.full((scans.count, len(stations)), np.nan)
        arrival[:, pairs[:, 0]] = scans.values
        arrival[:, pairs[0, 1]] = 0.0
        return _differenced(stations, arrival, {"toa_sigma": measurement.toa_sigma})
    order, row, sign = _chain(pairs)
    noise: dict[str, Any] = {"sigma_times": measurement.sigma_times}
    if per_arrival:
        noise["toa_sigma"] = measurement.toa_sigma
    else:
        sigma = np.asarray(measurement.tdoa_sigma)
        noise["tdoa_sigma"] = sigma[..., row] if sigma.ndim else sigma
    return Adjacent(arranged(stations, order), sign * scans.values[:, row], noise)


def _chain(pairs: Index) -> tuple[Index, Index, Array]:
    """Arrange pairs (m, 2) to one chain of stations.

    Returns the stations (m + 1,) along it, the pair (m,) between each and the next, and +1 where
    that pair is [station, next], -1 where it is the other way round.
    """
    links: dict[int, list[int]] = {}
    for k, ends in enumerate(pairs.tolist()):
        for end in ends:
            links.setdefault(end, []).append(k)
    tips = [s for s, rows in links.items() if len(rows) == 1]
    order, rows = [min(tips, default=-1)], list[int]()
    while tips and len(rows) < len(pairs):
        onward = [k for k in links[order[-1]] if k not in rows]
        if len(onward) != 1:
            break
        rows.append(onward[0])
        order.append(int(pairs[onward[0]].sum()) - order[-1])
    if len(rows) != len(pairs) or len(tips) != 2 or len(set(order)) != len(order):
        raise ValueError(
            f"{OPTION}: expected pairs that join the stations to one chain (a-b, b-c, c-d), or "
            f"differences against one reference with toa_sigma_s alone"
        )
    row = np.array(rows, dtype=np.int64)
    along = np.array(order, dtype=np.int64)
    return along, row, np.where(pairs[row, 0] == along[:-1], 1.0, -1.0)


def arranged(stations: Stations, order: Index) -> Stations:
    """Return some of the stations in another order."""

    def some(value: Array | None, axis: int) -> Array | None:
        return None if value is None else np.take(value, order, axis=axis)

    return Stations(
        np.take(stations.positions, order, axis=-2),
        velocities=some(stations.velocities, -2),
        times=stations.times,
        position_covariance=some(stations.position_covariance, 0),
        velocity_covariance=some(stations.velocity_covariance, 0),
        names=tuple(stations.names[i] for i in order),
    )
