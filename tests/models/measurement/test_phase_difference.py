"""Phase difference and its rate (ALGORITHMS §1.3, §7.2): values, noise, refusals, the kit's laws.

Laws that cannot apply: ``units`` (values are angles: lengths and propagation speed magnified
together leave them as they are), exempt because the signal's speed is not called `speed`;
``rotation`` (the baseline's azimuth turns with the frame), exempt for angular rows and left out
here for the rate alone; ``reference`` and ``reference-free`` (there are no station pairs). What
takes the place of rotation is tested below.
"""

from __future__ import annotations

from functools import partial

import attrs
import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import Stations, registry
from imm_tdoa.models import PhaseDifference, Position, Stack
from imm_tdoa.testing import broken_laws, check_measurement_model, specimen
from imm_tdoa.testing.strategies import Kinematics, numbers, vectors

DEG = np.pi / 180.0
C = 299792458.0
TIMES = np.array([0.0, 20.0, 40.0])
EAST = Stations(
    TIMES[:, None, None] * [[270.0, 0.0]],
    velocities=np.full((3, 1, 2), [270.0, 0.0]),
    times=TIMES,
)
UNSURE = attrs.evolve(
    EAST,
    position_covariance=np.array([[[100.0, 30.0], [30.0, 80.0]]]),
    velocity_covariance=np.array([[[4.0, -1.0], [-1.0, 2.0]]]),
)
SOURCE = {"baseline": 10.0, "frequency": 6e9, "sigma_phase": 10 * DEG, "sigma_rate": 0.5 * DEG}
TURNING = {"baseline_azimuth": [3.0, -3.0, -2.0], "azimuth_times": [0.0, 20.0, 40.0]}
EMITTER, STILL = np.array([60e3, 80e3]), np.zeros(2)
BASE = PhaseDifference(EAST, **SOURCE)

VARIANTS = {
    "base": BASE,
    "phase": PhaseDifference(EAST, use="phase", baseline=2.0, frequency=3e8, sigma_phase=0.1),
    "rate": PhaseDifference(UNSURE, **{**SOURCE, "use": "rate", "sigma_phase": None}),
    "unsure": PhaseDifference(UNSURE, **SOURCE),
    "turning": PhaseDifference(UNSURE, **SOURCE, **TURNING),
    "turning, rates given": PhaseDifference(
        EAST, **SOURCE, **TURNING, azimuth_rate=[0.01, 0.05, 0.02]
    ),
    "every error": PhaseDifference(
        UNSURE,
        **SOURCE,
        **TURNING,
        azimuth_sigma=0.5 * DEG,
        azimuth_rate_sigma=0.1 * DEG,
        frequency_sigma=1e4,
    ),
}


@st.composite
def far_emitters(draw: st.DrawFn) -> Kinematics:
    """Emitters 10 to 150 km from the flight, which a single station gives no scale of."""
    angle, reach = draw(numbers(-3.1, 3.1)), draw(numbers(10e3, 150e3))
    place = reach * np.array([np.cos(angle), np.sin(angle)]) + [5400.0, 0.0]
    return Kinematics(place, draw(vectors([300.0, 300.0])), draw(numbers(0.0, 40.0)))


@pytest.mark.parametrize("name", VARIANTS)
def test_laws(name: str) -> None:
    model = VARIANTS[name]
    bad = [partial(attrs.evolve, model, baseline=-1.0), partial(attrs.evolve, model, use="x")]
    without = ["rotation"] if name == "rate" else []
    check_measurement_model(
        model, kinematics=far_emitters(), bad_arguments=bad, examples=15, without=without
    )


def test_the_registered_model_makes_its_own_specimen() -> None:
    model = specimen(registry.load("phase-difference"))
    assert isinstance(model, PhaseDifference)
    assert broken_laws(model, examples=10) == []


def test_numbers_of_the_source() -> None:
    """§7.2: K is 200.1 cycles, the phase 120.08 cycles, its rate -124.5°/s, which falls."""
    K = BASE.electrical_length
    assert_allclose(K / (2 * np.pi), 200.1, atol=0.05)
    assert_allclose(K * 0.6 / (2 * np.pi), 120.08, atol=5e-3)
    phase, rate = BASE.predict(EMITTER, STILL, 0.0)
    assert_allclose(phase, (0.6 * K + np.pi) % (2 * np.pi) - np.pi, atol=1e-9)
    assert_allclose(rate / DEG, -124.5, atol=0.01)
    h = 0.5
    ends = [BASE.predict(EMITTER, STILL, t)[1] for t in (10.0 - h, 10.0 + h)]
    near = BASE.predict(EMITTER, STILL, 10.0)[1]
    theta = np.arctan2(80e3, 60e3 - 2700.0)
    # §7.2: d rate / rate = 3 v cos(theta) / R
    expected = near * 3 * 270.0 * np.cos(theta) / np.hypot(57.3e3, 80e3)
    assert_allclose((ends[1] - ends[0]) / (2 * h), expected, rtol=1e-4)
    first = BASE.predict(EMITTER, STILL, [0.0, 1e-3])[:, 1]
    assert_allclose(np.diff(first)[0] / 1e-3 / DEG, -0.605, atol=1e-3)
    low = np.ceil((K * np.cos(np.arctan2(4, 3) + 10 * DEG) - phase) / (2 * np.pi))
    high = np.floor((K * np.cos(np.arctan2(4, 3) - 10 * DEG) - phase) / (2 * np.pi))
    assert high - low + 1 in (55, 56)


