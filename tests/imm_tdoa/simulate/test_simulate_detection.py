"""How often emitters are detected, and how many false alarms there are and where."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest
from scipy.stats import kstest, poisson
from simulate_cases import PLACES, SIGMA, C, binomial_tolerance, scenario, standing, with_rows

from imm_tdoa.simulate import Leg, Simulated, simulate, simulate_labelled
from imm_tdoa.simulate.detection import Clutter, Detection
from imm_tdoa.simulate.faults import Clock, Dropouts, NoiseLevel, Silence
from imm_tdoa.simulate.measuring import Sampling, Station

SCANS = 2000
DETECTION = Detection(probability=0.9, station={"b": 0.6}, target={"y": 0.5})
TWO = [standing("x", scans=SCANS), standing("y", (-1e3, 5e2), scans=SCANS)]


def false_rows(made: Simulated, table: str) -> dict[str, Any]:
    rows = getattr(made.recording, table)
    keep = [not who for who in made.origins[table]]
    return {name: rows[name][keep] for name in rows}


@pytest.mark.parametrize("rows", ["toa", "tdoa-reference", "tdoa-adjacent"])
def test_rows_are_detected_as_often_as_said(rows: str) -> None:
    made = with_rows(scenario(targets=TWO), rows)
    recording = simulate(attrs.evolve(made, detection=DETECTION), seed=1)
    table = recording.toa if rows == "toa" else recording.tdoa
    assert table is not None
    stations = {"toa": "abcd", "tdoa-reference": "bcd", "tdoa-adjacent": "abc"}[rows]
    present = {}
    for target, weaker in (("x", 1.0), ("y", 0.5)):
        for station in stations:
            p = weaker * (0.6 if station == "b" else 0.9)
            mine = (table["target"] == target) & (table["station"] == station)
            assert abs(np.count_nonzero(mine) / SCANS - p) < binomial_tolerance(p, SCANS)
            present[target + station] = np.isin(np.arange(SCANS), table["time_s"][mine])
    r = np.corrcoef(np.array(list(present.values()), dtype=float)) - np.eye(len(present))
    assert np.abs(r).max() < 5.0 / np.sqrt(SCANS)


def test_detection_leaves_the_rows_that_are_there_as_they_were() -> None:
    whole = simulate(scenario(targets=TWO), seed=2).tdoa
    part = simulate(scenario(targets=TWO, detection=DETECTION), seed=2).tdoa
    assert whole is not None
    assert part is not None
    keys = [list(zip(*(t[c].tolist() for c in t), strict=True)) for t in (whole, part)]
    assert set(keys[1]) < set(keys[0])


def test_one_pair_at_a_time_is_detected_by_its_station() -> None:
    made = with_rows(scenario(detection=Detection(station={"c": 0.0, "d": 0.5})), "tdoa-one-pair")
    table = simulate(made, seed=3).tdoa
    assert table is not None
    share = {s: np.count_nonzero(table["station"] == s) / SCANS for s in "abcd"}
    # of six pairs (j, i) with j > i one is b's, two are c's, three are d's
    for station, p in (("a", 0.0), ("b", 1 / 6), ("c", 0.0), ("d", 1 / 4)):
        assert abs(share[station] - p) <= binomial_tolerance(p, SCANS)


def cluttered(rows: str = "tdoa-reference", **changes: Any) -> Simulated:
    clutter = Clutter(rate=2.0, station={"c": 0.5}, **changes.pop("clutter", {}))
    made = with_rows(scenario(labelled=False, clutter=clutter, **changes), rows)
    return simulate_labelled(made, seed=4)


@pytest.mark.parametrize("rows", ["toa", "tdoa-reference", "tdoa-adjacent"])
def test_false_alarms_are_poisson_and_uniform(rows: str) -> None:
    toa = rows == "toa"
    made = cluttered(rows, clutter={"window_s": [-0.3, 0.2]} if toa else {})
    table = false_rows(made, "toa" if toa else "tdoa")
    assert set(table["station"]) == set(
        {"toa": "abcd", "tdoa-reference": "bcd", "tdoa-adjacent": "abc"}[rows]
    )
    counts = []
    for station in sorted(set(table["station"])):
        rate = 0.5 if station == "c" else 2.0
        mine = table["station"] == station
        count = np.bincount(table["time_s"][mine].astype(int), minlength=SCANS)
        counts.append(count)
        assert len(count) == SCANS
        assert abs(count.mean() - rate) < 5.0 * np.sqrt(rate / SCANS)
        # the fourth central moment of a Poisson number is rate + 3 rate²
        spread = np.sqrt((rate + 2.0 * rate**2) / SCANS)
        assert abs(count.var() - rate) < 5.0 * spread
        empty = poisson.pmf(0, rate)
        assert abs(np.mean(count == 0) - empty) < binomial_tolerance(empty, SCANS)
        if toa:
            low, high = -0.3, 0.2
        else:
            (reference,) = set(table["reference"][mine])
            ends = np.array(PLACES[station]) - np.array(PLACES[reference])
            high = float(np.linalg.norm(ends)) / C
            low = -high
        value = table["toa_s" if toa else "tdoa_s"][mine]
        assert kstest(value, "uniform", args=(low, high - low)).pvalue > 1e-4
    r = np.corrcoef(counts) - np.eye(len(counts))
    assert np.abs(r).max() < 5.0 / np.sqrt(SCANS)


def test_false_differences_may_have_a_window() -> None:
    value = false_rows(cluttered(clutter={"window_s": [-2e-6, 5e-6]}), "tdoa")["tdoa_s"]
    assert kstest(value, "uniform", args=(-2e-6, 7e-6)).pvalue > 1e-4


def test_false_alarms_reach_as_far_as_a_moving_pair_is_apart() -> None:
    legs = [Leg(motion="constant-velocity", duration_s=1.0)]
    fleeing = Station(name="z", position_m=(0.0, 10.0), velocity_mps=(0.0, 20.0), legs=legs)
    stations = [Station(name="a", position_m=PLACES["a"]), fleeing]
    made = scenario(stations=stations, labelled=False, clutter=Clutter(rate=3.0))
    table = false_rows(simulate_labelled(made, seed=5), "tdoa")
    share = table["tdoa_s"] * C / (10.0 + 20.0 * table["time_s"])
    assert kstest(share, "uniform", args=(-1.0, 2.0)).pvalue > 1e-4


def test_a_silent_station_gives_no_false_alarms() -> None:
    silences = [Silence(station="a", to_s=99.0), Silence(station="c", from_s=500.0)]
    for rows, window in (("tdoa-reference", {}), ("toa", {"window_s": [0.0, 1.0]})):
        made = cluttered(rows, clutter=window, dropouts=Dropouts(silences=silences))
        table = false_rows(made, "toa" if rows == "toa" else "tdoa")
        t, station = table["time_s"], table["station"]
        assert not np.any(station[t >= 500.0] == "c")
        assert np.any(station[t < 500.0] == "c")
        ends = station if rows == "toa" else table["reference"]
        assert not np.any((ends == "a") & (t <= 99.0))
        assert np.any(ends == "a")
        assert np.any(t <= 99.0) == (rows == "toa")


def test_false_alarms_have_range_rates_of_their_own() -> None:
    made = scenario(
        sampling=Sampling(interval_s=1.0, range_rate=True),
        noise=NoiseLevel(toa_sigma_s=SIGMA, range_rate_sigma_mps=0.1),
        labelled=False,
        clutter=Clutter(rate=1.0, range_rate_window_mps=[-50.0, 150.0]),
    )
    simulated = simulate_labelled(made, seed=6)
    table = false_rows(simulated, "fdoa")
    assert len(table["time_s"]) == len(false_rows(simulated, "tdoa")["time_s"])
    value = table["range_rate_difference_mps"]
    assert kstest(value, "uniform", args=(-50.0, 200.0)).pvalue > 1e-4


def test_false_arrivals_are_emissions_heard_by_one_station() -> None:
    clock = Clock(spread_s=0.1)
    made = cluttered("toa", clutter={"window_s": [-0.05, 0.05]}, clock=clock)
    table = made.recording.toa
    assert table is not None
    names, count = np.unique(table["emission"], return_counts=True)
    false = set(false_rows(made, "toa")["emission"].tolist())
    assert all(count[names == name] == 1 for name in list(false)[:50])
    assert len(false) == len(false_rows(made, "toa")["emission"])
    assert set(names[count == 4].tolist()) == set(names.tolist()) - false
    assert false_rows(made, "toa")["time_s"].max() <= SCANS


def rows_by_origin(made: Simulated, who: tuple[str, ...]) -> set[tuple[Any, ...]]:
    table = made.recording.tdoa
    assert table is not None
    rows = zip(*(table[name].tolist() for name in table), strict=True)
    return {row for row, name in zip(rows, made.origins["tdoa"], strict=True) if name == who}


@pytest.mark.parametrize("rows", ["tdoa-reference", "tdoa-adjacent", "tdoa-one-pair"])
def test_what_is_added_changes_nothing_in_what_was_there(rows: str) -> None:
    base = with_rows(scenario(labelled=False, targets=TWO[:1]), rows, jitter_s=0.5)
    seen = [
        simulate_labelled(made, seed=7)
        for made in (
            base,
            attrs.evolve(base, clutter=Clutter(rate=1.0)),
            attrs.evolve(base, clutter=Clutter(rate=1.0), targets=TWO),
            # one that stays longer makes more scans
            attrs.evolve(
                base,
                clutter=Clutter(rate=1.0),
                targets=[TWO[0], standing("late", (5.0, 9e3), scans=SCANS + 100)],
            ),
        )
    ]
    x = [rows_by_origin(made, ("x",)) for made in seen]
    false = [rows_by_origin(made, ()) for made in seen]
    assert len(x[0]) > 1900
    assert x[0] == x[1] == x[2] == x[3]
    assert not false[0]
    assert len(false[1]) > 1500
    assert false[1] == false[2]
    assert false[2] == {row for row in false[3] if row[0] < SCANS}


def test_false_alarms_outlive_the_emitters() -> None:
    early, late = standing("e", scans=10), attrs.evolve(standing("l", scans=10), start_s=100.0)
    made = scenario(labelled=False, targets=[early, late], clutter=Clutter(rate=5.0))
    table = simulate(made, seed=8).tdoa
    assert table is not None
    assert set(table["time_s"].tolist()) == set(range(110))
