"""What is drawn: the law of every kind of error, and that a run is the same whoever draws it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from study_cases import BANKS, HEAD, SCENARIOS, STATIONS

from imm_tdoa import study
from imm_tdoa.simulate import simulate, trajectory
from imm_tdoa.study.draw import Drawn, clock, draw, stream
from imm_tdoa.study.scenarios import ScenarioCase

LEGS = """
        { motion = "constant-velocity", duration_s = 8.0 },
        { motion = "static", duration_s = 8.0 },
"""


def case(*changes: tuple[str, str], extra: str = "") -> ScenarioCase:
    """Return the small study's scenario with some of its text replaced."""
    text = SCENARIOS
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    sweep = "[scenarios.sweep]\nnoise_factor = [1.0, 3.0]\n"
    return study.parse(HEAD + text.replace(sweep, extra) + BANKS).scenarios[0]


def clean(of: ScenarioCase, drawn: Drawn) -> Any:
    """Return the rows (n, T, m) that a receiver without errors would take."""
    model = drawn.measurement
    return model.predict(drawn.ways.position, drawn.ways.velocity, drawn.times) / model.scale


def same(a: Drawn, b: Drawn) -> bool:
    return (
        np.array_equal(a.values, b.values, equal_nan=True)
        and np.array_equal(a.ways.state, b.ways.state)
        and np.array_equal(np.broadcast_to(a.times, a.values.shape[:2]), b.times)
        and list(a.seeds) == list(b.seeds)
    )


EVERYTHING = (
    ("toa_sigma_s = 30e-9", "toa_sigma_s = 30e-9, bias_sigma_s = 2e-8, bias_time_s = 9.0"),
    ("interval_s = 2.0", "interval_s = 2.0, jitter_s = 0.5"),
    ("dims = 2\n", "dims = 2\ndropouts = { row = 0.1 }\noutliers = { row = 0.1, size_s = 1e-6 }\n"),
)


@pytest.mark.parametrize("random", ["", '[scenarios.random]\nbank = "vehicle"\n'])
def test_a_run_is_the_same_whoever_draws_it_with_whom(random: str) -> None:
    one = case(*EVERYTHING, extra=random + "[scenarios.start]\nposition_std_m = 9.0\n")
    whole = draw(one, 7, 0, 12)
    part = draw(one, 7, 5, 9)
    assert same(whole.part(slice(5, 9)), part._replace(times=np.asarray(part.times)))
    assert whole.start is not None
    assert part.start is not None
    assert np.array_equal(whole.start[5:9], part.start)
    assert not np.array_equal(whole.values[0], whole.values[1], equal_nan=True)
    assert not same(whole, draw(one, 8, 0, 12))
    assert whole.seeds[3] == f"7/{one.name}/3"


def test_streams_are_found_again() -> None:
    one = case()
    first = draw(one, 5, 40, 41)
    unit = stream(5, one.name, 40, "arrival").standard_normal((9, 4))
    errors = 30e-9 * (unit[:, 1:] - unit[:, :1])
    assert np.allclose(first.values[0] - clean(one, first)[0], errors, rtol=0.0, atol=1e-18)


def test_other_errors_leave_the_noise_alone() -> None:
    plain, lossy = draw(case(), 1, 0, 30), draw(case(EVERYTHING[2]), 1, 0, 30)
    there = np.isfinite(lossy.values)
    apart = np.abs(lossy.values - plain.values)
    small = apart[there] == 0.0
    assert 0.8 < small.mean() < 0.95  # the rest is grossly wrong
    assert np.all(apart[there][~small] >= 0.49e-6)
    assert 0.05 < np.mean(~there) < 0.15


def test_legs_are_those_of_simulate() -> None:
    one = case()
    drawn = draw(one, 1, 0, 3)
    way = trajectory(one.plan.targets[0], clock(one.plan))
    for run in range(3):
        assert np.array_equal(drawn.ways.position[run], way.position)
        assert np.array_equal(drawn.ways.velocity[run], way.velocity)