def test_platform_errors_of_the_source() -> None:
    """§7.3: 10 m are 5.8° of phase, 2 m/s 0.92°/s of rate along the track, 1.15°/s on each axis."""
    for field, errors, row, degrees in (
        ("position_covariance", [10.0, 10.0], 0, 5.76),
        ("velocity_covariance", [2.0, 0.0], 1, 0.922),
        ("velocity_covariance", [2.0, 2.0], 1, 1.153),
    ):
        Q = np.diag(errors)[None] ** 2
        model = attrs.evolve(BASE, stations=attrs.evolve(EAST, **{field: Q}))
        R = model.noise_covariance(EMITTER, STILL, 0.0) - BASE.noise_covariance(EMITTER, STILL, 0.0)
        assert_allclose(np.sqrt(R[row, row]) / DEG, degrees, rtol=1e-3)


@pytest.mark.parametrize("name", ["base", "turning"])
def test_the_rate_is_the_phase_s_derivative_in_time(name: str) -> None:
    """Along the flight, with a moving emitter: what two phases a moment apart differ by."""
    model, h = VARIANTS[name], 1e-3
    v, p = np.array([-120.0, 45.0]), np.array([30e3, -50e3])
    for t in (3.0, 25.0, 39.0):
        before, after = (model.predict(p + s * h * v, v, t + s * h)[0] for s in (-1.0, 1.0))
        step = (after - before + np.pi) % (2 * np.pi) - np.pi
        assert_allclose(model.predict(p, v, t)[1], step / (2 * h), rtol=1e-6)


def test_a_turn_of_everything_changes_nothing() -> None:
    """Emitter, observer, its errors and the baseline turned together."""
    model, angle = VARIANTS["every error"], 0.7
    T = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    s = model.stations
    turned = attrs.evolve(
        model,
        stations=attrs.evolve(
            s,
            positions=s.positions @ T.T,
            velocities=s.velocities @ T.T,
            position_covariance=T @ s.position_covariance @ T.T,
            velocity_covariance=T @ s.velocity_covariance @ T.T,
        ),
        baseline_azimuth=np.array(TURNING["baseline_azimuth"]) + angle,
    )
    p, v = np.array([40e3, -20e3]), np.array([100.0, 30.0])
    assert_allclose(turned.predict(T @ p, T @ v, 7.0), model.predict(p, v, 7.0), atol=1e-8)
    for after, before in zip(
        turned.jacobian(T @ p, T @ v, 7.0), model.jacobian(p, v, 7.0), strict=True
    ):
        assert_allclose(after @ T, before, rtol=1e-9, atol=1e-12)
    assert_allclose(
        turned.noise_covariance(T @ p, T @ v, 7.0), model.noise_covariance(p, v, 7.0), rtol=1e-8
    )


def test_noise_is_what_moving_each_cause_makes_of_the_rows() -> None:
    """R = sensor + J C J' with J by differences over observer, azimuth, its rate, frequency."""
    rates = np.array([0.01, 0.05, 0.02])
    model = attrs.evolve(VARIANTS["every error"], azimuth_rate=rates)
    p, v, t = np.array([50e3, 40e3]), np.array([80.0, -60.0]), 20.0
    s, azimuth = model.stations, np.array(TURNING["baseline_azimuth"])

    def column(h: float, change) -> np.ndarray:
        ends = [change(sign * h).predict(p, v, t) for sign in (1.0, -1.0)]
        away = ends[0] - ends[1]
        away[0] = (away[0] + np.pi) % (2 * np.pi) - np.pi
        return away / (2 * h)

    R = np.diag([10 * DEG, 0.5 * DEG]) ** 2
    for field, C_, h in (
        ("positions", s.position_covariance[0], 0.5),
        ("velocities", s.velocity_covariance[0], 0.5),
    ):
        J = np.stack(
            [
                column(
                    h,
                    lambda e, f=field, a=axis: attrs.evolve(
                        model, stations=attrs.evolve(s, **{f: getattr(s, f) + e * np.eye(2)[a]})
                    ),
                )
                for axis in (0, 1)
            ],
            axis=-1,
        )
        R = R + J @ C_ @ J.T
    for sigma, h, change in (
        (0.5 * DEG, 1e-5, lambda e: attrs.evolve(model, baseline_azimuth=azimuth + e)),
        (0.1 * DEG, 1e-5, lambda e: attrs.evolve(model, azimuth_rate=rates + e)),
        (1e4, 100.0, lambda e: attrs.evolve(model, frequency=6e9 + e)),
    ):
        J = column(h, change)
        R = R + sigma**2 * np.outer(J, J)
    assert_allclose(model.noise_covariance(p, v, t), R, rtol=1e-5)


