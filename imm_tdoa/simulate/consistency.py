"""Whether the parts of a scenario go together; messages start with the place in the file."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from imm_tdoa.recording.schema import known

if TYPE_CHECKING:
    from imm_tdoa.simulate.scenario import Scenario

_PLACES = ("position_m", "passes_m", "low_m")


def check(scenario: Scenario) -> None:
    """Refuse a scenario whose parts do not go together."""
    if len(scenario.stations) < 2:
        raise ValueError(f"stations: expected at least two, got {len(scenario.stations)}")
    if not scenario.targets and not scenario.swarms:
        raise ValueError("targets: expected at least one, got none")
    for part in (
        _check_dims,
        _check_names,
        _check_apart,
        _check_known,
        _check_measured,
        _check_labels,
    ):
        part(scenario)


def _check_dims(scenario: Scenario) -> None:
    for kind in ("stations", "targets", "swarms"):
        for i, item in enumerate(getattr(scenario, kind)):
            key = next(k for k in _PLACES if getattr(item, k, None) is not None)
            d, given = scenario.dims, len(getattr(item, key))
            if given != d:
                raise ValueError(
                    f"{kind}[{i}].{key}: expected {d} numbers (dims = {d}), got {given}"
                )


def _check_names(scenario: Scenario) -> None:
    for kind in ("stations", "targets"):
        names: list[str] = []
        for i, item in enumerate(getattr(scenario, kind)):
            if item.name in names:
                raise ValueError(f"{kind}[{i}].name: {item.name!r} appears twice")
            names.append(item.name)
    taken = {target.name for target in scenario.targets}
    for i, swarm in enumerate(scenario.swarms):
        twice = [name for name in swarm.names if name in taken]
        if twice:
            raise ValueError(f"swarms[{i}].name: {twice[0]!r} appears twice")
        taken.update(swarm.names)


def _check_apart(scenario: Scenario) -> None:
    fixed = sorted((s.position_m, i) for i, s in enumerate(scenario.stations) if not s.moving)
    for (a, i), (b, j) in pairwise(fixed):
        if a == b:
            raise ValueError(
                f"stations[{j}].position_m: the same as that of {scenario.stations[i].name!r}; "
                f"expected stations apart from each other"
            )


def _check_known(scenario: Scenario) -> None:
    silences = scenario.dropouts.silences
    places = [
        *((f"dropouts.station.{n}", n) for n in scenario.dropouts.station),
        *((f"outliers.station.{n}", n) for n in scenario.outliers.station),
        *((f"detection.station.{n}", n) for n in scenario.detection.station),
        *((f"clutter.station.{n}", n) for n in scenario.clutter.station),
        *((f"dropouts.silences[{i}].station", s.station) for i, s in enumerate(silences)),
    ]
    for place, station in places:
        if station not in scenario.station_names:
            raise ValueError(
                f"{place}: there is no station {station!r}; there are: "
                f"{', '.join(scenario.station_names)}"
            )
    for key in ("detection", "clutter"):
        for station in getattr(scenario, key).station:
            if station in _only_references(scenario):
                raise ValueError(
                    f"{key}.station.{station}: the difference of a pair is its station's, "
                    f"and with sampling.rows = {scenario.sampling.rows!r} {station!r} is only "
                    f"ever a reference"
                )
    names = [target.name for target in scenario.emitters]
    for name in scenario.detection.target:
        if name not in names:
            raise ValueError(
                f"detection.target.{name}: there is no target {name!r}; there are: {known(names)}"
            )


def _only_references(scenario: Scenario) -> tuple[str, ...]:
    """Stations that are references of differences and nothing else."""
    names, rows = scenario.station_names, scenario.sampling.rows
    return () if rows == "toa" else names[-1:] if rows == "tdoa-adjacent" else names[:1]


def _check_measured(scenario: Scenario) -> None:
    noise, sampling = scenario.noise, scenario.sampling
    if sampling.rows == "toa" and noise.toa_sigma_s is None:
        raise ValueError("noise.toa_sigma_s: missing, where sampling.rows = 'toa'")
    if sampling.range_rate and noise.range_rate_sigma_mps is None:
        raise ValueError("noise.range_rate_sigma_mps: missing, where sampling.range_rate = true")
    if scenario.height is not None and scenario.dims != 3:
        raise ValueError("height: a height needs dims = 3")
    if scenario.end_s < sampling.start_s:
        raise ValueError(
            f"sampling.start_s: expected a time before the last target ends, "
            f"{scenario.end_s:g} s, got {sampling.start_s:g}"
        )


def _check_labels(scenario: Scenario) -> None:
    clutter, sampling = scenario.clutter, scenario.sampling
    if scenario.labelled and clutter.present:
        raise ValueError(
            "clutter: a false alarm is nobody's and can have no label; it needs labelled = false"
        )
    if scenario.labelled and sampling.resolution_s is not None:
        raise ValueError(
            "sampling.resolution_s: a row of two emitters can have no label; it needs "
            "labelled = false"
        )
    if clutter.present and sampling.rows == "toa" and clutter.window_s is None:
        raise ValueError("clutter.window_s: missing, where sampling.rows = 'toa'")
    if clutter.present and sampling.range_rate and clutter.range_rate_window_mps is None:
        raise ValueError("clutter.range_rate_window_mps: missing, where sampling.range_rate = true")
    if clutter.range_rate_window_mps is not None and not sampling.range_rate:
        raise ValueError("clutter.range_rate_window_mps: only where sampling.range_rate = true")
