# ruff: noqa: E501
"""Scenario files of several emitters: what they may say, and where an error is found."""

from __future__ import annotations

import pytest
from simulate_cases import assert_refused

from imm_tdoa import simulate

TEXT = """
title = "A case"
dims = 2
labelled = false

[[stations]]
name = "a"
position_m = [0, 0.0]

[[stations]]
name = "b"
position_m = [1000.0, 0.0]

[[stations]]
name = "c"
position_m = [0.0, 1000.0]

[sampling]
interval_s = 1
rows = "tdoa-reference"
resolution_s = 1e-8

[noise]
toa_sigma_s = 1e-8

[detection]
probability = 0.9
station = { b = 0.5 }
target = { x = 0.8, s-2 = 0.7 }

[clutter]
rate = 2
station = { c = 0.5 }
window_s = [-1e-6, 1e-6]

[[targets]]
name = "x"
passes_m = [300, 400]
at_s = 4.0

[[targets.legs]]
motion = "static"
duration_s = 5

[[swarms]]
name = "s"
count = 3
low_m = [0, 0]
high_m = [500, 500]
speed_mps = [10, 20]
duration_s = [5, 9]
start_s = [1, 2]
"""


def changed(*changes: tuple[str, str]) -> str:
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_everything_arrives() -> None:
    made = simulate.read(TEXT)
    assert not made.labelled
    assert made.sampling.resolution_s == 1e-8
    assert made.detection.of("b", "x") == 0.4
    assert made.detection.of("c", "y") == 0.9
    assert (made.clutter.of("b"), made.clutter.of("c")) == (2.0, 0.5)
    assert made.clutter.window_s == (-1e-6, 1e-6)
    assert [t.name for t in made.emitters] == ["x", "s-1", "s-2", "s-3"]
    assert made.emitters[0].begins_m == (300.0, 400.0)
    assert made.end_s == max(t.end_s for t in made.emitters) > 5.0
    assert len(simulate.simulate(made).measured["tdoa"]) > 10


