"""Many emitters described at once, and emitters described by a place that they pass."""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest
from simulate_cases import scenario, standing

from imm_tdoa.simulate import Leg, Swarm, Target, simulate, trajectory

N = 1000


def swarm(**changes: Any) -> Swarm:
    base: dict[str, Any] = {
        "name": "s",
        "count": N,
        "low_m": [-3e3, 1e3, 100.0],
        "high_m": [5e3, 2e3, 900.0],
        "speed_mps": [10.0, 30.0],
        "heading_deg": [20.0, 110.0],
        "climb_mps": [-3.0, 5.0],
        "start_s": [0.0, 60.0],
        "duration_s": [30.0, 90.0],
        "turn_rate_dps": [-2.0, 1.0],
    }
    return Swarm(**{**base, **changes})


def test_every_number_is_uniform_over_its_interval() -> None:
    made = swarm()
    targets = made.targets()
    assert [t.name for t in targets] == [f"s-{i + 1}" for i in range(N)]
    v = np.array([t.velocity_mps for t in targets])
    drawn = {
        "speed_mps": np.hypot(v[:, 0], v[:, 1]),
        "heading_deg": np.degrees(np.arctan2(v[:, 1], v[:, 0])),
        "climb_mps": v[:, 2],
        "start_s": [t.start_s for t in targets],
        "duration_s": [t.end_s - t.start_s for t in targets],
        "turn_rate_dps": [t.legs[1].turn_rate_dps for t in targets],
    }
    place = np.array([t.begins_m for t in targets])
    for name, values in drawn.items():
        low, high = getattr(made, name)
        assert kstest(values, "uniform", args=(low, high - low)).pvalue > 1e-4, name
    for i, (low, high) in enumerate(zip(made.low_m, made.high_m, strict=True)):
        assert kstest(place[:, i], "uniform", args=(low, high - low)).pvalue > 1e-4
    r = np.corrcoef([*drawn.values(), *place.T]) - np.eye(len(drawn) + 3)
    assert np.abs(r).max() < 5.0 / np.sqrt(N)


def test_a_smaller_swarm_is_the_beginning_of_a_larger_one() -> None:
    assert swarm(count=5).targets() == swarm().targets()[:5]
    assert swarm(seed=1).targets()[0] != swarm().targets()[0]
    # and what one number is drawn from changes none of the others
    one, two = swarm(count=1).targets()[0], swarm(count=1, start_s=[5.0, 6.0]).targets()[0]
    assert attrs.evolve(two, start_s=one.start_s) == one


def test_turns_take_the_middle_third() -> None:
    target = swarm(count=1).targets()[0]
    assert [leg.motion for leg in target.legs] == ["constant-velocity", "turn", "constant-velocity"]
    assert len({leg.duration_s for leg in target.legs}) == 1
    (leg,) = swarm(count=1, turn_rate_dps=[0.0, 0.0]).targets()[0].legs
    assert leg.motion == "constant-velocity"
    assert abs(leg.duration_s - 3.0 * target.legs[0].duration_s) < 1e-9


def test_a_swarm_is_the_same_in_every_recording() -> None:
    flock = swarm(count=3, low_m=[0.0, 0.0], high_m=[1e3, 1e3], climb_mps=[0.0, 0.0])
    made = scenario(targets=[standing("x", scans=20)], swarms=[flock])
    assert [t.name for t in made.emitters] == ["x", "s-1", "s-2", "s-3"]
    one, two = (simulate(made, seed=seed) for seed in (1, 2))
    assert one.truth is not None
    assert two.truth is not None
    for name in one.truth:
        np.testing.assert_array_equal(one.truth[name], two.truth[name])
    assert set(one.targets) == {"x", "s-1", "s-2", "s-3"}
    alone = simulate(scenario(targets=[], swarms=[flock]), seed=1)
    assert set(alone.targets) == {"s-1", "s-2", "s-3"}
    for target in alone.targets:
        np.testing.assert_array_equal(alone.scans(target).values, one.scans(target).values)


