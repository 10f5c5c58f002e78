"""What `simulate` makes: noise, clocks, biases, gaps and outliers against their laws."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pymap3d
import pytest
from simulate_cases import (
    PLACES,
    SIGMA,
    arrival_residuals,
    binomial_tolerance,
    covariance_tolerance,
    difference_residuals,
    rows_of,
    same,
    scenario,
    standing,
    true_arrivals,
    with_rows,
)

from imm_tdoa.simulate import Leg, Target, simulate
from imm_tdoa.simulate.faults import Clock, Dropouts, NoiseLevel, Outliers, Silence
from imm_tdoa.simulate.measuring import Frame, HeightReport, Sampling, Station

QUIET = NoiseLevel(toa_sigma_s=1e-15)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("tdoa-reference", np.eye(3) + 1.0),
        ("tdoa-adjacent", 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)),
    ],
)
def test_differences_have_the_full_covariance(rows: str, expected: Any) -> None:
    residuals = difference_residuals(simulate(with_rows(scenario(), rows), seed=1)) / SIGMA
    n = len(residuals)
    assert n == 2000
    tolerance = covariance_tolerance(expected, n)
    assert np.all(np.abs(residuals.T @ residuals / n - expected) < tolerance)
    lagged = residuals[1:].T @ residuals[:-1] / (n - 1)
    assert np.all(np.abs(lagged) < 5.0 * 2.0 / np.sqrt(n))


def test_differences_may_be_independent() -> None:
    made = scenario(noise=NoiseLevel(tdoa_sigma_s=SIGMA))
    recording = simulate(made, seed=2)
    residuals = difference_residuals(recording) / SIGMA
    tolerance = covariance_tolerance(np.eye(3), len(residuals))
    assert np.all(np.abs(residuals.T @ residuals / len(residuals) - np.eye(3)) < tolerance)
    assert recording.noise.tdoa_sigma_s == SIGMA
    assert recording.noise.toa_sigma_s is None


def test_one_pair_at_a_time() -> None:
    recording = simulate(with_rows(scenario(), "tdoa-one-pair"), seed=3)
    table = recording.tdoa
    assert table is not None
    assert len(table) == 2000
    assert len(np.unique(table["time_s"])) == 2000
    residuals = difference_residuals(recording)[:, 0] / SIGMA
    assert abs(np.mean(residuals**2) - 2.0) < 5.0 * 2.0 * np.sqrt(2.0 / 2000)
    drawn = list(zip(table["station"].tolist(), table["reference"].tolist(), strict=True))
    assert len(set(drawn)) == 6
    for pair in set(drawn):
        assert abs(drawn.count(pair) / 2000 - 1 / 6) < binomial_tolerance(1 / 6, 2000)


def test_the_unknown_clock_cancels_in_differences() -> None:
    wild = Clock(offset_s=0.25, drift=1e-5, spread_s=2.0)
    toa = with_rows(scenario(clock=wild, noise=NoiseLevel(toa_sigma_s=SIGMA)), "toa")
    arrivals = arrival_residuals(simulate(toa, seed=4))
    tdoa = difference_residuals(simulate(with_rows(toa, "tdoa-reference"), seed=4))
    # both are rounded to 1e-13 s
    np.testing.assert_allclose(arrivals[:, 1:] - arrivals[:, :1], tdoa, atol=3e-13)
    offset = arrivals.mean(axis=1)
    expected = 0.25 + 1e-5 * np.arange(2000.0)
    assert np.abs(offset - expected).max() < 1.0 + 1e-6
    assert abs(np.std(offset - expected) - 2.0 / np.sqrt(12.0)) < 0.05


def test_drift_without_spread_is_seen_exactly() -> None:
    clock = Clock(offset_s=0.5, drift=1e-6, spread_s=0.0)
    made = with_rows(scenario(clock=clock, noise=QUIET), "toa", start_s=100.0)
    made = attrs.evolve(made, targets=[attrs.evolve(made.targets[0], start_s=100.0)])
    arrivals = arrival_residuals(simulate(made))
    expected = 0.5 + 1e-6 * np.arange(2000.0)[:, None]
    np.testing.assert_allclose(arrivals, np.broadcast_to(expected, (2000, 4)), atol=2e-13)


def test_station_biases_last_and_are_common_to_all_targets() -> None:
    noise = NoiseLevel(toa_sigma_s=1e-15, bias_sigma_s=1e-7, bias_time_s=20.0)
    targets = [standing("x", scans=20_000), standing("y", (-1e3, 5e2), scans=20_000)]
    made = with_rows(scenario(noise=noise, targets=targets, clock=Clock(spread_s=0.0)), "toa")
    recording = simulate(made, seed=5)
    table = recording.toa
    assert table is not None
    errors = []
    for target, place in (("x", (3e3, 2.5e3)), ("y", (-1e3, 5e2))):
        flight = true_arrivals(recording, place)
        rows = rows_of(table, target)
        expected = np.array([flight[n] for n in rows["station"].tolist()])
        errors.append((rows["toa_s"] - expected).reshape(-1, 4) / 1e-7)
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-5)
    b = errors[0]
    # 20 000 s of a process of 20 s: about 500 independent values of each of four stations
    for lag in (0, 5, 20, 60):
        found = np.mean(b[: len(b) - lag] * b[lag:])
        assert abs(found - np.exp(-lag / 20.0)) < 5.0 * np.sqrt(2.0 / 2000)
    r = np.corrcoef(b.T) - np.eye(4)
    assert np.abs(r).max() < 5.0 / np.sqrt(500)
    assert recording.noise.bias_sigma_s == 1e-7
    assert recording.noise.bias_time_s == 20.0


def test_biases_keep_their_law_between_the_nominal_times() -> None:
    noise = NoiseLevel(toa_sigma_s=1e-15, bias_sigma_s=1e-7, bias_time_s=0.5)
    made = scenario(noise=noise, targets=[standing(scans=20_000)])
    recording = simulate(with_rows(made, "tdoa-reference", jitter_s=1.0), seed=6)
    residuals = difference_residuals(recording) / 1e-7
    # correlation over time leaves at least a quarter of the draws independent
    tolerance = covariance_tolerance(np.eye(3) + 1.0, len(residuals) // 4)
    sample = residuals.T @ residuals / len(residuals)
    assert np.all(np.abs(sample - np.eye(3) - 1.0) < tolerance)


def test_a_target_is_measured_only_while_it_exists() -> None:
    targets = [standing("x", scans=101), attrs.evolve(standing("y", scans=51), start_s=20.0)]
    recording = simulate(scenario(targets=targets))
    assert recording.tdoa is not None
    first, second = (rows_of(recording.tdoa, name)["time_s"] for name in ("x", "y"))
    assert (first.min(), first.max()) == (0.0, 100.0)
    assert (second.min(), second.max()) == (20.0, 70.0)
    assert np.all(np.diff(recording.tdoa["time_s"]) >= 0.0)
    assert recording.targets == ("x", "y")


def test_rows_stations_and_scans_drop_out_as_often_as_said() -> None:
    dropouts = Dropouts(row=0.2, scan=0.1, station={"b": 0.5, "d": 1.0})
    recording = simulate(with_rows(scenario(dropouts=dropouts), "toa"), seed=11)
    assert recording.toa is not None
    n = 2000
    share = {s: np.count_nonzero(recording.toa["station"] == s) / n for s in "abcd"}
    for station, p in (("a", 0.72), ("b", 0.36), ("c", 0.72), ("d", 0.0)):
        assert abs(share[station] - p) <= binomial_tolerance(p, n)
    scans = len(np.unique(recording.toa["emission"])) / n
    expected = 0.9 * (1.0 - (1.0 - 0.8) ** 2 * (1.0 - 0.4))
    assert abs(scans - expected) < binomial_tolerance(expected, n)


def test_without_its_reference_a_scan_has_no_differences() -> None:
    silences = [Silence(station="a", from_s=100.0, to_s=199.0), Silence(station="c", from_s=500.0)]
    made = scenario(dropouts=Dropouts(silences=silences))
    table = simulate(made).tdoa
    assert table is not None
    t = table["time_s"]
    assert not np.any((t >= 100.0) & (t <= 199.0))
    assert set(table["station"][t >= 500.0]) == {"b", "d"}
    assert set(table["station"][t < 500.0]) == {"b", "c", "d"}
    adjacent = simulate(with_rows(made, "tdoa-adjacent")).tdoa
    assert adjacent is not None
    assert np.count_nonzero((adjacent["time_s"] >= 100.0) & (adjacent["time_s"] <= 199.0)) == 200


def test_gross_errors_of_rows() -> None:
    outliers = Outliers(row=0.05, size_sigmas=50.0)
    made = scenario(outliers=outliers)
    residuals = difference_residuals(simulate(made, seed=12)) / SIGMA
    plain = difference_residuals(simulate(scenario(), seed=12)) / SIGMA
    added = residuals - plain  # the noise is the same
    hit = np.abs(added) > 1e-3
    assert abs(hit.mean() - 0.05) < binomial_tolerance(0.05, hit.size)
    assert np.abs(added[hit]).min() > 24.9
    assert np.abs(added[hit]).max() < 75.1
    assert 0.3 < (added[hit] > 0.0).mean() < 0.7


def test_gross_errors_of_a_station_are_in_all_its_differences() -> None:
    outliers = Outliers(station={"a": 0.1}, size_s=1e-5, late=True)
    residuals = difference_residuals(simulate(scenario(outliers=outliers), seed=13))
    added = residuals - difference_residuals(simulate(scenario(), seed=13))
    hit = np.abs(added) > 1e-9
    np.testing.assert_array_equal(hit, np.broadcast_to(hit[:, :1], hit.shape))
    np.testing.assert_allclose(added, np.broadcast_to(added[:, :1], added.shape), atol=3e-13)
    assert abs(hit[:, 0].mean() - 0.1) < binomial_tolerance(0.1, len(hit))
    assert np.all(added[hit] < -4.9e-6)  # the reference is late, so every difference is early


def test_range_rates_are_wrong_only_where_a_size_is_given() -> None:
    made = scenario(
        sampling=Sampling(interval_s=1.0, range_rate=True),
        noise=NoiseLevel(toa_sigma_s=SIGMA, range_rate_sigma_mps=0.1),
    )
    plain = simulate(made, seed=14)
    both = [Outliers(row=0.1, size_s=1e-5), Outliers(row=0.1, size_s=1e-5, range_rate_size_mps=9.0)]
    one, two = (simulate(attrs.evolve(made, outliers=o), seed=14) for o in both)
    assert same(plain, one, "fdoa")
    assert same(one, two, "tdoa")
    assert two.fdoa is not None
    assert plain.fdoa is not None
    column = "range_rate_difference_mps"
    added = np.abs(two.fdoa[column] - plain.fdoa[column])
    assert abs(np.mean(added > 4.0) - 0.1) < binomial_tolerance(0.1, len(added))


@pytest.mark.parametrize("kind", ["local", "enu"])
def test_reported_heights(kind: str) -> None:
    origin: dict[str, Any] = {"origin_lat_deg": 47.0, "origin_lon_deg": 9.0, "origin_height_m": 50}
    place = (2e4, -1e4, 3e3)
    stations = [Station(name=n, position_m=(*p, 10.0)) for n, p in PLACES.items()]
    made = scenario(
        dims=3,
        frame=Frame(kind=kind, **(origin if kind == "enu" else {})),
        stations=stations,
        targets=[standing(place=place)],
        height=HeightReport(sigma_m=12.0),
        dropouts=Dropouts(scan=0.3),
    )
    recording = simulate(with_rows(made, "toa"), seed=15)
    assert recording.height is not None
    assert recording.toa is not None
    assert set(recording.height["emission"]) == set(recording.toa["emission"])
    true = pymap3d.enu2geodetic(*place, 47.0, 9.0, 50.0)[2] if kind == "enu" else 3e3
    error = recording.height["height_m"] - true
    n = len(error)
    assert abs(error.mean()) < 5.0 * 12.0 / np.sqrt(n)
    assert abs(error.std() - 12.0) < 5.0 * 12.0 / np.sqrt(2.0 * n)
    np.testing.assert_array_equal(recording.height["sigma_m"], 12.0)
    assert (recording.frame is None) == (kind == "local")
    scans = recording.scans()
    assert scans.values.shape == (len(np.unique(recording.toa["emission"])), 5)


def test_parts_made_in_python_are_checked() -> None:
    for changes, message in (
        ({"stations": 3}, "stations: expected a sequence, got 3"),
        ({"targets": [3]}, r"targets\[0\]: expected a Target, got 3"),
        ({"noise": 1e-9}, "noise: expected a NoiseLevel, got 1e-09"),
        ({"height": 3.0}, "height: expected a HeightReport, got 3.0"),
        ({"title": None}, "title: expected a str, got None"),
        ({"seed": 1.0}, "seed: expected a whole number of at least 0, got 1.0"),
    ):
        with pytest.raises(ValueError, match=message):
            scenario(**changes)
    with pytest.raises(ValueError, match="station: expected probabilities by station"):
        Dropouts(station=0.2)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"scenario: expected a Scenario \(see simulate.load\)"):
        simulate("sample")  # type: ignore[arg-type]


def test_a_scenario_without_a_single_row_is_refused() -> None:
    made = scenario(dropouts=Dropouts(scan=1.0))
    with pytest.raises(ValueError, match="scenario: of 'a case' no station receives anything"):
        simulate(made)


def test_a_target_that_nobody_hears_is_in_the_truth_alone() -> None:
    late = attrs.evolve(standing("y", scans=10), start_s=300.5)
    made = scenario(targets=[standing(scans=100), attrs.evolve(late, start_s=50.2)])
    recording = simulate(attrs.evolve(made, sampling=Sampling(interval_s=20.0)))
    assert recording.truth is not None
    assert recording.targets == ("x",)
    assert set(recording.truth["target"]) == {"x"}  # none of its seconds is a scan's


def test_numbers_are_rounded_and_never_minus_zero() -> None:
    legs = [Leg(motion="constant-velocity", duration_s=50.0)]
    passing = Target(name="x", position_m=(-10.0, 0.0), velocity_mps=(0.2, -1e-9), legs=legs)
    recording = simulate(scenario(targets=[passing]), seed=1)
    assert recording.tdoa is not None
    assert recording.truth is not None
    value = recording.tdoa["tdoa_s"]
    np.testing.assert_array_equal(value, np.round(value, 13))
    for name in ("x_m", "y_m", "vx_mps", "vy_mps"):
        column = recording.truth[name]
        assert not np.any(np.signbit(column) & (column == 0.0))
