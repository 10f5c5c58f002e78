"""What the stations take of each target: true ranges and rates, and the errors of stations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.geometry import range_rates, ranges
from imm_tdoa.simulate.errors import between, gauss_markov, gross, heard
from imm_tdoa.simulate.path import Target, Trajectory, trajectory
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.streams import Streams

TIME_DIGITS = 9  # of s: nothing moves in a nanosecond


class Schedule(NamedTuple):
    """Nominal times (K,) of the scans, s, and the stations' lasting errors (K + 1, S), s.

    The last row of the errors is one interval after the last scan.
    """

    times: Array
    bias: Array


class Reception(NamedTuple):
    """One target: its scans, where it was, what each station would take.

    Attributes
    ----------
    name : str
        Its name.
    number : (T,)
        Numbers of its scans in the schedule.
    times, late : (T,)
        Their times, s, and how much after the schedule's they come, s.
    truth : Trajectory
        Where it was, (T, d).
    arrival, rate : (T, S)
        Arrival times, s, and range rates, m/s, of each station with all its errors; the
        emission at zero, the emitter's oscillator right.
    heard : (T, S)
        Whether the station received the emission.
    """

    name: str
    number: Index
    times: Array
    late: Array
    truth: Trajectory
    arrival: Array
    rate: Array
    heard: Mask


def schedule(scenario: Scenario, streams: Streams) -> Schedule:
    """Return when scans are due, and the stations' lasting errors then."""
    sampling, noise = scenario.sampling, scenario.noise
    last = (scenario.end_s - sampling.start_s) / sampling.interval_s
    due = np.arange(int(np.floor(last + 1e-9)) + 2, dtype=np.float64)
    times = sampling.start_s + sampling.interval_s * due
    bias = np.zeros((len(times), len(scenario.stations)))
    if noise.bias_sigma_s is not None and noise.bias_time_s is not None:
        unit = streams.columns(("bias",), scenario.station_names, len(times))
        bias = gauss_markov(unit, times, noise.bias_sigma_s, noise.bias_time_s)
    return Schedule(times[:-1], bias)


def receive(scenario: Scenario, target: Target, plan: Schedule, streams: Streams) -> Reception:
    """Return what each station would take of one target, the emitter's clock aside."""
    who, names, noise = target.name, scenario.station_names, scenario.noise
    number, times = _own_times(scenario, target, plan, streams)
    moments = np.clip(times, target.start_s, target.end_s)
    truth = trajectory(target, moments, streams.of("acceleration", who))
    place, speed = station_paths(scenario, times)
    reach, _ = ranges(truth.position, place)
    rate, _, _ = range_rates(truth.position, truth.velocity, place, speed)
    arrival = reach / scenario.speed_mps + _bias(scenario, who, plan, number, times, streams)
    if noise.toa_sigma_s is not None:
        unit = streams.columns(("arrival", who), names, len(times))
        arrival += noise.toa_sigma_s * unit
    if noise.range_rate_sigma_mps is not None:
        rate += noise.range_rate_sigma_mps * streams.columns(("rate", who), names, len(times))
    size_s, size_mps = outlier_sizes(scenario)
    one_sided = scenario.outliers.late
    for name, p in scenario.outliers.station.items():
        i = names.index(name)
        arrival[:, i] += gross(streams.of("outlier", who, name), len(times), p, size_s, one_sided)
        rate[:, i] += gross(streams.of("rate outlier", who, name), len(times), p, size_mps, False)
    received = heard(scenario.dropouts, streams, who, names, times)
    late = times - plan.times[number]
    return Reception(who, number, times, late, truth, arrival, rate, received)


def scan_times(scenario: Scenario, plan: Schedule, streams: Streams, who: str) -> Array:
    """Return the times (K,) of all scans for a target, s; for any where they are common."""
    stream = streams.of("jitter") if scenario.common_scans else streams.of("jitter", who)
    late = scenario.sampling.jitter_s * stream.random(len(plan.times))
    return np.round(plan.times + late, TIME_DIGITS)


def _own_times(
    scenario: Scenario, target: Target, plan: Schedule, streams: Streams
) -> tuple[Index, Array]:
    """Return the numbers and times (T,) of the scans that a target's own time holds."""
    times = scan_times(scenario, plan, streams, target.name)
    slack = 10.0**-TIME_DIGITS
    number = np.flatnonzero((times >= target.start_s - slack) & (times <= target.end_s + slack))
    return number, times[number]


def _bias(
    scenario: Scenario, who: str, plan: Schedule, number: Index, times: Array, streams: Streams
) -> Array:
    """Return the stations' lasting errors (T, S), s, at a target's own times."""
    noise, interval = scenario.noise, scenario.sampling.interval_s
    before, after = plan.bias[number], plan.bias[number + 1]
    if noise.bias_sigma_s is None or noise.bias_time_s is None:
        return before
    unit = streams.columns(("bias", who), scenario.station_names, len(times))
    past = np.clip(times - plan.times[number], 0.0, interval)[:, None]
    sigma, tau = noise.bias_sigma_s, noise.bias_time_s
    return sigma * between(unit, before / sigma, after / sigma, past / tau, (interval - past) / tau)


def outlier_sizes(scenario: Scenario) -> tuple[float, float]:
    """Return the sizes of gross errors of times, s, and of range rates, m/s."""
    outliers, noise = scenario.outliers, scenario.noise
    size = outliers.size_s
    if size is None:
        size = (noise.toa_sigma_s or noise.tdoa_sigma_s or 0.0) * (outliers.size_sigmas or 0.0)
    return size, outliers.range_rate_size_mps or 0.0


def station_paths(scenario: Scenario, times: Array) -> tuple[Array, Array]:
    """Return positions, m, and velocities, m/s, (T, S, d) of the stations."""
    begin = scenario.sampling.start_s
    end = scenario.end_s + scenario.sampling.jitter_s
    moments = np.maximum(times, begin)  # rounded times may lie a nanosecond before
    ways = [trajectory(station.path(begin, end), moments) for station in scenario.stations]
    return (
        np.stack([way.position for way in ways], axis=1),
        np.stack([way.velocity for way in ways], axis=1),
    )
