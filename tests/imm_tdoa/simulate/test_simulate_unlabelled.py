"""Recordings that do not say whose their rows are: order, names, merged rows, origins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulate_cases import C, rows_of, scenario, standing, with_rows

from imm_tdoa.recording import Recording, read, write
from imm_tdoa.simulate import Scenario, simulate, simulate_labelled
from imm_tdoa.simulate.detection import Clutter, Detection
from imm_tdoa.simulate.faults import Clock, NoiseLevel
from imm_tdoa.simulate.measuring import HeightReport, Sampling, Station

QUIET = NoiseLevel(toa_sigma_s=1e-15)
PLACES_3D = {
    "a": (0.0, 0.0, 9.0),
    "b": (9e3, 1e3, 50.0),
    "c": (2e3, 8e3, 0.0),
    "d": (-7e3, 0.0, 90.0),
}


def three(scans: int = 40, **changes: Any) -> Scenario:
    targets = [
        standing("x", (3e3, 2.5e3), scans),
        attrs.evolve(standing("y", (-1e3, 5e2), scans // 2), start_s=5.0),
        standing("z", (4e3, 6e3), scans),
    ]
    base: dict[str, Any] = {
        "labelled": False,
        "targets": targets,
        "detection": Detection(probability=0.8),
        "clutter": Clutter(rate=0.7, window_s=[-2e-5, 2e-5]),
    }
    return scenario(**{**base, **changes})


def tables(recording: Recording) -> dict[str, list[tuple[Any, ...]]]:
    return {
        name: list(zip(*(t[c].tolist() for c in t), strict=True))
        for name, t in recording.measured.items()
    }


@pytest.mark.parametrize("rows", ["toa", "tdoa-reference", "tdoa-adjacent", "tdoa-one-pair"])
def test_nothing_written_names_a_target_but_the_truth(rows: str, tmp_path: Path) -> None:
    targets = [
        standing(name, place, 30) for name, place in (("Qx", (3e3, 2e3)), ("Qy", (1e3, 5e3)))
    ]
    recording = simulate(with_rows(three(targets=targets), rows), seed=1)
    write(recording, tmp_path / "there")
    again = read(tmp_path / "there")
    assert not again.labelled
    assert tables(again) == tables(recording)
    for file in (tmp_path / "there").iterdir():
        assert ("Q" in file.read_text("utf-8")) == (file.name == "truth.csv")
    assert again.truth is not None
    assert set(again.truth["target"]) == {"Qx", "Qy"}


@pytest.mark.parametrize("rows", ["toa", "tdoa-reference", "tdoa-one-pair"])
def test_order_and_names_do_not_depend_on_the_order_of_targets(rows: str) -> None:
    made = with_rows(three(), rows, jitter_s=0.4)
    turned = attrs.evolve(made, targets=made.targets[::-1])
    one, two = simulate_labelled(made, seed=2), simulate_labelled(turned, seed=2)
    assert tables(one.recording) == tables(two.recording)
    assert one.origins == two.origins


def test_rows_of_a_scan_are_in_order_of_station_and_value() -> None:
    table = simulate(three(), seed=3).tdoa
    assert table is not None
    keys = list(zip(table["time_s"], table["station"], table["tdoa_s"], strict=True))
    assert keys == sorted(keys)


def test_unlabelled_differences_have_their_scans_in_common() -> None:
    made = with_rows(three(), "tdoa-one-pair", jitter_s=0.4)
    recording = simulate(made, seed=4)
    table = recording.tdoa
    assert table is not None
    pairs: dict[float, set[tuple[str, str]]] = {}
    for t, a, b in zip(table["time_s"], table["station"], table["reference"], strict=True):
        pairs.setdefault(float(t), set()).add((str(a), str(b)))
    assert len(pairs) <= 40
    assert all(len(pair) == 1 for pair in pairs.values())
    assert len(set.union(*pairs.values())) == 6


def test_emissions_are_numbered_in_the_order_of_time() -> None:
    recording = simulate(with_rows(three(), "toa", jitter_s=0.4), seed=5)
    table = recording.toa
    assert table is not None
    numbers = [int(name) for name in table["emission"]]
    assert numbers == sorted(numbers)
    assert set(numbers) == set(range(1, max(numbers) + 1))
    assert np.all(np.diff(table["time_s"]) >= 0.0)


@pytest.mark.parametrize("rows", ["toa", "tdoa-reference", "tdoa-adjacent"])
def test_the_rows_told_apart_are_those_of_the_labelled_scenario(rows: str) -> None:
    made = with_rows(three(), rows)
    apart = simulate_labelled(made, seed=6).told_apart()
    named = simulate(attrs.evolve(made, labelled=True, clutter=Clutter()), seed=6)
    assert apart.labelled
    assert sorted(apart.targets) == sorted(named.targets) == ["x", "y", "z"]
    for target in apart.targets:
        one, two = apart.scans(target), named.scans(target)
        np.testing.assert_array_equal(one.times, two.times)
        for a, b in zip(one.values, two.values, strict=True):
            np.testing.assert_array_equal(np.sort(a), np.sort(b))


def test_without_clutter_every_row_has_one_origin() -> None:
    labelled = simulate_labelled(three(labelled=True, clutter=Clutter()), seed=7)
    table = labelled.recording.tdoa
    assert table is not None
    assert [(name,) for name in table["target"].tolist()] == list(labelled.origins["tdoa"])


def pair(gap_m: float, resolution: float | None, rows: str, **changes: Any) -> Scenario:
    """Two that stand on the line from a to b, the second `gap_m` further from a."""
    along = np.array([9e3, 1e3]) / np.hypot(9e3, 1e3)
    place = [tuple((3e3 + d) * along) for d in (0.0, gap_m)]
    targets = [standing("x", place[0], 50), standing("y", place[1], 50)]
    made = scenario(targets=targets, noise=QUIET, labelled=False, **changes)
    return with_rows(made, rows, resolution_s=resolution)


def test_differences_closer_than_the_resolution_are_one_row_of_their_mean() -> None:
    free = simulate(pair(30.0, None, "tdoa-reference"), seed=8).tdoa
    made = simulate_labelled(pair(30.0, 1e-7, "tdoa-reference"), seed=8)
    table = made.recording.tdoa
    assert free is not None
    assert table is not None
    for station in "bcd":
        one = free["tdoa_s"][free["station"] == station].reshape(50, 2)
        two = table["tdoa_s"][table["station"] == station]
        names = {
            who
            for who, s in zip(made.origins["tdoa"], table["station"], strict=True)
            if s == station
        }
        if one[0, 1] - one[0, 0] < 1e-7:
            np.testing.assert_allclose(two, one.mean(axis=1), atol=1e-13)
            assert names == {("x", "y")}
        else:
            np.testing.assert_array_equal(two, one.ravel())
            assert names == {("x",), ("y",)}
    # on the line between a and b the difference changes by 2 * 30 m / c = 200 ns
    assert {s for s in "bcd" if np.count_nonzero(table["station"] == s) == 100} >= {"b"}
    assert made.told_apart().tdoa is not None


def test_arrivals_closer_than_the_resolution_are_one_row_of_the_first() -> None:
    clock = Clock(spread_s=0.5)
    free = simulate_labelled(pair(30.0, None, "toa", clock=clock), seed=9)
    made = simulate_labelled(pair(30.0, 1e-7 + 1e-9, "toa", clock=clock), seed=9)
    one, two = free.recording.toa, made.recording.toa
    assert one is not None
    assert two is not None
    # 30 m are 100 ns: at a the first is x, at b y; both less than the resolution
    assert len(one) == 400
    assert len(two) == 200
    assert set(made.origins["toa"]) == {("x", "y")}
    whose = {}
    for name, who in zip(one["emission"].tolist(), free.origins["toa"], strict=True):
        whose[name] = who[0]
    for station, first in (("a", "x"), ("b", "y")):
        rows = np.array([whose[n] == first for n in one["emission"].tolist()])
        mine = one["toa_s"][rows & (one["station"] == station)]
        merged = two["toa_s"][two["station"] == station]
        np.testing.assert_allclose(np.sort(merged), np.sort(mine + 15.0 / C), atol=2e-13)


def test_arrivals_are_apart_where_emissions_are() -> None:
    made = with_rows(pair(30.0, None, "toa"), "toa", jitter_s=1.0, resolution_s=1e-6)
    simulated = simulate_labelled(made, seed=10)
    assert all(len(who) == 1 for who in simulated.origins["toa"])


def test_a_chain_of_close_rows_is_one() -> None:
    made = pair(6.0, 5e-8, "tdoa-reference")
    third = standing(
        "w", (3e3 * 9e3 / np.hypot(9e3, 1e3) + 11.9, 3e3 * 1e3 / np.hypot(9e3, 1e3) + 1.3), 50
    )
    origins = simulate_labelled(attrs.evolve(made, targets=[third, *made.targets]), seed=11).origins
    assert ("w", "x", "y") in origins["tdoa"]


def test_range_rates_of_merged_differences_are_their_mean() -> None:
    noise = NoiseLevel(toa_sigma_s=1e-15, range_rate_sigma_mps=3.0)
    made = pair(1.0, None, "tdoa-reference")
    made = attrs.evolve(made, noise=noise, sampling=attrs.evolve(made.sampling, range_rate=True))
    merged = attrs.evolve(made, sampling=attrs.evolve(made.sampling, resolution_s=1e-6))
    one, two = (simulate(m, seed=12).fdoa for m in (made, merged))
    assert one is not None
    assert two is not None
    column = "range_rate_difference_mps"
    pairs = zip(one["time_s"].tolist(), one["station"].tolist(), strict=True)
    sums: dict[tuple[float, str], float] = {}
    for key, value in zip(pairs, one[column].tolist(), strict=True):
        sums[key] = sums.get(key, 0.0) + value / 2.0
    found = dict(
        zip(
            zip(two["time_s"].tolist(), two["station"].tolist(), strict=True),
            two[column].tolist(),
            strict=True,
        )
    )
    assert found.keys() == sums.keys()
    np.testing.assert_allclose([found[k] for k in sums], list(sums.values()), atol=2e-6)


def test_false_alarms_are_not_merged() -> None:
    clutter = Clutter(rate=3.0, window_s=[-1e-9, 1e-9])
    made = with_rows(three(clutter=clutter, detection=Detection()), "tdoa-reference")
    origins = [
        simulate_labelled(with_rows(made, "tdoa-reference", resolution_s=r), seed=13).origins[
            "tdoa"
        ]
        for r in (None, 1e-8)
    ]
    assert origins[0].count(()) == origins[1].count(()) > 200


@pytest.mark.parametrize("rows", ["toa", "tdoa-reference"])
def test_heights_are_of_emissions_that_say_nothing(rows: str) -> None:
    stations = [Station(name=n, position_m=p) for n, p in PLACES_3D.items()]
    targets = [standing("x", (3e3, 2e3, 4e3), 30), standing("y", (-2e3, 3e3, 2e3), 30)]
    made = scenario(
        dims=3, stations=stations, targets=targets, labelled=False, height=HeightReport(sigma_m=9.0)
    )
    made = with_rows(attrs.evolve(made, detection=Detection(probability=0.5)), rows)
    simulated = simulate_labelled(made, seed=14)
    height, toa = simulated.recording.height, simulated.recording.toa
    assert height is not None
    assert "target" not in height
    near = [("x",) if h > 3e3 else ("y",) for h in height["height_m"]]
    assert near == list(simulated.origins["height"])
    if rows == "toa":
        assert toa is not None
        who = dict(zip(toa["emission"].tolist(), simulated.origins["toa"], strict=True))
        assert [who[name] for name in height["emission"].tolist()] == near
        assert set(who) == set(height["emission"].tolist())
    else:
        assert height["emission"].tolist() == [str(i + 1) for i in range(len(height))]


def test_an_emission_whose_rows_are_all_lost_to_another_has_no_height() -> None:
    stations = [Station(name=n, position_m=p) for n, p in PLACES_3D.items()]
    # the second is at the same place but emits 10 ns later
    targets = [standing(name, (3e3, 2e3, 4e3), 30) for name in ("x", "y")]
    made = scenario(
        dims=3,
        stations=stations,
        targets=targets,
        labelled=False,
        noise=QUIET,
        height=HeightReport(sigma_m=9.0),
        sampling=Sampling(interval_s=1.0, rows="toa", resolution_s=1e-9),
    )
    recording = simulate(made, seed=15)
    assert recording.toa is not None
    assert recording.height is not None
    assert set(recording.height["emission"]) == set(recording.toa["emission"])


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32),
    rows=st.sampled_from(["toa", "tdoa-reference", "tdoa-adjacent", "tdoa-one-pair"]),
    jitter=st.sampled_from([0.0, 0.7]),
    rate=st.sampled_from([0.0, 0.5, 3.0]),
    resolution=st.sampled_from([None, 1e-7, 1e-5]),
    p=st.sampled_from([0.5, 1.0]),
)
def test_laws_of_unlabelled_recordings(
    seed: int, rows: str, jitter: float, rate: float, resolution: float | None, p: float
) -> None:
    clutter = Clutter(rate=rate, window_s=[-1e-4, 1e-4])
    made = with_rows(three(12, clutter=clutter, detection=Detection(probability=p)), rows)
    sampling = attrs.evolve(made.sampling, jitter_s=jitter, resolution_s=resolution)
    made = attrs.evolve(made, sampling=sampling)
    simulated, again = simulate_labelled(made, seed), simulate(made, seed)
    assert tables(simulated.recording) == tables(again)
    name = "toa" if rows == "toa" else "tdoa"
    table, origins = getattr(again, name), simulated.origins[name]
    assert len(origins) == len(table)
    assert np.all(np.diff(table["time_s"]) >= 0.0)
    # each target has at most one row of a station in a scan, whoever shares it
    keys = [f"{t}" if rows != "toa" else f"{int(t)}" for t in table["time_s"]]
    taken = [
        (key, station, target)
        for key, station, who in zip(keys, table["station"].tolist(), origins, strict=True)
        for target in who
    ]
    assert len(taken) == len(set(taken))
    # every true row is in the unmerged recording; with resolution none is lost, some shared
    free = simulate_labelled(
        attrs.evolve(made, sampling=attrs.evolve(sampling, resolution_s=None)), seed
    )
    assert sum(map(len, origins)) == sum(map(len, free.origins[name]))
    assert origins.count(()) == free.origins[name].count(())
    if resolution is None:
        assert max(map(len, origins)) <= 1


def test_labelled_rows_are_as_they_are_without_the_new_tables() -> None:
    plain = simulate(scenario(), seed=16).tdoa
    spelled = simulate(scenario(detection=Detection(), clutter=Clutter()), seed=16).tdoa
    assert plain is not None
    assert spelled is not None
    for name, column in rows_of(plain).items():
        np.testing.assert_array_equal(column, spelled[name])
