"""Trajectories against closed forms, numerical integration and the law of white acceleration."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from imm_tdoa.models import ConstantVelocity
from imm_tdoa.simulate import Leg, Target, trajectory

LEGS = [
    Leg(motion="static", duration_s=7.0),
    Leg(motion="constant-acceleration", duration_s=9.0, acceleration_mps2=[2.0, -1.0, 0.5]),
    Leg(motion="constant-velocity", duration_s=11.0),
    Leg(motion="turn", duration_s=20.0, turn_rate_dps=-4.0),
    Leg(motion="turn", duration_s=6.0, turn_rate_dps=11.0),
    Leg(motion="constant-acceleration", duration_s=8.0, end_velocity_mps=[3.0, 4.0, -1.0]),
]


def target(*legs: Leg, dims: int = 2, **options: Any) -> Target:
    options.setdefault("position_m", [100.0, -50.0, 20.0][:dims])
    return Target(name="x", legs=legs, **options)


def integrated(legs: list[Leg], p: Any, v: Any) -> tuple[Any, Any]:
    """Integrate the legs' equations of motion; position and velocity at each leg's end."""
    ends = []
    for leg in legs:
        a = np.zeros(3) if leg.acceleration_mps2 is None else np.array(leg.acceleration_mps2)
        if leg.end_velocity_mps is not None:
            a = (np.array(leg.end_velocity_mps) - v) / leg.duration_s
        if leg.motion == "static":
            v = np.zeros(3)
        spin = np.radians(leg.turn_rate_dps or 0.0) * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0.0]])

        def law(_: float, y: Any, spin: Any = spin, a: Any = a) -> Any:
            return np.concatenate([y[3:], spin @ y[3:] + a])

        done = solve_ivp(law, (0.0, leg.duration_s), np.concatenate([p, v]), rtol=1e-11, atol=1e-9)
        p, v = done.y[:3, -1], done.y[3:, -1]
        ends.append((p, v))
    return np.array([p for p, _ in ends]), np.array([v for _, v in ends])


def test_legs_agree_with_numerical_integration() -> None:
    moving = target(*LEGS, dims=3, start_s=5.0)
    ends = 5.0 + np.cumsum([leg.duration_s for leg in LEGS])
    p, v = integrated(LEGS, np.array(moving.position_m), np.zeros(3))
    before = np.nextafter(ends, -np.inf)
    there = trajectory(moving, before)
    np.testing.assert_allclose(there.position, p, atol=1e-5)
    np.testing.assert_allclose(there.velocity, v, atol=1e-6)
    assert moving.end_s == pytest.approx(ends[-1])


def test_constant_acceleration_is_a_parabola() -> None:
    leg = Leg(motion="constant-acceleration", duration_s=10.0, acceleration_mps2=[1.0, -2.0])
    t = np.linspace(2.0, 12.0, 41)
    there = trajectory(target(leg, start_s=2.0, velocity_mps=[3.0, 4.0]), t)
    s = (t - 2.0)[:, None]
    a, v = np.array([1.0, -2.0]), np.array([3.0, 4.0])
    np.testing.assert_allclose(there.position, [100.0, -50.0] + v * s + a * s**2 / 2, rtol=1e-14)
    np.testing.assert_allclose(there.velocity, v + a * s, rtol=1e-14)
    np.testing.assert_array_equal(there.acceleration, np.broadcast_to(a, (41, 2)))


def test_turn_is_a_circle_counter_clockwise() -> None:
    leg = Leg(motion="turn", duration_s=90.0, turn_rate_dps=4.0)
    t = np.arange(0.0, 91.0)
    there = trajectory(target(leg, velocity_mps=[30.0, 0.0]), t)
    omega = np.radians(4.0)
    angle = omega * t
    r = 30.0 / omega
    expected = [100.0, -50.0] + r * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1)
    np.testing.assert_allclose(there.position, expected, atol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(there.velocity, axis=-1), 30.0, rtol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(there.acceleration, axis=-1), 30.0 * omega)
    assert np.all(np.einsum("ti,ti->t", there.velocity, there.acceleration) < 1e-12)
    np.testing.assert_allclose(there.position[-1], [100.0, -50.0], atol=1e-9)


def test_a_turn_in_three_dimensions_keeps_its_climb() -> None:
    leg = Leg(motion="turn", duration_s=30.0, turn_rate_dps=12.0)
    there = trajectory(target(leg, dims=3, velocity_mps=[10.0, 0.0, 2.0]), np.linspace(0, 30, 7))
    np.testing.assert_allclose(there.velocity[:, 2], 2.0)
    np.testing.assert_allclose(there.position[:, 2], 20.0 + 2.0 * np.linspace(0, 30, 7))
    np.testing.assert_allclose(there.acceleration[:, 2], 0.0)


def test_a_turn_of_rate_zero_is_straight() -> None:
    straight = Leg(motion="constant-velocity", duration_s=30.0)
    t = np.linspace(0.0, 30.0, 13)
    want = trajectory(target(straight, velocity_mps=[7.0, -2.0]), t)
    for rate in (0.0, 1e-12):
        leg = Leg(motion="turn", duration_s=30.0, turn_rate_dps=rate)
        got = trajectory(target(leg, velocity_mps=[7.0, -2.0]), t)
        np.testing.assert_allclose(got.position, want.position, rtol=1e-12)


leg_strategy = st.one_of(
    st.builds(Leg, motion=st.just("static"), duration_s=st.floats(0.5, 50.0)),
    st.builds(Leg, motion=st.just("constant-velocity"), duration_s=st.floats(0.5, 50.0)),
    st.builds(
        Leg,
        motion=st.just("constant-acceleration"),
        duration_s=st.floats(0.5, 50.0),
        acceleration_mps2=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)),
    ),
    st.builds(
        Leg,
        motion=st.just("turn"),
        duration_s=st.floats(0.5, 50.0),
        turn_rate_dps=st.floats(-40.0, 40.0),
    ),
)


@settings(deadline=None, max_examples=60)
@given(st.lists(leg_strategy, min_size=1, max_size=5), st.tuples(*[st.floats(-50.0, 50.0)] * 2))
def test_derivatives_and_continuity(legs: list[Leg], v: tuple[float, float]) -> None:
    moving = target(*legs, velocity_mps=v)
    borders = np.cumsum([leg.duration_s for leg in legs])
    speed = 50.0 + 9.0 * borders[-1]
    h = 1e-4
    for k, leg in enumerate(legs):
        middle = borders[k] - leg.duration_s / 2.0
        at = trajectory(moving, [middle - h, middle, middle + h])
        slope = (at.position[2] - at.position[0]) / (2.0 * h)
        np.testing.assert_allclose(slope, at.velocity[1], atol=1e-6 * speed)
        bend = (at.velocity[2] - at.velocity[0]) / (2.0 * h)
        np.testing.assert_allclose(bend, at.acceleration[1], atol=1e-6 * speed)
        if k + 1 < len(legs):
            pair = trajectory(moving, [np.nextafter(borders[k], 0.0), borders[k]])
            np.testing.assert_allclose(pair.position[0], pair.position[1], atol=1e-9 * speed)
            if legs[k + 1].motion != "static":
                np.testing.assert_allclose(pair.velocity[0], pair.velocity[1], atol=1e-9 * speed)
            else:
                np.testing.assert_array_equal(pair.velocity[1], 0.0)


def test_a_leg_may_begin_with_its_own_velocity() -> None:
    legs = (
        Leg(motion="constant-velocity", duration_s=5.0, velocity_mps=[1.0, 0.0]),
        Leg(motion="turn", duration_s=5.0, turn_rate_dps=1.0, velocity_mps=[0.0, 9.0]),
    )
    there = trajectory(target(*legs, velocity_mps=[99.0, 99.0]), [0.0, 4.0, 5.0])
    np.testing.assert_array_equal(there.velocity, [[1.0, 0.0], [1.0, 0.0], [0.0, 9.0]])
    np.testing.assert_allclose(there.position[2], [105.0, -50.0])


def test_an_end_velocity_of_zero_is_a_full_stop() -> None:
    legs = (
        Leg(motion="turn", duration_s=7.3, turn_rate_dps=13.7),
        Leg(motion="constant-acceleration", duration_s=3.3, end_velocity_mps=[0.0, 0.0]),
    )
    moving = target(*legs, velocity_mps=[13.1, 7.7])
    there = trajectory(moving, moving.end_s)
    assert there.velocity.shape == (2,)
    np.testing.assert_array_equal(there.velocity, 0.0)


def test_the_same_leg_may_come_twice() -> None:
    leg = Leg(motion="constant-velocity", duration_s=5.0)
    there = trajectory(target(leg, leg, velocity_mps=[2.0, 0.0]), [0.0, 4.0, 5.0, 9.0, 10.0])
    np.testing.assert_allclose(there.position[:, 0] - 100.0, [0.0, 8.0, 10.0, 18.0, 20.0])


def test_white_acceleration_has_the_covariance_of_constant_velocity() -> None:
    # Over any partition of the time, position and velocity wander as the CWN model says.
    psd, runs = 0.7, 1500
    legs = (
        Leg(motion="constant-velocity", duration_s=4.0, acceleration_psd=psd),
        Leg(motion="turn", duration_s=3.0, turn_rate_dps=20.0, acceleration_psd=psd),
    )
    moving = target(*legs, velocity_mps=[5.0, 0.0])
    times = np.array([0.3, 1.0, 3.9, 4.0, 6.5, 7.0])
    base = trajectory(
        target(
            *(
                Leg(motion=leg.motion, duration_s=leg.duration_s, turn_rate_dps=leg.turn_rate_dps)
                for leg in legs
            ),
            velocity_mps=[5.0, 0.0],
        ),
        times,
    )
    rng = np.random.default_rng(8)
    off = np.empty((runs, 2, 2))
    for k in range(runs):
        there = trajectory(moving, times, rng)
        off[k] = there.position[-1] - base.position[-1], there.velocity[-1] - base.velocity[-1]
    sample = np.einsum("kia,kja->ij", off, off) / (2 * runs)
    Q = ConstantVelocity(psd=psd).process_noise(7.0, 1)
    tolerance = 5.0 * np.sqrt((np.outer(np.diag(Q), np.diag(Q)) + Q**2) / (2 * runs))
    assert np.all(np.abs(sample - Q) < tolerance)


def test_white_acceleration_ends_where_the_target_stands() -> None:
    legs = (
        Leg(motion="constant-velocity", duration_s=10.0, acceleration_psd=1.0),
        Leg(motion="static", duration_s=10.0),
    )
    there = trajectory(target(*legs), [9.9, 10.0, 15.0, 20.0], np.random.default_rng(1))
    assert np.any(there.velocity[0] != 0.0)
    np.testing.assert_array_equal(there.velocity[1:], 0.0)
    np.testing.assert_array_equal(there.position[1:], np.broadcast_to(there.position[1], (3, 2)))


def test_trajectory_refuses_what_it_cannot_tell() -> None:
    moving = target(Leg(motion="constant-velocity", duration_s=10.0), start_s=2.0)
    with pytest.raises(ValueError, match="times: the target 'x' exists from 2 s to 12 s, got 1 s"):
        trajectory(moving, [1.0, 5.0])
    with pytest.raises(ValueError, match="exists from 2 s to 12 s, got 13 s"):
        trajectory(moving, [2.0, 13.0])
    with pytest.raises(ValueError, match="times: expected times that do not decrease"):
        trajectory(moving, [5.0, 3.0])
    shaken = target(Leg(motion="constant-velocity", duration_s=10.0, acceleration_psd=1.0))
    with pytest.raises(ValueError, match="rng: the target has white acceleration"):
        trajectory(shaken, [1.0])
    assert trajectory(moving, []).position.shape == (0, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"motion": "fly"}, "motion: expected one of 'static', .* got 'fly'"),
        ({"motion": "static", "duration_s": 0.0}, "duration_s: expected a number above 0, got 0"),
        (
            {"motion": "static", "velocity_mps": [1.0, 1.0]},
            "velocity_mps: a 'static' leg takes duration_s only",
        ),
        ({"motion": "static", "acceleration_psd": 1.0}, "acceleration_psd: a 'static' leg"),
        ({"motion": "turn"}, "turn_rate_dps: a 'turn' leg needs turn_rate_dps"),
        (
            {"motion": "constant-acceleration"},
            "needs one of acceleration_mps2 and end_velocity_mps",
        ),
        (
            {
                "motion": "constant-acceleration",
                "acceleration_mps2": [1.0, 0.0],
                "end_velocity_mps": [1.0, 0.0],
            },
            "needs one of acceleration_mps2 and end_velocity_mps",
        ),
        (
            {"motion": "constant-acceleration", "acceleration_mps2": [1.0, np.nan]},
            "acceleration_mps2: expected a list of finite numbers",
        ),
        ({"motion": "turn", "turn_rate_dps": True}, "turn_rate_dps: expected a finite number"),
    ],
)
def test_bad_legs(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Leg(**{"duration_s": 1.0, **options})


def test_bad_targets() -> None:
    leg = Leg(motion="constant-velocity", duration_s=1.0)
    with pytest.raises(ValueError, match="legs: expected at least one leg, got none"):
        target()
    with pytest.raises(ValueError, match=r"legs\[0\]: expected a Leg, got 3"):
        target(3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="velocity_mps: expected as many numbers as in position_m"):
        target(leg, velocity_mps=[1.0])
    with pytest.raises(ValueError, match=r"legs\[1\].velocity_mps: expected as many"):
        target(leg, Leg(motion="constant-velocity", duration_s=1.0, velocity_mps=[1.0]))
    with pytest.raises(ValueError, match="position_m: expected a list of finite numbers, got 'ab'"):
        target(leg, position_m="ab")
    with pytest.raises(ValueError, match=r"legs\[0\].motion: a turn needs 2 or 3 dimensions"):
        target(Leg(motion="turn", duration_s=1.0, turn_rate_dps=1.0), position_m=[1.0])