def test_rows_in_use() -> None:
    both = VARIANTS["unsure"]
    R = both.noise_covariance(EMITTER, STILL, 5.0)
    for row, use in enumerate(("phase", "rate")):
        one = attrs.evolve(both, use=use)
        assert one.size == 1
        assert_array_equal(one.angular, [use == "phase"])
        assert_array_equal(
            one.predict(EMITTER, STILL, 5.0), both.predict(EMITTER, STILL, 5.0)[[row]]
        )
        assert_array_equal(one.noise_covariance(EMITTER, STILL, 5.0), R[[row], [row]][None])
    assert_array_equal(both.angular, [True, False])


def test_azimuths_between_samples() -> None:
    model = VARIANTS["turning"]
    a, rate = model.azimuth_at(np.array([10.0, 20.0, 30.0, 40.0]))
    short = 2 * np.pi - 6.0  # the short way from 3 to -3 rad
    assert_allclose(a[:2], [3.0 + 0.5 * short, 3.0 + short])
    assert_allclose(rate, [short / 20.0, 0.05, 0.05, 0.05])
    given = VARIANTS["turning, rates given"].azimuth_at(10.0)[1]
    assert_allclose(given, 0.03)
    for outside in (-1.0, 41.0):
        assert np.all(np.isnan(model.predict(EMITTER, STILL, outside)))
        assert np.all(np.isnan(model.azimuth_at(outside)))


def test_an_emitter_at_the_observer_is_no_disaster() -> None:
    rows = BASE.predict(STILL, STILL, 0.0)
    assert np.all(np.isfinite(rows))
    assert all(np.all(np.isfinite(H)) for H in BASE.jacobian(STILL, STILL, 0.0))


def test_a_stack_keeps_the_angle_and_shares_the_platform_s_error() -> None:
    phase = attrs.evolve(VARIANTS["unsure"], use="phase")
    rate = attrs.evolve(VARIANTS["unsure"], use="rate")
    stack = Stack(Position(sigma=5.0), phase, rate)
    assert_array_equal(stack.angular, [False, False, True, False])
    R = stack.noise_covariance(EMITTER, STILL, 5.0)
    both = VARIANTS["unsure"].noise_covariance(EMITTER, STILL, 5.0)
    assert_allclose(R[2:, 2:], both, rtol=1e-12)
    assert_array_equal(R[:2, 2:], 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stations": "here"}, "stations: expected Stations"),
        ({"stations": Stations([[0.0, 0.0], [1.0, 0.0]])}, "stations: expected one observer in 2"),
        ({"stations": Stations([[0.0, 0.0, 0.0]])}, "stations: expected one observer in 2"),
        ({"baseline": 0.0}, "baseline: expected a number above 0"),
        ({"frequency": np.nan}, "frequency: expected a finite number"),
        ({"propagation_speed": -C}, "propagation_speed: expected a number above 0"),
        ({"sigma_phase": None}, "sigma_phase: the phase is in use"),
        ({"sigma_rate": None}, "sigma_rate: the rate is in use"),
        ({"sigma_rate": 0.0}, "sigma_rate: expected a number above 0"),
        ({"azimuth_sigma": -1.0}, "azimuth_sigma: expected a number of at least 0"),
        ({"use": "all"}, "use: expected one of 'both', 'phase', 'rate'"),
        ({"baseline_azimuth": [0.0, 1.0]}, "baseline_azimuth: expected shape"),
        ({"azimuth_rate": 0.1}, "azimuth_rate: a baseline that turns needs azimuth_times"),
        ({"azimuth_times": [1.0, 0.0]}, "azimuth_times: expected two or more strictly increasing"),
        ({"azimuth_times": [0.0, 1.0]}, "baseline_azimuth: expected shape"),
    ],
)
def test_refusals(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        attrs.evolve(BASE, **change)