LABELLED = ("labelled = false", "labelled = true")
BAD = [
    ("labelled = false", "labelled = 0", "labelled: expected true or false, got 0"),
    # detection
    ("probability = 0.9", "probability = 1.2", "detection.probability: expected a probability from 0 to 1, got 1.2"),
    ("probability = 0.9", "probability = 'high'", "detection.probability: expected a number, got 'high'"),
    ("probability = 0.9", "probabilty = 0.9", "detection.probabilty: unknown key (did you mean 'probability'?); there are: probability, station, target"),
    ("{ b = 0.5 }", "{ b = -0.1 }", "detection.station.b: expected a probability from 0 to 1, got -0.1"),
    ("{ b = 0.5 }", "{ q = 0.5 }", "detection.station.q: there is no station 'q'; there are: a, b, c"),
    ("{ b = 0.5 }", "{ a = 0.5 }", "detection.station.a: the difference of a pair is its station's, and with sampling.rows = 'tdoa-reference' 'a' is only ever a reference"),
    ("{ x = 0.8,", "{ y = 0.8,", "detection.target.y: there is no target 'y'; there are: x, s-1, s-2, s-3"),
    ("{ x = 0.8,", "{ x = 8,", "detection.target.x: expected a probability from 0 to 1, got 8"),
    # clutter
    ("rate = 2", "rate = -2", "clutter.rate: expected a number of at least 0, got -2"),
    ("rate = 2", "rate = inf", "clutter.rate: expected a finite number, got inf"),
    ("{ c = 0.5 }", "{ c = -0.5 }", "clutter.station.c: expected a number of at least 0, got -0.5"),
    ("{ c = 0.5 }", "{ q = 0.5 }", "clutter.station.q: there is no station 'q'; there are: a, b, c"),
    ("{ c = 0.5 }", "{ a = 0.5 }", "clutter.station.a: the difference of a pair is its station's"),
    ("{ c = 0.5 }", "0.5", "clutter.station: expected a table, got 0.5"),
    ("[-1e-6, 1e-6]", "[1e-6, -1e-6]", "clutter.window_s: expected [low, high] with low < high, got [1e-06, -1e-06]"),
    ("[-1e-6, 1e-6]", "[1e-6]", "clutter.window_s: expected two finite numbers [low, high], got [1e-06]"),
    ("[-1e-6, 1e-6]", "1e-6", "clutter.window_s: expected a list of numbers, got 1e-06"),
    ("rate = 2", "rate = 2\nrange_rate_window_mps = [0, 1]", "clutter.range_rate_window_mps: only where sampling.range_rate = true"),
    ("interval_s = 1", "interval_s = 1\nrange_rate = true", "noise.range_rate_sigma_mps: missing, where sampling.range_rate = true"),
    (*LABELLED, "clutter: a false alarm is nobody's and can have no label; it needs labelled = false"),
    # merged rows
    ("resolution_s = 1e-8", "resolution_s = 0", "sampling.resolution_s: expected a number above 0, got 0"),
    # anchors
    ("at_s = 4.0", "", "targets[0].at_s: expected passes_m and at_s, or neither"),
    ("at_s = 4.0", "at_s = 7", "targets[0].at_s: expected a time from 0 s to 5 s, when the target exists, got 7"),
    ("at_s = 4.0", "at_s = 4.0\nposition_m = [0, 0]", "targets[0].position_m: expected exactly one of position_m and passes_m"),
    ("passes_m = [300, 400]\nat_s = 4.0", "", "targets[0].position_m: expected exactly one of position_m and passes_m"),
    ("passes_m = [300, 400]", "passes_m = [300, 400, 500]", "targets[0].passes_m: expected 2 numbers (dims = 2), got 3"),
    ("passes_m = [300, 400]", "passes_m = [300, 400]\nvelocity_mps = [1]", "targets[0].velocity_mps: expected as many numbers as in passes_m, 2, got 1"),
    # swarms
    ("count = 3", "count = 0", "swarms[0].count: expected at least 1, got 0"),
    ("count = 3", "", "swarms[0].count: missing"),
    ("low_m = [0, 0]\nhigh_m = [500, 500]", "low_m = [0, 0, 0]\nhigh_m = [500, 500, 1]", "swarms[0].low_m: expected 2 numbers (dims = 2), got 3"),
    ("speed_mps = [10, 20]", "speed_mps = 10", "swarms[0].speed_mps: expected a list of numbers, got 10"),
    ("speed_mps = [10, 20]", "speed_mps = [20, 10]", "swarms[0].speed_mps: expected [low, high] with low at most high, got [20.0, 10.0]"),
    ("duration_s = [5, 9]", "duration_s = [-5, 9]", "swarms[0].duration_s[0]: expected a number above 0, got -5"),
    ('name = "x"', 'name = "s-3"', "swarms[0].name: 's-3' appears twice"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=[b[2][:50] for b in BAD])
def test_bad_scenarios_say_where_and_what(old: str, new: str, message: str) -> None:
    assert_refused(changed((old, new)), message)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ((LABELLED, ("rate = 2\nstation = { c = 0.5 }", "")), "sampling.resolution_s: a row of two emitters can have no label; it needs labelled = false"),
        ((('"tdoa-reference"', '"toa"'), ("window_s = [-1e-6, 1e-6]", "")), "clutter.window_s: missing, where sampling.rows = 'toa'"),
        ((("interval_s = 1", "interval_s = 1\nrange_rate = true"), ("toa_sigma_s = 1e-8", "toa_sigma_s = 1e-8\nrange_rate_sigma_mps = 1")), "clutter.range_rate_window_mps: missing, where sampling.range_rate = true"),
        ((('"tdoa-reference"', '"tdoa-adjacent"'),), "clutter.station.c: the difference of a pair is its station's, and with sampling.rows = 'tdoa-adjacent' 'c' is only ever a reference"),
        ((("{ b = 0.5 }", "{ a = 0.5 }"), ('"tdoa-reference"', '"tdoa-one-pair"')), "detection.station.a: the difference of a pair is its station's"),
    ],
)  # fmt: skip
def test_what_does_not_go_together(changes: tuple[tuple[str, str], ...], message: str) -> None:
    assert_refused(changed(*changes), message)
