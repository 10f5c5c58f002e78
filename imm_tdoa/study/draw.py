"""Drawing the runs of a chunk: true ways and what is measured of them, as arrays.

Every run has its own random streams, found by the study's seed, the scenario's name and the
number of the run, one for each kind of error: nothing depends on how runs are put into chunks, on
who computes them, or in which order, and the same run has the same noise whatever else goes wrong.
"""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple

import numpy as np

from imm_tdoa import registry
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.simulate import Scenario, trajectory
from imm_tdoa.stations import Stations, pair_index
from imm_tdoa.study import faults
from imm_tdoa.study.scenarios import ScenarioCase
from imm_tdoa.study.ways import Ways, by_chance, by_legs

KINDS = (
    "way",
    "chance",
    "jitter",
    "arrival",
    "rate",
    "row",
    "bias",
    "pair",
    "start",
    "lost",
    "gross",
)


class Drawn(NamedTuple):
    """What n runs of a scenario measured, and the truth behind it.

    Attributes
    ----------
    measurement : MeasurementModel
        What the filters are told is measured.
    times : (T,) or (n, T)
        Times of the scans, s.
    values : (n, T, m)
        Rows of each scan; NaN is missing.
    pairs : (n, T, 1, 2) int or None
        Station pairs, where they change from scan to scan.
    ways : Ways
        The truth.
    start : (n, 2 d) or None
        Standard normal numbers: the error of what filters are told to start from.
    seeds : (n,) str
        What each run's streams are found by; see `stream`.
    """

    measurement: MeasurementModel
    times: Array
    values: Array
    pairs: Index | None
    ways: Ways
    start: Array | None
    seeds: np.ndarray[Any, np.dtype[np.str_]]

    def part(self, runs: Any) -> Drawn:
        """Return some of the runs."""
        ways = self.ways
        return self._replace(
            times=self.times if self.times.ndim == 1 else self.times[runs],
            values=self.values[runs],
            pairs=None if self.pairs is None else self.pairs[runs],
            ways=ways._replace(
                state=ways.state[runs], form=ways.form[runs], since=ways.since[runs]
            ),
            start=None if self.start is None else self.start[runs],
            seeds=self.seeds[runs],
        )


class Streams(NamedTuple):
    """The random streams of some runs of a scenario."""

    seed: int
    scenario: str
    runs: Index

    def normal(self, kind: str, *shape: int) -> Array:
        """Return standard normal numbers (n, *shape), each run's from its own stream."""
        result = np.empty((len(self.runs), *shape))
        for i, run in enumerate(self.runs):
            stream(self.seed, self.scenario, int(run), kind).standard_normal(out=result[i])
        return result

    def uniform(self, kind: str, *shape: int) -> Array:
        """Return uniform numbers (n, *shape) below 1, each run's from its own stream."""
        result = np.empty((len(self.runs), *shape))
        for i, run in enumerate(self.runs):
            stream(self.seed, self.scenario, int(run), kind).random(out=result[i])
        return result


def stream(seed: int, scenario: str, run: int, kind: str) -> np.random.Generator:
    """Return the random stream of one kind of error in one run.

    Parameters
    ----------
    seed : int
        The study's.
    scenario : str
        Name of the scenario.
    run : int
        Number of the run.
    kind : str
        One of `KINDS`.
    """
    digest = hashlib.sha256(scenario.encode()).digest()
    words = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
    sequence = np.random.SeedSequence(seed, spawn_key=(*words, run, KINDS.index(kind)))
    return np.random.Generator(np.random.PCG64(sequence))


def clock(plan: Scenario) -> Array:
    """Return the nominal times (T,) of the scans that the target's own time holds, s."""
    target, sampling = plan.targets[0], plan.sampling
    begin = max(target.start_s, sampling.start_s)
    first = np.ceil((begin - sampling.start_s) / sampling.interval_s - 1e-9)
    last = np.floor(
        (target.end_s - sampling.start_s - sampling.jitter_s) / sampling.interval_s + 1e-9
    )
    numbers = np.arange(first, last + 1.0)
    return np.asarray(sampling.start_s + sampling.interval_s * numbers)


