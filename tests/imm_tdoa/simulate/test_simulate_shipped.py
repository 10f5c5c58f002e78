"""The scenarios and the sample recording that ship with the package."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulate_cases import SEVERAL

import imm_tdoa
from imm_tdoa import IMM, Bank, simulate
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Static
from imm_tdoa.recording import Recording, read, write

SAMPLE = Path(imm_tdoa.__file__).parent / "sample"

# velocity and acceleration of the birth law, m/s and m/s²; position RMSE in m not to exceed
CASES = {
    "drone-3d": (15.0, 5.0, 9.0),
    "fdoa": (15.0, 2.0, 6.0),
    "outliers": (15.0, 3.0, 8.0),
    "sample": (30.0, 3.0, 15.0),
    "source-a": (1000.0, 10.0, 1500.0),
    "two-ships": (10.0, 0.1, 20.0),
}
SCANS = 450
MODES = (Static(psd=0.01), ConstantVelocity(psd=0.1), ConstantAcceleration(psd=1.0))


def bank(velocity: float, acceleration: float) -> Bank:
    std = {"velocity": velocity, "acceleration": acceleration}
    return Bank(MODES, mean_sojourn=60.0, birth_std=std)


def position_rmse(track: Any, recording: Recording, target: str) -> float:
    truth, _ = recording.truth_at(target, track.times)
    return float(np.sqrt(np.mean(np.sum((track.position - truth) ** 2, axis=-1))))


def test_the_shipped_names() -> None:
    assert simulate.scenarios() == tuple(sorted((*CASES, *SEVERAL)))


@pytest.mark.parametrize("name", [name for name in CASES if name != "sample"])
def test_every_other_scenario_can_be_tracked(name: str) -> None:
    velocity, acceleration, limit = CASES[name]
    recording = simulate.simulate(simulate.load(name))
    assert recording.targets == tuple(t.name for t in simulate.load(name).targets)
    for target in recording.targets:
        scans = recording.scans(target)
        every = -(-scans.count // SCANS)  # every one, or every third of the long flight
        measurement, times, values, pairs = scans.part(slice(None, None, every))
        imm = IMM(bank(velocity, acceleration), measurement, robust="gate")
        track = imm.run(times, values, pairs=pairs)
        assert np.all(np.isfinite(track.mean))
        assert position_rmse(track, recording, target) < limit


@pytest.mark.parametrize("name", CASES)
def test_every_scenario_is_written_and_read(name: str, tmp_path: Path) -> None:
    recording = simulate.simulate(simulate.load(name), seed=5)
    write(recording, tmp_path / "there")
    again = read(tmp_path / "there")
    assert again.title == recording.title
    for target in recording.targets:
        one, two = recording.scans(target), again.scans(target)
        np.testing.assert_array_equal(one.times, two.times)
        np.testing.assert_array_equal(one.values, two.values)


def test_the_sample_recording_is_made_by_the_sample_scenario(tmp_path: Path) -> None:
    write(simulate.simulate(simulate.load("sample")), tmp_path / "again")
    files = sorted(p.name for p in SAMPLE.iterdir())
    assert files == ["recording.toml", "stations.csv", "tdoa.csv", "truth.csv"]
    assert files == sorted(p.name for p in (tmp_path / "again").iterdir())
    for name in files:
        shipped, made = (folder / name for folder in (SAMPLE, tmp_path / "again"))
        assert shipped.read_text("utf-8") == made.read_text("utf-8")


def test_the_sample_recording_is_the_same_to_the_last_digit_written() -> None:
    made, shipped = simulate.simulate(simulate.load("sample")), read(SAMPLE)
    assert made.tdoa is not None
    assert made.truth is not None
    for name, table in (("tdoa", made.tdoa), ("truth", made.truth)):
        with (SAMPLE / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        assert list(rows[0]) == list(table)
        for column in table:
            cells = [row[column] for row in rows]
            if table[column].dtype.kind == "f":
                np.testing.assert_allclose(table[column], np.array(cells, dtype=float), rtol=1e-12)
            else:
                assert table[column].tolist() == cells
    np.testing.assert_array_equal(made.stations.positions, shipped.stations.positions)
    assert (made.noise, made.speed_mps) == (shipped.noise, shipped.speed_mps)


def test_the_sample_is_small_and_complete() -> None:
    assert sum(p.stat().st_size for p in SAMPLE.iterdir()) < 150_000
    recording = read(SAMPLE)
    assert len(recording.stations) == 5
    assert recording.truth is not None
    assert len(recording.truth) == 301
    _, velocity = recording.truth_at(None, [0.0])
    np.testing.assert_array_equal(velocity, [[0.0, 0.0]])
    _, _, values, pairs = recording.scans()
    assert values.shape == (301, 4)
    assert pairs is None
    missing = np.mean(np.isnan(values))
    assert 0.01 < missing < 0.06


def test_on_the_sample_the_bank_beats_each_of_its_models() -> None:
    recording = read(SAMPLE)
    measurement, times, values, _ = recording.scans()
    velocity, acceleration, limit = CASES["sample"]
    track = IMM(bank(velocity, acceleration), measurement).run(times, values)
    together = position_rmse(track, recording, "helicopter")
    assert together < limit
    for model in MODES:
        alone = IMM(Bank([model]), measurement).run(times, values)
        assert together < 0.75 * position_rmse(alone, recording, "helicopter")
    # A quarter of a minute after each change the bank says what the target does: S, V and A by leg.
    began = 0.0
    legs = simulate.load("sample").targets[0].legs
    for leg, mode in zip(legs, (0, None, 1, 2, 1, None, 0), strict=True):
        settled = (times > began + 15.0) & (times < began + leg.duration_s)
        began += leg.duration_s
        if mode is not None:
            assert track.mode_probability[settled, mode].mean() > 0.75