def test_values_without_noise_are_those_of_simulate() -> None:
    for rows in ("tdoa-reference", "tdoa-adjacent", "toa"):
        one = case(("interval_s = 2.0", f'interval_s = 2.0, rows = "{rows}"'), ("30e-9", "1e-14"))
        drawn = draw(one, 1, 0, 1)
        recorded = simulate(one.plan, 1).scans()
        values = recorded.values - (drawn.values[0] if rows != "toa" else 0.0)
        if rows == "toa":  # emission times are unknown
            values = np.diff(recorded.values) - np.diff(drawn.values[0])
        assert np.array_equal(recorded.times, drawn.times)
        assert np.all(np.abs(values) < 4e-13)  # 1e-14 of noise, digits that a recording keeps


def test_moving_stations_and_range_rates_are_those_of_simulate() -> None:
    body = '[[scenarios]]\nscenario = "fdoa"\n'
    quiet = (
        "replace = { dropouts = {}, noise = { toa_sigma_s = 1e-18, range_rate_sigma_mps = 1e-9 } }"
    )
    one = study.parse(HEAD + body + quiet + "\n" + BANKS).scenarios[0]
    drawn = draw(one, 1, 0, 1)
    recorded = simulate(one.plan, 1).scans()
    assert np.array_equal(recorded.times, drawn.times)
    assert recorded.values.shape == drawn.values[0].shape
    apart = np.abs(recorded.values - drawn.values[0])
    assert np.all(apart[:, :3] < 1e-12)
    assert np.all(apart[:, 3:] < 2e-6)


def within(observed: float, expected: float, std: float) -> bool:
    """Whether a statistic lies within 4.5 of its standard deviations, 7e-6 to miss."""
    return abs(observed - expected) < 4.5 * std


def test_noise_has_the_covariance_that_filters_are_told() -> None:
    for sigma in ("toa_sigma_s = 30e-9", "tdoa_sigma_s = 30e-9"):
        one = case(("toa_sigma_s = 30e-9", sigma))
        drawn = draw(one, 2, 0, 400)
        error = (drawn.values - clean(one, drawn)) * drawn.measurement.scale
        R = drawn.measurement.noise_covariance(np.ones(2), np.zeros(2), 0.0)
        e = error.reshape(-1, 3)
        square = np.einsum("ki,ij,kj->k", e, np.linalg.inv(R), e)
        assert within(square.mean(), 3.0, np.sqrt(6.0 / len(e)))
        C = e.T @ e / len(e)
        std = np.sqrt((np.outer(np.diag(R), np.diag(R)) + R**2) / len(e))
        assert np.all(np.abs(C - R) < 4.5 * std)


def test_range_rate_noise() -> None:
    one = case(
        ("interval_s = 2.0", 'interval_s = 2.0, range_rate = true, rows = "toa"'),
        ("30e-9", "30e-9, range_rate_sigma_mps = 0.5"),
    )
    drawn = draw(one, 2, 0, 300)
    error = drawn.values - clean(one, drawn)
    assert error.shape == (300, 9, 8)
    for part, sigma in ((error[..., :4], 30e-9), (error[..., 4:], 0.5)):
        variance = part.var() / sigma**2
        assert within(variance, 1.0, np.sqrt(2.0 / part.size))


def test_lasting_errors_last() -> None:
    one = case(("30e-9", "1e-15, bias_sigma_s = 1e-7, bias_time_s = 8.0"))
    one = study.parse(
        HEAD
        + "[[scenarios]]\nname = 'x'\n[scenarios.scenario]\n"
        + "title = 'x'\ndims = 2\nsampling = { interval_s = 2.0, rows = 'toa' }\n"
        + "noise = { toa_sigma_s = 1e-15, bias_sigma_s = 1e-7, bias_time_s = 8.0 }\n"
        + f"stations = [{STATIONS}]\n"
        + "targets = [{ name = 'a', position_m = [1.0, 2.0], legs = ["
        + "{ motion = 'static', duration_s = 16.0 }] }]\n"
        + BANKS
    ).scenarios[0]
    drawn = draw(one, 3, 0, 800)
    b = (drawn.values - clean(one, drawn)) / 1e-7  # (n, T, S)
    n = b.shape[0] * b.shape[2]
    for lag in (0, 1, 4):
        product = (b[:, 0] * b[:, lag]).mean()
        rho = np.exp(-2.0 * lag / 8.0)
        assert within(product, rho, np.sqrt((1.0 + rho**2) / n))