def draw(case: ScenarioCase, seed: int, first: int, last: int) -> Drawn:
    """Draw the runs `first` to `last` (not included) of a scenario.

    Emissions leave at the time of their scan: what a receiver's unknown offset would be, the
    filters eliminate exactly.
    """
    plan = case.plan
    streams = Streams(seed, case.name, np.arange(first, last))
    n, S = last - first, len(plan.stations)
    nominal = clock(plan)
    T, d = len(nominal), plan.dims
    times = np.broadcast_to(nominal, (n, T))
    if plan.sampling.jitter_s > 0.0:
        times = nominal + plan.sampling.jitter_s * streams.uniform("jitter", T)
    ways = _ways(case, streams, times)
    stations = stations_of(plan, nominal)
    measurement = measured(plan, stations)
    pairs, ends = None, pair_index(_kind(plan), S)
    if plan.sampling.rows == "tdoa-one-pair":
        every = pair_index("reference", 2) if S == 2 else _all_pairs(S)
        number = (streams.uniform("pair", T) * len(every)).astype(np.int64)
        pairs = ends = every[number][:, :, None, :]
        measurement = measurement.with_pairs(pairs)
    common = nominal if plan.sampling.jitter_s == 0.0 else times
    clean = measurement.predict(ways.position, ways.velocity, common) / measurement.scale
    values = clean + faults.errors(plan, streams, times, ends)
    values = np.where(faults.missing(plan, streams, times, ends), np.nan, values)
    if pairs is not None:
        measurement = measurement.with_pairs(pairs[:, 0])
    return Drawn(
        measurement=measurement,
        times=common,
        values=values,
        pairs=pairs,
        ways=ways,
        start=None if case.start is None else streams.normal("start", 2 * d),
        seeds=np.array([f"{seed}/{case.name}/{run}" for run in streams.runs]),
    )


def _ways(case: ScenarioCase, streams: Streams, times: Array) -> Ways:
    targets, d, T = case.plan.targets, case.plan.dims, times.shape[1]
    if case.random is not None:
        c = len(case.random.space(d).components)
        unit, chance = streams.normal("way", T, 2, c), streams.uniform("chance", T)
        return by_chance(case.random, targets, streams.runs, times, unit, chance)
    rough = any(leg.acceleration_psd > 0.0 for target in targets for leg in target.legs)
    steps = T + max(len(target.legs) for target in targets) if rough else 0
    return by_legs(targets, streams.runs, times, streams.normal("way", steps, 2, d))


def stations_of(plan: Scenario, times: Array) -> Stations:
    """Return the stations, sampled at every scan where one of them moves."""
    names = plan.station_names
    if not any(station.moving for station in plan.stations):
        return Stations(np.array([s.position_m for s in plan.stations]), names=names)
    begin = plan.sampling.start_s
    ways = [trajectory(station.path(begin, plan.end_s), times) for station in plan.stations]
    return Stations(
        np.stack([way.position for way in ways], axis=1),
        velocities=np.stack([way.velocity for way in ways], axis=1),
        times=times,
        names=names,
    )


def measured(plan: Scenario, stations: Stations) -> MeasurementModel:
    """Return the measurement model that the scenario's rows and noise make."""
    noise, sampling = plan.noise, plan.sampling
    rate = noise.range_rate_sigma_mps if sampling.range_rate else None
    parts: list[Any] = []
    if sampling.rows == "toa":
        parts.append(registry.load("toa")(stations, sigma=noise.toa_sigma_s, speed=plan.speed_mps))
        if rate is not None:
            parts.append(registry.load("range-rate")(stations, sigma=rate))
    else:
        pairs = _kind(plan)
        sigma = {
            key: value
            for key, value in (
                ("toa_sigma", noise.toa_sigma_s),
                ("tdoa_sigma", noise.tdoa_sigma_s),
            )
            if value is not None
        }
        parts.append(registry.load("tdoa")(stations, **sigma, pairs=pairs, speed=plan.speed_mps))
        if rate is not None:
            parts.append(registry.load("fdoa")(stations, range_rate_sigma=rate, pairs=pairs))
    result: MeasurementModel = parts[0] if len(parts) == 1 else registry.load("stack")(*parts)
    return result


def _kind(plan: Scenario) -> str:
    return "adjacent" if plan.sampling.rows == "tdoa-adjacent" else "reference"


def _all_pairs(S: int) -> Index:
    return np.array([(j, i) for i in range(S) for j in range(i + 1, S)], dtype=np.int64)
