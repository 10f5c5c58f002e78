"""Emitters and stations that move: range rates, the truth at every scan, the times of scans."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest
from simulate_cases import C, scenario, with_rows

from imm_tdoa.simulate import Leg, Scenario, Target, simulate, trajectory
from imm_tdoa.simulate.faults import Clock, Dropouts, NoiseLevel
from imm_tdoa.simulate.measuring import Sampling, Station


def moving_scenario(rows: str, **changes: Any) -> Scenario:
    legs = [
        Leg(motion="static", duration_s=10.0),
        Leg(motion="constant-acceleration", duration_s=20.0, end_velocity_mps=[40.0, -30.0]),
        Leg(motion="turn", duration_s=30.0, turn_rate_dps=3.0),
    ]
    circle = Leg(motion="turn", duration_s=25.0, turn_rate_dps=2.0)
    stations = [
        Station(name="a", position_m=[0.0, 0.0]),
        Station(name="b", position_m=[9e3, 1e3], velocity_mps=[-50.0, 70.0]),
        Station(name="c", position_m=[2e3, 8e3], velocity_mps=[0.0, 60.0], legs=[circle]),
    ]
    options: dict[str, Any] = {
        "stations": stations,
        "noise": NoiseLevel(toa_sigma_s=1e-15, range_rate_sigma_mps=1e-9),
        "targets": [Target(name="x", position_m=[1e3, 3e3], legs=legs)],
        "sampling": Sampling(interval_s=0.5, rows=rows, range_rate=True, jitter_s=0.1),
    }
    return scenario(**{**options, **changes})


def test_moving_stations_and_range_rates() -> None:
    # Range rates are the slopes of ranges along the true ways of target and stations.
    made = moving_scenario("tdoa-reference")
    recording = simulate(made, seed=7)
    tdoa, fdoa = recording.tdoa, recording.fdoa
    assert tdoa is not None
    assert fdoa is not None
    assert recording.stations.moving
    h = 1e-3
    inside = (fdoa["time_s"] > 2 * h) & (fdoa["time_s"] < 60.0 - 2 * h)
    t = fdoa["time_s"][inside]
    assert len(np.unique(t)) > 100

    def distance(moment: Any, station: str) -> Any:
        way = {s.name: s.path(0.0, 70.0) for s in made.stations}[station]
        gap = trajectory(made.targets[0], moment).position - trajectory(way, moment).position
        return np.linalg.norm(gap, axis=-1)

    for name in ("b", "c"):
        mine = fdoa["station"][inside] == name
        moment = t[mine]
        gap = distance(moment, name) - distance(moment, "a")
        np.testing.assert_allclose(tdoa["tdoa_s"][inside][mine], gap / C, atol=1e-13)
        later = distance(moment + h, name) - distance(moment + h, "a")
        earlier = distance(moment - h, name) - distance(moment - h, "a")
        slope = (later - earlier) / (2.0 * h)
        np.testing.assert_allclose(
            fdoa["range_rate_difference_mps"][inside][mine], slope, atol=5e-3
        )
    for k, station in enumerate(made.stations):
        there = trajectory(station.path(0.0, 70.0), np.unique(t))
        position, velocity = recording.stations.at(np.unique(t))
        np.testing.assert_allclose(position[:, k], there.position, atol=1e-4)
        np.testing.assert_allclose(velocity[:, k], there.velocity, atol=1e-6)


def test_range_rates_of_arrivals_have_an_unknown_offset() -> None:
    clock = Clock(range_rate_offset_mps=500.0, range_rate_spread_mps=30.0, spread_s=0.1)
    made = moving_scenario("toa", clock=clock)
    made = attrs.evolve(made, noise=NoiseLevel(toa_sigma_s=1e-8, range_rate_sigma_mps=0.2))
    toa, tdoa = simulate(made, seed=8), simulate(with_rows(made, "tdoa-reference"), seed=8)
    assert toa.range_rate is not None
    assert tdoa.fdoa is not None
    rates = toa.range_rate["range_rate_mps"].reshape(-1, 3)
    differences = tdoa.fdoa["range_rate_difference_mps"].reshape(-1, 2)
    np.testing.assert_allclose(rates[:, 1:] - rates[:, :1], differences, atol=2e-6)
    quiet = simulate(attrs.evolve(made, clock=Clock(range_rate_spread_mps=0.0)), seed=8)
    assert quiet.range_rate is not None
    offset = rates - quiet.range_rate["range_rate_mps"].reshape(-1, 3)
    np.testing.assert_allclose(offset, np.broadcast_to(offset[:, :1], offset.shape), atol=2e-6)
    assert np.all(np.abs(offset - 500.0) <= 15.0 + 1e-6)
    assert np.std(offset[:, 0]) > 5.0


def test_truth_is_the_trajectory_at_every_scan() -> None:
    made = attrs.evolve(moving_scenario("toa"), dropouts=Dropouts(scan=0.5, row=0.3))
    recording = simulate(made, seed=9)
    truth = recording.truth
    assert truth is not None
    assert recording.toa is not None
    t = truth["time_s"]
    assert len(t) > len(np.unique(recording.toa["time_s"])) > 10
    assert set(np.unique(recording.toa["time_s"])) <= set(t.tolist())
    there = trajectory(made.targets[0], t)
    place = np.stack([truth["x_m"], truth["y_m"]], axis=-1)
    speed = np.stack([truth["vx_mps"], truth["vy_mps"]], axis=-1)
    np.testing.assert_allclose(place, there.position, atol=5.1e-5)
    np.testing.assert_allclose(speed, there.velocity, atol=5.1e-7)
    np.testing.assert_array_equal(t, np.round(t, 9))


def test_jitter_keeps_scans_in_order_and_within_their_interval() -> None:
    recording = simulate(with_rows(scenario(), "toa", jitter_s=1.0), seed=10)
    assert recording.truth is not None
    t = recording.truth["time_s"]
    assert np.all(np.diff(t) > 0.0)
    late = t - np.arange(len(t))
    assert late.min() >= 0.0
    assert late.max() <= 1.0
    assert abs(late.mean() - 0.5) < 5.0 / np.sqrt(12.0 * len(t))


@pytest.mark.parametrize("start", [0.1234567891234, 1.7e9 + 1.0 / 3.0, -5e4])
def test_time_may_start_anywhere(start: float) -> None:
    legs = [Leg(motion="static", duration_s=10.0), Leg(motion="constant-velocity", duration_s=10.0)]
    target = Target(name="x", position_m=(3e3, 2.5e3), start_s=start, legs=legs)
    sampling = Sampling(interval_s=0.1, start_s=start, rows="toa")
    noise = NoiseLevel(toa_sigma_s=1e-9)
    made = moving_scenario("toa", targets=[target], sampling=sampling, noise=noise)
    recording = simulate(made)
    assert recording.truth is not None
    assert len(recording.truth) == 201
    assert len(recording.scans().times) == 201
