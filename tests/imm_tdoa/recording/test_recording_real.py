"""The real recordings beside the project read, and say what their own pages say of them."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imm_tdoa import recording
from imm_tdoa.models import TOA, Height, RangeRate, Stack
from imm_tdoa.recording import Recording

DATA = Path(__file__).parents[4] / "shared" / "data"
pytestmark = [
    pytest.mark.recordings,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the real recordings are not at {DATA.name}"),
]


def first_rows(folder: Path, name: str, count: int) -> list[dict[str, str]]:
    """The first rows of a CSV, by the standard library alone."""
    with (folder / name).open(newline="") as file:
        return list(itertools.islice(csv.DictReader(file), count))


def spread(differences: Any) -> float:
    """Robust standard deviation: the median absolute deviation, scaled for a Gaussian."""
    return float(1.4826 * np.median(np.abs(differences - np.median(differences))))


def all_pairs(residuals: Any) -> Any:
    """Differences of all pairs of stations of each scan (T, S), NaN left out."""
    i, j = np.triu_indices(residuals.shape[1], 1)
    differences = residuals[:, j] - residuals[:, i]
    return differences[np.isfinite(differences)]


@pytest.fixture(scope="module")
def drive() -> Recording:
    return recording.read(DATA / "gnss_phone_drive")


def test_drive_is_read(drive: Recording) -> None:
    assert drive.targets == ("phone",)
    assert drive.dims == 3
    measurement, times, values, pairs = drive.scans()
    assert isinstance(measurement, Stack)
    assert [type(m) for m in measurement.models] == [TOA, RangeRate]
    S = len(drive.stations)
    assert values.shape == (1985, 2 * S)
    assert np.isfinite(values[:, :S]).sum() == 14713
    assert np.isfinite(values[:, S:]).sum() == 14713
    assert pairs is None
    np.testing.assert_array_equal(times, np.arange(1985.0))
    folder = DATA / "gnss_phone_drive"
    for name, column, sigma, offset in (
        ("toa.csv", "toa_s", "sigma_s", 0),
        ("range_rate.csv", "range_rate_mps", "sigma_mps", S),
    ):
        R = measurement.noise_covariance(np.zeros(3), np.zeros(3), 0.0)
        for row in first_rows(folder, name, 4):
            i = offset + drive.stations.names.index(row["station"])
            assert values[0, i] == float(row[column])
            std = float(row[sigma]) * measurement.scale[i]
            np.testing.assert_allclose(R[i, i], std**2)
    where, speed = drive.stations.at(0.0)
    for row in first_rows(folder, "stations.csv", 4):
        i = drive.stations.names.index(row["station"])
        np.testing.assert_array_equal(where[i], [float(row[f"{a}_m"]) for a in "xyz"])
        np.testing.assert_array_equal(speed[i], [float(row[f"v{a}_mps"]) for a in "xyz"])


def test_drive_residuals_are_those_of_its_page(drive: Recording) -> None:
    measurement, times, values, _ = drive.scans()
    position, velocity = drive.truth_at("phone", times)
    assert velocity is not None
    S = len(drive.stations)
    residuals = values * measurement.scale - measurement.predict(position, velocity, times)
    R = measurement.noise_covariance(position, velocity, times)
    sigma = np.sqrt(np.einsum("tii->ti", R))
    for rows, std, robust in ((slice(0, S), 20.1, 11.02), (slice(S, 2 * S), 1.7, 0.1537)):
        differences = all_pairs(residuals[:, rows])
        assert len(differences) == 47905
        assert np.std(differences) == pytest.approx(std, rel=5e-3)
        assert spread(differences) == pytest.approx(robust, rel=1e-3)
        i, j = np.triu_indices(S, 1)
        pair_sigma = np.hypot(sigma[:, rows][:, i], sigma[:, rows][:, j])
        scaled = (residuals[:, rows][:, j] - residuals[:, rows][:, i]) / pair_sigma
        assert spread(scaled[np.isfinite(scaled)]) == pytest.approx(1.0, abs=0.03)


def test_drive_truth_velocity_is_the_slope_of_its_position(drive: Recording) -> None:
    t = np.linspace(100.0, 1900.0, 601)
    h = 1e-4
    ahead, back = (drive.truth_at("phone", t + s)[0] for s in (h, -h))
    velocity = drive.truth_at("phone", t)[1]
    assert velocity is not None
    between = np.abs(t - np.round(t)) > 0.01
    slope = (ahead - back) / (2.0 * h)
    np.testing.assert_allclose(velocity[between], slope[between], atol=1e-5)


@pytest.mark.parametrize("number", range(1, 9))
def test_aircraft_are_read(number: int) -> None:
    folder = DATA / "locards_mlat" / f"set{number}"
    made = recording.read(folder)
    first = first_rows(folder, "toa.csv", 5)
    assert made.targets[0] == first[0]["target"]
    scans = {name: made.scans(name) for name in made.targets}
    assert made.toa is not None
    assert made.height is not None
    assert sum(s.count for s in scans.values()) == len(made.height)
    measurement, times, values, pairs = scans[made.targets[0]]
    assert isinstance(measurement, Stack)
    assert [type(m) for m in measurement.models] == [TOA, Height]
    assert values.shape[1] == len(made.stations) + 1
    assert pairs is None
    assert times[0] == float(first[0]["time_s"])
    for row in first:
        assert values[0, made.stations.names.index(row["station"])] == float(row["toa_s"])
    assert values[0, -1] == float(first_rows(folder, "height.csv", 1)[0]["height_m"])
    assert np.isfinite(values[:, :-1]).sum() == 5 * len(values)
    assert noise_of(measurement, times[0])[-1] == pytest.approx(150.0)


def noise_of(measurement: Any, time: float) -> Any:
    R = measurement.noise_covariance(np.zeros(3), np.zeros(3), time)
    return np.sqrt(np.diag(R))


def test_aircraft_residuals_are_those_of_their_page() -> None:
    made = recording.read(DATA / "locards_mlat" / "set1")
    assert len(made.targets) == 118
    differences, heights = [], []
    for target in made.targets:
        measurement, times, values, _ = made.scans(target)
        position, velocity = made.truth_at(target, times)
        assert np.isfinite(position).all()
        assert velocity is None
        predicted = measurement.predict(position, np.zeros_like(position), times)
        residuals = values * measurement.scale - predicted
        differences.append(all_pairs(residuals[:, :-1]))
        heights.append(residuals[:, -1])
    every = np.concatenate(differences)
    assert len(every) == 3520
    assert np.std(every) == pytest.approx(105.8, rel=1e-3)
    assert spread(every) == pytest.approx(42.65, rel=1e-3)
    # Pressure altitude is from 99 m below to 297 m above the GPS height, in the median 114 m
    # above, over all eight sets.
    above = np.concatenate(heights)
    assert np.min(above) > -99.5
    assert np.max(above) < 297.5
    assert np.median(above) == pytest.approx(114.0, abs=30.0)


ROCKETS = {
    "2022-09-23_lora1": (627, 466),
    "2022-09-23_lora2": (529, 452),
    "2022-09-25_lora1": (588, None),
    "2022-09-25_lora2": (363, None),
}


@pytest.mark.parametrize("name", ROCKETS)
def test_rockets_are_read(name: str) -> None:
    count, complete = ROCKETS[name]
    folder = DATA / "rocket_lora" / name
    made = recording.read(folder)
    assert made.targets == ("emitter",)
    measurement, times, values, pairs = made.scans()
    assert isinstance(measurement, TOA)
    assert values.shape == (count, 4)
    assert pairs is None
    if complete is not None:
        assert np.isfinite(values).all(axis=1).sum() == complete
    for row in first_rows(folder, "toa.csv", 3):
        assert times[0] == float(row["time_s"])
        assert values[0, made.stations.names.index(row["station"])] == float(row["toa_s"])
    assert made.noise.toa_sigma_s is not None
    np.testing.assert_allclose(
        noise_of(measurement, times[0]), 299792458.0 * made.noise.toa_sigma_s
    )
    assert np.isnan(made.truth_at(None, times)[0]).all()


def test_real_recordings_survive_writing(tmp_path: Path, drive: Recording) -> None:
    from recording_cases import assert_same

    for folder in ("locards_mlat/set3", "rocket_lora/2022-09-25_lora2"):
        made = recording.read(DATA / folder)
        recording.write(made, tmp_path / folder)
        assert_same(recording.read(tmp_path / folder), made)
    recording.write(drive, tmp_path / "drive", tables="parquet")
    assert_same(recording.read(tmp_path / "drive"), drive)
