"""From a scenario to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imm_tdoa.contract import AXES
from imm_tdoa.recording import Noise, Recording, Table
from imm_tdoa.simulate.reception import Reception, receive, schedule, station_paths
from imm_tdoa.simulate.rows import Columns, measured
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.streams import Seed, Streams
from imm_tdoa.stations import Stations

# Digits kept here and in the rows are far below any noise: they make the same scenario give the
# same text on every machine.
PLACE_DIGITS, SPEED_DIGITS = 4, 6


def simulate(scenario: Scenario, seed: Seed | None = None) -> Recording:
    """Return the recording that a scenario gives.

    Random numbers come from one stream per target, station and kind of error, found by name:
    another target, station or kind of error changes nothing in those that were there (but for
    which pairs are drawn one at a time, where stations come in). The same seed gives arrival
    times and differences with the same errors, whichever rows are asked for.

    Parameters
    ----------
    scenario : Scenario
        Stations, targets, errors.
    seed : int, SeedSequence or Generator, optional
        Where random numbers come from; without it the scenario's own seed, which is 0 where it
        does not say. A Generator is drawn from once.

    Returns
    -------
    Recording
        With the truth, positions and velocities, at every scan, received or not.

    Raises
    ------
    ValueError
        No scenario, a seed that is none, or a scenario in which nothing at all is received.
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario: expected a Scenario (see simulate.load), got {scenario!r}")
    seed = scenario.seed if seed is None else seed
    streams = Streams.from_seed(seed)
    plan = schedule(scenario, streams)
    targets = [receive(scenario, target, plan, streams) for target in scenario.targets]
    parts: dict[str, list[Columns]] = {}
    for target in targets:
        for name, columns in measured(scenario, target, streams).items():
            parts.setdefault(name, []).append(columns)
    tables = {name: _table(columns) for name, columns in parts.items()}
    if not any(len(table) for table in tables.values()):
        raise ValueError(f"scenario: of {scenario.title!r} no station receives anything")
    source: dict[str, Any] = {"made_by": "imm_tdoa.simulate"}
    if isinstance(seed, int | np.integer):
        source["seed"] = int(seed)
    return Recording(
        _stations(scenario, targets),
        title=scenario.title,
        speed_mps=scenario.speed_mps,
        frame=scenario.frame.axes(),
        noise=_noise(scenario),
        truth=_table([_truth(target) for target in targets]),
        source=source,
        notes={"text": scenario.notes} if scenario.notes else {},
        **tables,  # type: ignore[arg-type]
    )


def _truth(target: Reception) -> Columns:
    position, velocity, _ = target.truth
    axes = AXES[: position.shape[1]]
    return {
        "time_s": target.times,
        "target": np.full(len(target.times), target.name),
        **{f"{a}_m": np.round(position[:, i], PLACE_DIGITS) for i, a in enumerate(axes)},
        **{f"v{a}_mps": np.round(velocity[:, i], SPEED_DIGITS) for i, a in enumerate(axes)},
    }


def _table(parts: Sequence[Columns]) -> Table:
    """Join the targets' rows in order of time."""
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(columns["time_s"], kind="stable")
    # + 0.0 turns the -0.0 that rounding leaves into a plain zero
    return Table(
        {n: c[order] + 0.0 if c.dtype.kind == "f" else c[order] for n, c in columns.items()}
    )


def _stations(scenario: Scenario, targets: Sequence[Reception]) -> Stations:
    """Return the stations, sampled at every scan where one of them moves."""
    names = tuple(s.name for s in scenario.stations)
    if not any(s.moving for s in scenario.stations):
        return Stations(np.array([s.position_m for s in scenario.stations]), names=names)
    times = np.unique(np.concatenate([target.times for target in targets]))
    place, speed = station_paths(scenario, times)
    return Stations(
        np.round(place, PLACE_DIGITS) + 0.0,
        velocities=np.round(speed, SPEED_DIGITS) + 0.0,
        times=times,
        names=names,
    )


def _noise(scenario: Scenario) -> Noise:
    noise = scenario.noise
    rate = noise.range_rate_sigma_mps if scenario.sampling.range_rate else None
    return Noise(
        toa_sigma_s=noise.toa_sigma_s,
        tdoa_sigma_s=noise.tdoa_sigma_s,
        range_rate_sigma_mps=rate,
        bias_sigma_s=noise.bias_sigma_s,
        bias_time_s=noise.bias_time_s,
    )