def test_losses_and_outliers_come_as_often_as_stated() -> None:
    one = case(
        (
            "dims = 2\n",
            "dims = 2\ndropouts = { row = 0.1, scan = 0.2, station = { b = 0.3 } }\n"
            "outliers = { station = { c = 0.25 }, size_s = 1e-5, late = true }\n",
        )
    )
    drawn = draw(one, 4, 0, 800)
    n = 800 * 9
    expected = 1.0 - 0.8 * 0.9 * np.array([0.7, 1.0, 1.0])
    for row in range(3):
        share = np.isnan(drawn.values[..., row]).mean()
        p = expected[row]
        assert within(share, p, np.sqrt(p * (1.0 - p) / n))
    error = drawn.values - clean(one, drawn)
    late = error[..., 1] > 4e-6
    share = late[np.isfinite(error[..., 1])].mean()
    assert within(share, 0.25, np.sqrt(0.25 * 0.75 / (0.72 * n)))
    size = error[..., 1][late]
    assert size.min() > 4.7e-6
    assert size.max() < 15.3e-6
    assert within(size.mean(), 1e-5, 1e-5 / np.sqrt(12.0 * len(size)))


def test_a_silent_station_is_silent() -> None:
    one = case(
        ("dims = 2\n", 'dims = 2\ndropouts = { silences = [{ station = "a", from_s = 5 }] }\n')
    )
    values = draw(one, 4, 0, 2).values
    assert np.array_equal(np.isnan(values).all(axis=-1), np.array([clock(one.plan) >= 5.0] * 2))
    assert not np.isnan(values[:, :3]).any()


def test_one_pair_at_a_time() -> None:
    one = case(("interval_s = 2.0", 'interval_s = 2.0, rows = "tdoa-one-pair"'), ("30e-9", "1e-18"))
    drawn = draw(one, 4, 0, 200)
    assert drawn.pairs is not None
    assert drawn.pairs.shape == (200, 9, 1, 2)
    reach = np.linalg.norm(
        drawn.ways.position[:, :, None] - np.array([s.position_m for s in one.plan.stations]),
        axis=-1,
    )
    ends = np.take_along_axis(reach, drawn.pairs[:, :, 0], axis=-1)
    assert np.allclose(drawn.values[..., 0] * 299792458.0, ends[..., 0] - ends[..., 1], atol=1e-8)
    number = drawn.pairs[..., 0, 0] * 4 + drawn.pairs[..., 0, 1]
    kinds, counts = np.unique(number, return_counts=True)
    assert len(kinds) == 6
    chi2 = ((counts - 300.0) ** 2 / 300.0).sum()
    assert chi2 < 5 + 6 * np.sqrt(10.0)


def test_white_acceleration_spreads_as_it_should() -> None:
    """On a leg: q t³/3 in position, q t²/2 with velocity; forgotten by a leg with its own."""
    one = case((LEGS, LEGS.replace('velocity", dur', 'velocity", acceleration_psd = 0.4, dur')))
    drawn = draw(one, 6, 0, 3000)
    way = trajectory(case().plan.targets[0], clock(one.plan))
    off = drawn.ways.position - way.position
    speed = drawn.ways.velocity - way.velocity
    for k in (1, 3):
        t = 2.0 * k
        n = off[:, k].size
        for product, law in (
            (off[:, k] ** 2, 0.4 * t**3 / 3.0),
            (speed[:, k] ** 2, 0.4 * t),
        ):
            assert within(product.mean(), law, law * np.sqrt(2.0 / n))
        cross = (off[:, k] * speed[:, k]).mean()
        assert within(cross, 0.4 * t**2 / 2.0, 0.4 * np.sqrt((t**4 / 3 + t**4 / 4) / n))
    assert np.all(speed[:, 4:] == 0.0)
    assert np.all(off[:, 5:] == off[:, 4:5])
    law = 0.4 * 8.0**3 / 3.0
    assert within((off[:, 4] ** 2).mean(), law, law * np.sqrt(2.0 / off[:, 4].size))


