"""From rows to scans: what becomes one scan, in which column, with which noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantVelocity,
    Height,
    RangeRate,
    Stack,
    Static,
)
from imm_tdoa.recording import Noise, Recording, Table

NAMES = ("a", "b", "c", "d")
PLACE = np.array([[0.0, 0.0, 0.0], [1e3, 0.0, 10.0], [0.0, 1e3, 20.0], [1e3, 1e3, 200.0]])
STATIONS = Stations(PLACE, names=NAMES)
NOISE = Noise(toa_sigma_s=1e-7, range_rate_sigma_mps=0.2)
NAN = np.nan


def table(columns: str, *rows: tuple[Any, ...]) -> Table:
    """Return a table of rows; ``target`` and other names are text."""
    values = zip(*rows, strict=True)
    return Table(dict(zip(columns.split(), map(list, values), strict=True)), file="t.csv")


def toa(*rows: tuple[Any, ...], more: str = "") -> Table:
    return table("time_s emission station toa_s " + more, *rows)


def tdoa(*rows: tuple[Any, ...], more: str = "") -> Table:
    return table("time_s station reference tdoa_s " + more, *rows)


def made(**tables: Any) -> Recording:
    return Recording(STATIONS, **({"noise": NOISE} | tables))


def noise_std(measurement: Any, time: float) -> Any:
    """Standard deviations of the rows, in the units of the values."""
    R = measurement.noise_covariance(np.zeros(3), np.zeros(3), time)
    return np.sqrt(np.diag(R)) / measurement.scale


def test_an_emission_is_one_scan_at_its_earliest_time() -> None:
    rows = [(1.0, "m", "b", 0.1), (1.25, "n", "a", 0.2), (1.5, "m", "d", 0.3), (2.0, "n", "c", 0.4)]
    measurement, times, values, pairs = made(toa=toa(*rows)).scans()
    assert isinstance(measurement, TOA)
    assert measurement.stations is STATIONS
    assert pairs is None
    np.testing.assert_array_equal(times, [1.0, 1.25])
    np.testing.assert_array_equal(values, [[NAN, 0.1, NAN, 0.3], [0.2, NAN, 0.4, NAN]])
    np.testing.assert_allclose(noise_std(measurement, 1.0), 1e-7)


def test_two_emissions_at_one_time_are_two_scans() -> None:
    rows = [(1.0, "m", "b", 0.1), (1.0, "n", "a", 0.2), (1.0, "m", "d", 0.3)]
    _, times, values, _ = made(toa=toa(*rows)).scans()
    np.testing.assert_array_equal(times, [1.0, 1.0])
    np.testing.assert_array_equal(values, [[NAN, 0.1, NAN, 0.3], [0.2, NAN, NAN, NAN]])


def test_kinds_are_stacked_in_order_and_joined_by_emission_and_time() -> None:
    recording = made(
        toa=toa((1.0, "m", "a", 0.1), (1.0, "m", "b", 0.2), (3.0, "n", "a", 0.3)),
        range_rate=table("time_s emission station range_rate_mps", (1.0, "m", "d", 5.0)),
        height=table("time_s emission height_m sigma_m", (3.0, "n", 700.0, 30.0)),
        tdoa=tdoa((1.0, "b", "a", 0.01), (1.0, "c", "a", 0.02), (2.0, "b", "a", 0.03)),
        fdoa=table(
            "time_s station reference range_rate_difference_mps",
            (2.0, "c", "d", 1.0),
            (3.0, "b", "a", 2.0),
        ),
    )
    measurement, times, values, pairs = recording.scans()
    assert isinstance(measurement, Stack)
    assert [type(m) for m in measurement.models] == [TOA, RangeRate, Height, TDOA, FDOA]
    np.testing.assert_array_equal(times, [1.0, 2.0, 3.0])
    no = [NAN] * 4
    expected = [
        [0.1, 0.2, NAN, NAN, NAN, NAN, NAN, 5.0, NAN, 0.01, 0.02, NAN],
        [*no, *no, NAN, 0.03, NAN, 1.0],
        [0.3, NAN, NAN, NAN, *no, 700.0, NAN, NAN, 2.0],
    ]
    np.testing.assert_array_equal(values, expected)
    assert pairs is not None  # that of the range-rate difference changes
    expected_pairs = [
        [[1, 0], [2, 0], [1, 0]],
        [[1, 0], [2, 0], [2, 3]],
        [[1, 0], [2, 0], [1, 0]],
    ]
    np.testing.assert_array_equal(pairs, expected_pairs)
    std = noise_std(measurement.with_pairs(pairs[1]), 2.0)
    root2 = np.sqrt(2.0)
    np.testing.assert_allclose(
        std, [*[1e-7] * 4, *[0.2] * 4, 30.0, *[root2 * 1e-7] * 2, root2 * 0.2]
    )


def test_pairs_that_fit_into_columns_stay_there() -> None:
    rows = [(1.0, "b", "a", 0.1), (1.0, "c", "a", 0.2), (2.0, "c", "a", 0.3), (3.0, "b", "a", 0.4)]
    measurement, _, values, pairs = made(tdoa=tdoa(*rows)).scans()
    assert isinstance(measurement, TDOA)
    assert pairs is None
    np.testing.assert_array_equal(measurement.pairs, [[1, 0], [2, 0]])
    np.testing.assert_array_equal(values, [[0.1, 0.2], [NAN, 0.3], [0.4, NAN]])


def test_one_pair_at_a_time() -> None:
    rows = [(1.0, "b", "a", 0.1), (2.0, "c", "b", 0.2), (3.0, "a", "d", 0.3)]
    measurement, times, values, pairs = made(tdoa=tdoa(*rows)).scans()
    np.testing.assert_array_equal(times, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(values, [[0.1], [0.2], [0.3]])
    np.testing.assert_array_equal(pairs, [[[1, 0]], [[2, 1]], [[0, 3]]])
    np.testing.assert_array_equal(measurement.pairs, [[1, 0]])


def test_padding_has_a_pair_that_exists_and_no_value() -> None:
    rows = [(1.0, "b", "a", 0.1), (2.0, "c", "b", 0.2), (2.0, "d", "c", 0.3)]
    _, _, values, pairs = made(tdoa=tdoa(*rows)).scans()
    np.testing.assert_array_equal(values, [[0.1, NAN], [0.2, 0.3]])
    np.testing.assert_array_equal(pairs, [[[1, 0], [1, 0]], [[2, 1], [3, 2]]])


def test_differences_of_shared_arrivals_are_correlated() -> None:
    rows = [(1.0, "b", "a", 0.1), (1.0, "c", "a", 0.2)]
    measurement = made(tdoa=tdoa(*rows)).scans().measurement
    R = measurement.noise_covariance(np.zeros(3), np.zeros(3), 1.0) / measurement.scale[0] ** 2
    np.testing.assert_allclose(R, 1e-14 * np.array([[2.0, 1.0], [1.0, 2.0]]))
    noise = Noise(toa_sigma_s=1e-7, tdoa_sigma_s=3e-7)
    measurement = made(tdoa=tdoa(*rows), noise=noise).scans().measurement
    R = measurement.noise_covariance(np.zeros(3), np.zeros(3), 1.0) / measurement.scale[0] ** 2
    np.testing.assert_allclose(R, 9e-14 * np.eye(2), atol=1e-30)


def test_own_sigma_goes_before_noise() -> None:
    rows = [
        (1.0, "b", "a", 0.1, 5e-7),
        (1.0, "c", "a", 0.2, NAN),
        (2.0, "c", "a", 0.3, 7e-7),
    ]
    measurement = made(tdoa=tdoa(*rows, more="sigma_s")).scans().measurement
    np.testing.assert_allclose(noise_std(measurement, 1.0), [5e-7, np.sqrt(2) * 1e-7])
    np.testing.assert_allclose(noise_std(measurement, 2.0)[1], 7e-7)
    arrivals = [(1.0, "m", "a", 0.1, 5e-7), (2.0, "n", "c", 0.2, NAN)]
    measurement = made(toa=toa(*arrivals, more="sigma_s")).scans().measurement
    np.testing.assert_allclose(noise_std(measurement, 1.0)[0], 5e-7)
    np.testing.assert_allclose(noise_std(measurement, 2.0)[2], 1e-7)


def test_the_larger_of_two_sigmas_at_one_time() -> None:
    rows = [(1.0, "m", "a", 0.1, 5e-7), (1.0, "n", "a", 0.2, 6e-7), (1.0, "n", "b", 0.2, 1e-7)]
    measurement, times, _, _ = made(toa=toa(*rows, more="sigma_s")).scans()
    np.testing.assert_array_equal(times, [1.0, 1.0])
    np.testing.assert_allclose(noise_std(measurement, 1.0)[:2], [6e-7, 1e-7])


def test_floor_and_lasting_error() -> None:
    noise = Noise(toa_sigma_s=1e-7, sigma_floor_s=3e-7, bias_sigma_s=4e-7, bias_time_s=60.0)
    rows = [(1.0, "m", "a", 0.1, 1e-8), (1.0, "m", "b", 0.1, 7.5e-7), (1.0, "m", "c", 0.1, NAN)]
    recording = made(toa=toa(*rows, more="sigma_s"), noise=noise)
    std = noise_std(recording.scans().measurement, 1.0)
    np.testing.assert_allclose(std[:3], [5e-7, 8.5e-7, 5e-7])
    differences = tdoa((1.0, "b", "a", 0.1))
    std = noise_std(made(tdoa=differences, noise=noise).scans().measurement, 1.0)
    np.testing.assert_allclose(std, [np.sqrt(2) * 5e-7])
    rates = table("time_s emission station range_rate_mps sigma_mps", (1.0, "m", "a", 1.0, 1e-9))
    std = noise_std(made(range_rate=rates, noise=noise).scans().measurement, 1.0)
    np.testing.assert_allclose(std, 1e-9)


def test_rows_that_nobody_gives_a_sigma() -> None:
    none = Noise()
    rates = table("time_s emission station range_rate_mps", (1.0, "m", "a", 1.0))
    differences = table("time_s station reference range_rate_difference_mps", (1.0, "a", "b", 1.0))
    cases = {
        "toa": (toa((1.0, "m", "a", 0.1, 1.0), (1.0, "m", "b", 0.1, NAN), more="sigma_s"), "toa"),
        "tdoa": (tdoa((1.0, "b", "a", NAN), (1.0, "c", "a", 0.1)), "toa_sigma_s or tdoa"),
        "range_rate": (rates, "range_rate_sigma_mps"),
        "fdoa": (differences, "range_rate_sigma_mps"),
    }
    for name, (rows, key) in cases.items():
        row = len(rows) - 1
        what = rf"^t\.csv\[{row}\]: sigma_(s|mps): expected a standard deviation: .*no {key}"
        with pytest.raises(ValueError, match=what):
            made(noise=none, **{name: rows}).scans()
    height = table("time_s emission height_m", (1.0, "m", 700.0))
    with pytest.raises(ValueError, match=r"^t\.csv\[0\]: sigma_m: .* \[noise\] has none"):
        made(toa=toa((1.0, "m", "a", 0.1)), height=height).scans()


def test_a_missing_value_drops_its_row() -> None:
    rows = [(1.0, "m", "a", NAN, NAN), (1.0, "m", "b", 0.2, 1e-7), (2.0, "n", "a", NAN, NAN)]
    measurement, times, values, _ = made(toa=toa(*rows, more="sigma_s"), noise=Noise()).scans()
    np.testing.assert_array_equal(times, [1.0, 2.0])
    np.testing.assert_array_equal(values[:, :2], [[NAN, 0.2], [NAN, NAN]])
    np.testing.assert_allclose(noise_std(measurement, 1.0)[1], 1e-7)


def test_targets_in_order_of_first_appearance() -> None:
    rows = [(1.0, "m", "a", 0.1, "9"), (1.5, "m", "a", 0.3, "10"), (2.0, "n", "b", 0.2, "9")]
    differences = tdoa((0.5, "b", "a", 0.1, "ship"), (1.5, "b", "a", 0.1, "10"), more="target")
    recording = made(toa=toa(*rows, more="target"), tdoa=differences)
    assert recording.targets == ("ship", "9", "10")
    _, times, values, _ = recording.scans("9")
    np.testing.assert_array_equal(times, [1.0, 2.0])
    assert values.shape == (2, 4)
    scans = recording.scans("10")
    assert isinstance(scans.measurement, Stack)
    np.testing.assert_array_equal(scans.times, [1.5])
    with pytest.raises(ValueError, match="target: expected the name of one of 3 targets: ship, 9"):
        recording.scans()
    with pytest.raises(ValueError, match="target: no target 'boat'; there are ship, 9, 10"):
        recording.scans("boat")


def truth(*targets: str) -> Table:
    rows = [(t, name, 1.0, 2.0, 3.0) for name in targets for t in (0.0, 1.0)]
    return table("time_s target x_m y_m z_m", *rows)


def test_a_lone_target_has_the_name_of_the_truth() -> None:
    arrivals = toa((1.0, "m", "a", 0.1))
    assert made(toa=arrivals).targets == ("emitter",)
    assert made(toa=arrivals, truth=truth("car")).targets == ("car",)
    assert made(toa=arrivals, truth=truth("car", "bus")).targets == ("emitter",)
    assert made(toa=arrivals, truth=truth("car")).scans("car").count == 1


def test_unlabelled_rows_of_several_emitters_are_refused() -> None:
    arrivals = toa((1.0, "m", "a", 0.1), (2.0, "n", "a", 0.1))
    what = "labelled: false, and the rows are of 2 emitters: imm-tdoa track .* finds out"
    for recording in (
        made(toa=arrivals, truth=truth("car", "bus"), labelled=False),
        made(
            toa=toa((1.0, "m", "a", 0.1, "x"), (2.0, "n", "a", 0.1, "y"), more="target"),
            labelled=False,
        ),
    ):
        assert len(recording.targets) == 1
        with pytest.raises(ValueError, match=what):
            recording.scans()
    with pytest.raises(ValueError, match="nobody knows how many emitters"):
        made(toa=arrivals, labelled=False).scans()


def test_unlabelled_rows_that_may_be_false_alarms_are_refused() -> None:
    """Of one true target, in a table without names; where all rows name it they are its own."""
    nameless = toa((1.0, "m", "a", 0.1), (2.0, "n", "a", 0.1))
    named = toa((1.0, "m", "a", 0.1, "car"), (2.0, "n", "a", 0.1, "car"), more="target")
    differences = tdoa((3.0, "b", "a", 0.1))
    for tables in ({"toa": nameless}, {"toa": named, "tdoa": differences}):
        recording = made(labelled=False, truth=truth("car"), **tables)
        with pytest.raises(ValueError, match="may be of one emitter and false alarms: imm-tdoa"):
            recording.scans()
    for true in (truth("car"), None):
        assert made(toa=named, labelled=False, truth=true).scans().count == 2


def test_unlabelled_emitters_may_share_a_pair_and_a_time() -> None:
    rows = tdoa((1.0, "b", "a", 0.1), (1.0, "b", "a", 0.2))
    assert made(tdoa=rows, labelled=False, truth=truth("car", "bus")).targets == ("emitter",)
    with pytest.raises(ValueError, match="duplicate row"):
        made(tdoa=rows)


def test_arrivals_too_far_from_their_zero() -> None:
    rows = [(1.0, "m", "a", 0.1), (1.0, "m", "b", 1.7e9)]
    what = r"^t\.csv\[1\]: toa_s: at 1700000000\.0 s numbers are held in steps of 2\.4e-07 s"
    with pytest.raises(ValueError, match=what):
        made(toa=toa(*rows)).scans()


def test_stations_that_were_not_sampled_are_unheard() -> None:
    positions = np.stack([PLACE, PLACE, PLACE])
    positions[0, 3] = NAN
    stations = Stations(positions, times=np.arange(3.0), names=NAMES)
    arrivals = toa((0.5, "m", "a", 0.1), (0.5, "m", "d", 0.1), (1.5, "n", "d", 0.1))
    measurement, times, _, _ = Recording(stations, toa=arrivals, noise=NOISE).scans()
    heard = np.isfinite(measurement.predict(np.zeros(3), np.zeros(3), times))
    np.testing.assert_array_equal(heard[:, 3], [False, True])


def test_asynchronous_rows_go_through_the_filter_like_the_same_rows_in_arrays() -> None:
    rng = np.random.default_rng(5)
    stations = Stations(PLACE[:, :2], names=NAMES)
    times = np.arange(1.0, 21.0)
    path = np.array([300.0, 400.0]) + np.outer(times, [5.0, -3.0])
    ranges = np.linalg.norm(path[:, None] - PLACE[:, :2], axis=-1)
    arrival = ranges / 343.0 + rng.normal(scale=1e-3, size=ranges.shape)
    arrival[7, 2] = arrival[12, 0] = NAN
    rows = [
        (t, f"m{k}", NAMES[s], arrival[k, s])
        for k, t in enumerate(times)
        for s in rng.permutation(4)
        if np.isfinite(arrival[k, s])
    ]
    recording = Recording(stations, toa=toa(*rows), noise=Noise(toa_sigma_s=1e-3), speed_mps=343.0)
    scans = recording.scans()
    bank = Bank([Static(psd=0.1), ConstantVelocity(psd=1.0)], birth_std={"velocity": 10.0})
    track = IMM(bank, scans.measurement).run(scans.times, scans.values)
    same = IMM(bank, TOA(stations, sigma=1e-3, speed=343.0)).run(times, arrival)
    np.testing.assert_allclose(track.mean, same.mean, rtol=0.0, atol=1e-9)
    assert np.linalg.norm(track.position[-1] - path[-1]) < 3.0