def test_white_acceleration_is_drawn_anew() -> None:
    flock = swarm(
        count=2, low_m=[0.0, 0.0], high_m=[1e3, 1e3], climb_mps=[0.0, 0.0], acceleration_psd=1.0
    )
    one, two = (simulate(scenario(targets=[], swarms=[flock]), seed=s).truth for s in (1, 2))
    assert one is not None
    assert two is not None
    assert not np.array_equal(one["x_m"], two["x_m"])


LEGS = [
    Leg(motion="static", duration_s=10.0),
    Leg(motion="constant-acceleration", duration_s=20.0, end_velocity_mps=[40.0, -30.0]),
    Leg(motion="turn", duration_s=30.0, turn_rate_dps=3.0),
]


@settings(deadline=None, max_examples=40)
@given(
    when=st.floats(5.0, 65.0),
    x=st.floats(-1e5, 1e5),
    y=st.floats(-1e5, 1e5),
    v=st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)),
)
def test_a_target_is_where_it_passes_when_it_passes(
    when: float, x: float, y: float, v: tuple[float, float]
) -> None:
    target = Target(name="t", passes_m=(x, y), at_s=when, start_s=5.0, velocity_mps=v, legs=LEGS)
    np.testing.assert_allclose(trajectory(target, when).position, [x, y], atol=1e-6)
    same = Target(name="t", position_m=target.begins_m, start_s=5.0, velocity_mps=v, legs=LEGS)
    for one, two in zip(
        trajectory(target, [5.0, 40.0]), trajectory(same, [5.0, 40.0]), strict=True
    ):
        np.testing.assert_array_equal(one, two)


def test_white_acceleration_comes_on_top_of_where_it_passes() -> None:
    shaken = [Leg(motion="constant-velocity", duration_s=20.0, acceleration_psd=0.25)]
    target = Target(name="t", passes_m=(7.0, 9.0), at_s=12.0, velocity_mps=(1.0, 2.0), legs=shaken)
    assert target.begins_m == (-5.0, -15.0)
    rng = np.random.default_rng(1)
    ends = np.array([trajectory(target, [12.0], rng).position[0] for _ in range(2000)])
    # integrated white noise: variance q t³ / 3
    expected = 0.25 * 12.0**3 / 3.0
    assert np.all(np.abs(ends.mean(axis=0) - [7.0, 9.0]) < 5.0 * math.sqrt(expected / 2000))
    assert np.all(np.abs(ends.var(axis=0) / expected - 1.0) < 5.0 * math.sqrt(2.0 / 2000))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 0}, "count: expected at least 1, got 0"),
        ({"count": 1.5}, "count: expected a whole number of at least 0, got 1.5"),
        ({"high_m": [1.0, 2.0]}, "high_m: expected as many numbers as in low_m, 3, got 2"),
        ({"high_m": [-4e3, 2e3, 900.0]}, r"high_m\[0\]: expected at least low_m\[0\], -3000, got"),
        ({"low_m": [0.0, 0.0], "high_m": [1.0, 1.0]}, "climb_mps: needs 3 dimensions, got 2"),
        ({"speed_mps": [-1.0, 3.0]}, r"speed_mps\[0\]: expected a number of at least 0, got -1"),
        ({"duration_s": [0.0, 3.0]}, r"duration_s\[0\]: expected a number above 0, got 0"),
        ({"start_s": [4.0, 3.0]}, r"start_s: expected \[low, high\] with low at most high, got"),
        ({"heading_deg": 4.0}, r"heading_deg: expected two finite numbers \[low, high\], got 4.0"),
        ({"turn_rate_dps": [1.0]}, r"turn_rate_dps: expected two finite numbers .*, got \[1.0\]"),
        ({"acceleration_psd": -1.0}, "acceleration_psd: expected a number of at least 0, got -1"),
        ({"name": ""}, "name: expected a name of printable characters"),
    ],
)
def test_a_swarm_that_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        swarm(**changes)
