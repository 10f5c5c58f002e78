"""From a scenario to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa._brief import brief
from imm_tdoa.contract import AXES
from imm_tdoa.recording import Noise, Recording, Table
from imm_tdoa.recording.schema import MEASURED
from imm_tdoa.simulate.clutter import NOBODY, false_alarms
from imm_tdoa.simulate.reception import Reception, Schedule, receive, schedule, station_paths
from imm_tdoa.simulate.rows import Columns, heights, measured, written
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.streams import Seed, Streams
from imm_tdoa.simulate.unlabelled import AND, merged, renamed, shuffled
from imm_tdoa.stations import Stations

# Digits kept here and in the rows are far below any noise: they make the same scenario give the
# same text on every machine.
PLACE_DIGITS, SPEED_DIGITS = 4, 6


Origins = dict[str, tuple[tuple[str, ...], ...]]


@attrs.frozen(eq=False)
class Simulated:
    """A recording, and what it does not say: whose rows they are.

    Attributes
    ----------
    recording : Recording
        As `simulate` gives it.
    origins : dict
        By table of measurements, for each of its rows the names of the targets it is of: one;
        none of a false alarm; several where rows fell together.
    """

    recording: Recording
    origins: Origins

    __repr__ = brief

    def told_apart(self) -> Recording:
        """Return the labelled recording of those rows that are of just one target."""
        tables: dict[str, Any] = dict.fromkeys((*MEASURED, "height"))
        for name, table in self.recording.measured.items():
            who = self.origins[name]
            keep = [len(names) == 1 for names in who]
            if any(keep):
                columns = {key: table[key][keep] for key in table}
                target = [names[0] for names in who if len(names) == 1]
                tables[name] = Table({**columns, "target": target})
        return attrs.evolve(self.recording, labelled=True, **tables)


def simulate(scenario: Scenario, seed: Seed | None = None) -> Recording:
    """Return the recording that a scenario gives.

    Random numbers come from one stream per target, station and kind of error, found by name:
    another target, station or kind of error, or false alarms, change nothing in those rows that
    were there (but for which pairs are drawn one at a time, where stations come in, and for rows
    that fall together). The same seed gives arrival times and differences with the same errors,
    whichever rows are asked for.

    Where ``labelled = false`` rows have no target; their order and the numbers of their emissions
    follow from what was measured. The truth keeps its targets. False alarms among arrival times
    are emissions of their own that one station hears. Range-rate differences stand in a table of
    their own, and nothing says with which time differences they were measured.

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
    return simulate_labelled(scenario, seed).recording


def simulate_labelled(scenario: Scenario, seed: Seed | None = None) -> Simulated:
    """Return the recording that `simulate` makes, and for each of its rows whose it is.

    Parameters
    ----------
    scenario, seed
        As for `simulate`.

    Raises
    ------
    ValueError
        As `simulate`.

    >>> from imm_tdoa.simulate import load
    >>> made = simulate_labelled(load("three-emitters"), seed=1)
    >>> len(made.recording.tdoa) == len(made.origins["tdoa"])
    True
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario: expected a Scenario (see simulate.load), got {scenario!r}")
    seed = scenario.seed if seed is None else seed
    streams = Streams.from_seed(seed)
    plan = schedule(scenario, streams)
    targets = [receive(scenario, target, plan, streams) for target in scenario.emitters]
    tables, origins = _tables(scenario, plan, targets, streams)
    if not any(len(table) for table in tables.values()):
        raise ValueError(f"scenario: of {scenario.title!r} no station receives anything")
    source: dict[str, Any] = {"made_by": "imm_tdoa.simulate"}
    if isinstance(seed, int | np.integer):
        source["seed"] = int(seed)
    recording = Recording(
        _stations(scenario, targets),
        title=scenario.title,
        speed_mps=scenario.speed_mps,
        labelled=scenario.labelled,
        frame=scenario.frame.axes(),
        noise=_noise(scenario),
        truth=_table(_sorted(_joined([_truth(target) for target in targets]))),
        source=source,
        notes={"text": scenario.notes} if scenario.notes else {},
        **tables,  # type: ignore[arg-type]
    )
    return Simulated(recording, origins)


def _tables(
    scenario: Scenario, plan: Schedule, targets: Sequence[Reception], streams: Streams
) -> tuple[dict[str, Table], Origins]:
    """Return the tables of measurements, and the origins of their rows."""
    parts = [measured(scenario, target, streams) for target in targets]
    height: Columns = {}
    if scenario.height is not None:
        both = zip(targets, parts, strict=True)
        height = _joined([heights(scenario, target, part, streams) for target, part in both])
    if scenario.labelled:
        rows = _sorted(_joined(parts))
        height = _sorted(height) if height else {}
    else:
        if scenario.clutter.present:
            parts.append(false_alarms(scenario, plan, streams))
        rows, emissions = shuffled(scenario, merged(scenario, _joined(parts)))
        height = renamed(height, emissions) if height else {}
    tables = written(scenario, rows)
    who: dict[str, Any] = dict.fromkeys(tables, rows["target"])
    if height:
        who["height"] = height["target"]
        tables["height"] = {k: v for k, v in height.items() if scenario.labelled or k != "target"}
    origins = {name: _origins(column.tolist()) for name, column in who.items() if len(column)}
    return {name: _table(tables[name]) for name in origins}, origins


def _origins(names: list[str]) -> tuple[tuple[str, ...], ...]:
    return tuple(() if name == NOBODY else tuple(name.split(AND)) for name in names)


def _truth(target: Reception) -> Columns:
    position, velocity, _ = target.truth
    axes = AXES[: position.shape[1]]
    return {
        "time_s": target.times,
        "target": np.full(len(target.times), target.name),
        **{f"{a}_m": np.round(position[:, i], PLACE_DIGITS) for i, a in enumerate(axes)},
        **{f"v{a}_mps": np.round(velocity[:, i], SPEED_DIGITS) for i, a in enumerate(axes)},
    }


def _joined(parts: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _sorted(columns: Columns) -> Columns:
    """Put the targets' rows, one target after the other, in order of time."""
    order = np.argsort(columns["time_s"], kind="stable")
    return {name: column[order] for name, column in columns.items()}


def _table(columns: Columns) -> Table:
    # + 0.0 turns the -0.0 that rounding leaves into a plain zero
    return Table({n: c + 0.0 if c.dtype.kind == "f" else c for n, c in columns.items()})


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
