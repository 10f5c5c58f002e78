"""The shipped scenarios of several emitters are what their notes say."""

from __future__ import annotations

from pathlib import Path

import attrs
import numpy as np
import pytest
from simulate_cases import SEVERAL, binomial_tolerance

from imm_tdoa import IMM, Bank, Stations, bounds, simulate
from imm_tdoa.models import ConstantVelocity
from imm_tdoa.recording import read, write


@pytest.mark.parametrize("name", SEVERAL)
def test_every_scenario_is_made_written_and_read(name: str, tmp_path: Path) -> None:
    targets, stations, labelled = SEVERAL[name]
    made = simulate.load(name)
    assert len(made.notes) > 100
    if name == "many-aircraft":  # the first twenty of them take a tenth of the time
        made = attrs.evolve(made, swarms=[attrs.evolve(made.swarms[0], count=20)])
        targets = 20
    recording = simulate.simulate(made)
    assert len(made.emitters) == targets
    assert len(recording.stations) == stations
    assert recording.labelled == labelled
    assert recording.truth is not None
    assert set(recording.truth["target"]) == {t.name for t in made.emitters}
    write(recording, tmp_path / "there")
    again = read(tmp_path / "there")
    for table, rows in recording.measured.items():
        for column in rows:
            np.testing.assert_array_equal(again.measured[table][column], rows[column])


def test_three_emitters_are_those_of_source_a() -> None:
    made, single = simulate.load("three-emitters"), simulate.load("source-a")
    assert made.stations == single.stations
    assert (made.noise, made.sampling) == (single.noise, single.sampling)
    for one, two in zip(made.targets, single.targets, strict=True):
        assert (one.name, one.position_m, one.velocity_mps) == (
            two.name,
            two.position_m,
            two.velocity_mps,
        )
    simulated = simulate.simulate_labelled(made)
    table, who = simulated.recording.tdoa, simulated.origins["tdoa"]
    assert table is not None
    assert len(set(table["time_s"].tolist())) == 60
    possible = 60 * 3 * 3
    found = sum(map(len, who)) / possible
    assert abs(found - 0.9) < binomial_tolerance(0.9, possible)
    # two per station and scan
    assert abs(who.count(()) - 360) < 5.0 * np.sqrt(360)


def test_the_crossing_is_at_ten_degrees_and_a_hundred_seconds() -> None:
    made = simulate.load("crossing")
    north, south = (simulate.trajectory(t, [0.0, 100.0, 200.0]) for t in made.targets)
    np.testing.assert_allclose(north.position[1], [0.0, 2000.0], atol=1e-9)
    np.testing.assert_allclose(south.position[1], [0.0, 2000.0], atol=1e-9)
    a, b = north.velocity[1], south.velocity[1]
    angle = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    assert abs(angle - 10.0) < 0.01
    assert abs(np.linalg.norm(a) - 30.0) < 0.01
    assert north.position[0, 1] < south.position[0, 1]
    assert north.position[2, 1] > south.position[2, 1]


def test_the_parallel_ones_are_three_sigma_apart() -> None:
    made = simulate.load("parallel")
    t = np.linspace(0.0, 200.0, 21)
    left, right = (simulate.trajectory(target, t) for target in made.targets)
    gap = left.position - right.position
    np.testing.assert_allclose(gap, np.broadcast_to([0.0, 27.0], gap.shape), atol=1e-9)
    stations = Stations(np.array([s.position_m for s in made.stations]))
    middle = 0.5 * (left.position + right.position)
    bound = [bounds.crlb(stations, p, toa_sigma=made.noise.toa_sigma_s)[1, 1] for p in middle]
    sigma = np.sqrt(bound)
    assert abs(27.0 / sigma.mean() - 3.0) < 0.1
    assert sigma.min() > 8.2
    assert sigma.max() < 9.5


def test_in_the_busy_sky_emitters_come_go_and_fall_together() -> None:
    simulated = simulate.simulate_labelled(simulate.load("busy-sky"))
    truth, who = simulated.recording.truth, simulated.origins["tdoa"]
    assert truth is not None
    lives = [truth["time_s"][truth["target"] == n] for n in np.unique(truth["target"])]
    assert len({life[0] for life in lives}) > 15
    assert len({life[-1] for life in lives}) > 15
    assert 0.01 < np.mean([len(names) > 1 for names in who]) < 0.1
    assert 0.01 < who.count(()) / len(who) < 0.1


def test_the_labels_are_enough_to_track_them() -> None:
    simulated = simulate.simulate_labelled(simulate.load("crossing"))
    apart = simulated.told_apart()
    bank = Bank([ConstantVelocity(psd=0.01)], birth_std={"velocity": 60.0})
    for target in apart.targets:
        measurement, times, values, pairs = apart.scans(target)
        track = IMM(bank, measurement).run(times, values, pairs=pairs)
        truth, _ = apart.truth_at(target, track.times)
        error = np.linalg.norm(track.position - truth, axis=-1)
        assert np.sqrt(np.mean(error[10:] ** 2)) < 9.0  # better than a fix