def test_forms_of_legs() -> None:
    one = case(
        (
            LEGS,
            """
        { motion = "static", duration_s = 3.0 },
        { motion = "constant-velocity", duration_s = 1.0 },
        { motion = "constant-acceleration", acceleration_mps2 = [1.0, 0.0], duration_s = 4.0 },
        { motion = "constant-acceleration", acceleration_mps2 = [0.0, 0.0], duration_s = 2.0 },
        { motion = "turn", turn_rate_dps = 9.0, duration_s = 4.0 },
    """,
        ),
        ("velocity_mps = [12.0, 5.0], ", ""),
    )
    ways = draw(one, 1, 0, 1).ways
    names = [ways.forms[k].model for k in ways.form[0]]
    assert names == [  # at 0, 2, 4, …, 14 s, over the step before; the start is the first leg's
        "static",
        "static",
        "static",
        "constant-acceleration",
        "constant-acceleration",
        "constant-velocity",
        "coordinated-turn",
        "coordinated-turn",
    ]
    assert ways.since[0].tolist() == [0.0, 0.0, 0.0, 4.0, 4.0, 8.0, 10.0, 10.0]


RANDOM = """
[scenarios.random]
mean_sojourn_s = [4.0, 12.0]
prior = [0.25, 0.75]
birth_std = { velocity = 7.0 }
modes = [
    { model = "static", psd = 0.0 },
    { model = "constant-velocity", psd = 0.3 },
]
"""


def test_ways_by_chance_follow_chain_birth_law_and_process_noise() -> None:
    one = case(("velocity_mps = [12.0, 5.0], ", ""), extra=RANDOM)
    n = 4000
    ways = draw(one, 9, 0, n).ways
    assert [form.name for form in ways.forms] == ["static", "constant-velocity"]
    moving = ways.form == 1
    assert within(moving[:, 0].mean(), 0.75, np.sqrt(0.75 * 0.25 / n))
    assert one.random is not None
    chain = one.random.chain(2.0)
    for i in range(2):
        from_i = ways.form[:, :-1] == i
        share = (ways.form[:, 1:] == 1)[from_i].mean()
        p = chain[i, 1]
        assert within(share, p, np.sqrt(p * (1 - p) / from_i.sum()))
    assert np.all(ways.velocity[~moving] == 0.0)
    still = ~moving[:, 1:]
    assert np.all((np.diff(ways.position, axis=1)[still]) == 0.0)
    first = ways.velocity[:, 0][moving[:, 0]]
    assert within((first**2).mean(), 49.0, 49.0 * np.sqrt(2.0 / first.size))
    born = moving[:, 1:] & ~moving[:, :-1]
    v = ways.velocity[:, 1:][born]
    law = 49.0 + 0.3 * 2.0  # born at the switch, shaken over the step
    assert within((v**2).mean(), law, law * np.sqrt(2.0 / v.size))
    kept = moving[:, 1:] & moving[:, :-1]
    jolt = np.diff(ways.velocity, axis=1)[kept]
    step = (np.diff(ways.position, axis=1) - 2.0 * ways.velocity[:, :-1])[kept]
    Q = one.random.models[1].process_noise(2.0, 2)
    for a, b, law in ((step, step, Q[0, 0]), (step, jolt, Q[0, 2]), (jolt, jolt, Q[2, 2])):
        s = np.sqrt((law**2 + np.mean(a**2) * np.mean(b**2)) / a.size)
        assert within((a * b).mean(), law, s)


def test_targets_are_taken_in_turn() -> None:
    plan = study.parse(HEAD + '[[scenarios]]\nscenario = "source-a"\n' + BANKS).scenarios[0]
    begin = draw(plan, 1, 1, 7).ways.position[:, 0]
    places = np.array([target.position_m for target in plan.plan.targets])
    assert np.array_equal(begin, places[[1, 2, 0, 1, 2, 0]])


def test_jitter_is_late_by_less_than_stated() -> None:
    one = case(("interval_s = 2.0", "interval_s = 2.0, jitter_s = 1.5"))
    drawn = draw(one, 1, 0, 50)
    late = drawn.times - clock(one.plan)
    assert late.shape == (50, one.scans)
    assert np.all((late >= 0.0) & (late < 1.5))
    assert drawn.times.max() <= one.plan.end_s
