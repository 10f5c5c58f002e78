# ruff: noqa: E501
"""Scenario files: what they may say, and where an error is found."""

from __future__ import annotations

from pathlib import Path

import attrs
import pytest
from simulate_cases import assert_refused

from imm_tdoa import simulate

TEXT = """
title = "A case"
dims = 2

[[stations]]
name = "a"
position_m = [0, 0.0]

[[stations]]
name = "b"
position_m = [1000.0, 0.0]

[[stations]]
name = "c"
position_m = [0.0, 1000.0]
velocity_mps = [1.0, 0.0]

[sampling]
interval_s = 1
rows = "toa"

[noise]
toa_sigma_s = 1e-8

[clock]
drift = 1e-9

[dropouts]
row = 0.1
station = { a = 0.2 }

[[dropouts.silences]]
station = "b"
from_s = 3.0

[outliers]
row = 0.01
size_s = 1e-6

[[targets]]
name = "x"
position_m = [300, 400]

[[targets.legs]]
motion = "static"
duration_s = 5

[[targets.legs]]
motion = "turn"
duration_s = 5.0
turn_rate_dps = 3.0
velocity_mps = [10, 0]
"""

ENU = '[frame]\nkind = "enu"\norigin_lat_deg = {}\norigin_lon_deg = 9.0\n\n[noise]'


def test_a_file_says_all_there_is() -> None:
    scenario = simulate.read(TEXT)
    assert scenario.station_names == ("a", "b", "c")
    assert [s.moving for s in scenario.stations] == [False, False, True]
    assert scenario.stations[0].position_m == (0.0, 0.0)
    assert isinstance(scenario.stations[0].position_m[0], float)
    assert scenario.dropouts.station == {"a": 0.2}
    assert scenario.dropouts.silences[0].to_s is None
    assert scenario.outliers.size_s == 1e-6
    leg = scenario.targets[0].legs[1]
    assert leg.velocity_mps == (10.0, 0.0)
    assert leg.turn_rate_dps == 3.0
    assert scenario.end_s == 10.0
    assert scenario.seed == 0
    assert scenario.frame.axes() is None
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        scenario.dims = 3  # type: ignore[misc]
    framed = simulate.read(TEXT.replace("[noise]", ENU.format(47.5)))
    axes = framed.frame.axes()
    assert axes is not None
    assert (axes.lat_deg, axes.lon_deg, axes.height_m) == (47.5, 9.0, 0.0)


BAD = [
    # deep inside
    ("duration_s = 5.0", "duration_s = -3", "targets[0].legs[1].duration_s: expected a number above 0, got -3"),
    # keys
    ("duration_s = 5.0", "duraton_s = 5.0", "targets[0].legs[1].duraton_s: unknown key (did you mean 'duration_s'?); there are: motion, duration_s, "),
    ('title = "A case"', "", "title: missing"),
    ("[noise]", "[nose]", "nose: unknown key (did you mean 'noise'?)"),
    ("interval_s = 1\n", "", "sampling.interval_s: missing"),
    ("turn_rate_dps = 3.0", "", "targets[0].legs[1].turn_rate_dps: a 'turn' leg needs turn_rate_dps"),
    # kinds of values
    ("dims = 2", "dims = 2.0", "dims: expected a whole number, got 2.0"),
    ("dims = 2", "dims = true", "dims: expected a whole number, got True"),
    ('title = "A case"', "title = 3", "title: expected text in quotes, got 3"),
    ("interval_s = 1", 'interval_s = "1"', "sampling.interval_s: expected a number, got '1'"),
    ("interval_s = 1", "interval_s = true", "sampling.interval_s: expected a number, got True"),
    ("interval_s = 1", "interval_s = inf", "sampling.interval_s: expected a finite number, got inf"),
    ("interval_s = 1", "interval_s = 1\nrange_rate = 1", "sampling.range_rate: expected true or false, got 1"),
    ("position_m = [300, 400]", "position_m = 300", "targets[0].position_m: expected a list of numbers, got 300"),
    ("position_m = [300, 400]", 'position_m = "ab"', "targets[0].position_m: expected a list of numbers, got 'ab'"),
    ("position_m = [300, 400]", "position_m = [300, '4']", "targets[0].position_m[1]: expected a number, got '4'"),
    ("[noise]\ntoa_sigma_s = 1e-8", "", "noise: missing"),
    ("station = { a = 0.2 }", "station = 0.2", "dropouts.station: expected a table, got 0.2"),
    ("station = { a = 0.2 }", "station = { a = 'x' }", "dropouts.station.a: expected a number, got 'x'"),
    # numbers out of range
    ("dims = 2", "dims = 4", "dims: expected one of 2, 3, got 4"),
    ("dims = 2", "dims = 2\nseed = -1", "seed: expected a whole number of at least 0, got -1"),
    ("dims = 2", "dims = 2\nspeed_mps = 0", "speed_mps: expected a number above 0, got 0"),
    ("toa_sigma_s = 1e-8", "toa_sigma_s = -1e-8", "noise.toa_sigma_s: expected a number above 0, got -1e-08"),
    ("row = 0.1", "row = 10", "dropouts.row: expected a probability from 0 to 1, got 10"),
    ("station = { a = 0.2 }", "station = { a = -1 }", "dropouts.station.a: expected a probability from 0 to 1, got -1"),
    ("interval_s = 1", "interval_s = 1\njitter_s = 2", "sampling.jitter_s: expected at most interval_s, 1 s"),
    ("from_s = 3.0", "from_s = 3.0\nto_s = 2.0", "dropouts.silences[0].to_s: expected a time after from_s, 3 s, got 2"),
    ("[noise]", ENU.format(95.0), "frame.origin_lat_deg: expected a number within ±90, got 95.0"),
    # choices
    ('rows = "toa"', 'rows = "tda"', "sampling.rows: expected one of 'toa', 'tdoa-reference', 'tdoa-adjacent', 'tdoa-one-pair', got 'tda'"),
    ('motion = "static"', 'motion = "standing"', "targets[0].legs[0].motion: expected one of 'static', 'constant-velocity', 'constant-acceleration', 'turn', got 'standing'"),
    ("[noise]", '[frame]\nkind = "moon"\n[noise]', "frame.kind: expected one of 'local', 'enu', got 'moon'"),
    # what does not go together
    ("position_m = [300, 400]", "position_m = [300]", "targets[0].legs[1].velocity_mps: expected as many numbers as in position_m, 1, got 2"),
    ("dims = 2", "dims = 3", "stations[0].position_m: expected 3 numbers (dims = 3), got 2"),
    ("position_m = [1000.0, 0.0]", "position_m = [0.0, 0.0]", "stations[1].position_m: the same as that of 'a'"),
    ('name = "b"', 'name = "a"', "stations[1].name: 'a' appears twice"),
    ('name = "b"', 'name = " b"', "stations[1].name: expected a name of printable characters"),
    ('station = "b"', 'station = "q"', "dropouts.silences[0].station: there is no station 'q'; there are: a, b, c"),
    ("station = { a = 0.2 }", "station = { q = 0.2 }", "dropouts.station.q: there is no station 'q'"),
    ("row = 0.01", "row = 0.01\nstation = { q = 0.2 }", "outliers.station.q: there is no station 'q'"),
    ("toa_sigma_s = 1e-8", "toa_sigma_s = 1e-8\ntdoa_sigma_s = 1e-8", "noise.toa_sigma_s: expected exactly one of toa_sigma_s and tdoa_sigma_s"),
    ("toa_sigma_s = 1e-8", "tdoa_sigma_s = 1e-8", "noise.toa_sigma_s: missing, where sampling.rows = 'toa'"),
    ("toa_sigma_s = 1e-8", "toa_sigma_s = 1e-8\nbias_sigma_s = 1e-8", "noise.bias_sigma_s: expected bias_sigma_s and bias_time_s, or neither"),
    ("interval_s = 1", "interval_s = 1\nrange_rate = true", "noise.range_rate_sigma_mps: missing, where sampling.range_rate = true"),
    ("interval_s = 1", "interval_s = 1\nstart_s = 99", "sampling.start_s: expected a time before the last target ends, 10 s, got 99"),
    ("size_s = 1e-6", "", "outliers.size_s: expected exactly one of size_s and size_sigmas"),
    ("size_s = 1e-6", "size_s = 1e-6\nsize_sigmas = 9.0", "outliers.size_s: expected exactly one of size_s and size_sigmas"),
    ("[noise]", "[height]\nsigma_m = 3.0\n[noise]", "height: a height needs dims = 3"),
    ("[noise]", '[frame]\nkind = "enu"\n[noise]', "frame.origin_lat_deg: missing, where kind = 'enu'"),
    ("[noise]", "[frame]\norigin_lat_deg = 3.0\n[noise]", "frame.origin_lat_deg: only where kind = 'enu'"),
    ("turn_rate_dps = 3.0", "turn_rate_dps = 3.0\nacceleration_mps2 = [1.0, 1.0]", "targets[0].legs[1].acceleration_mps2: a 'turn' leg takes duration_s, velocity_mps, turn_rate_dps only"),
    # no TOML
    ("dims = 2", "dims = ", "scenario.toml:3:8: "),
    ("dims = 2", "dims = 2\ndims = 2", "scenario.toml:4:"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=[b[2][:50] for b in BAD])
def test_bad_scenarios_say_where_and_what(old: str, new: str, message: str) -> None:
    assert old in TEXT
    assert_refused(TEXT.replace(old, new, 1), message)


def test_a_table_in_the_place_of_a_list_and_the_other_way_round() -> None:
    with pytest.raises(ValueError, match=r"s: stations: expected tables in double brackets"):
        simulate.read('title = "A"\ndims = 2\n[stations]\nname = "a"', "s")
    with pytest.raises(ValueError, match=r"s: noise: expected a table, got \["):
        simulate.read(TEXT.replace("[noise]", "[[noise]]"), "s")
    with pytest.raises(ValueError, match=r"s: stations: expected at least two, got 0"):
        simulate.read(
            "stations = []"
            + TEXT[: TEXT.index("[[sta")]
            + TEXT[TEXT.index("[samp") : TEXT.index("[dropouts]")]
            + TEXT[TEXT.index("[[targets]]") :],
            "s",
        )
    with pytest.raises(ValueError, match=r"s: targets: expected at least one, got none"):
        simulate.read("targets = []" + TEXT[: TEXT.index("[[targets]]")], "s")
    still = TEXT.replace(
        "velocity_mps = [1.0, 0.0]",
        "[[stations.legs]]\nmotion = 'turn'\n"
        "turn_rate_dps = 1.0\nduration_s = 1.0\nacceleration_psd = 1.0",
    )
    with pytest.raises(ValueError, match=r"s: stations\[2\].legs\[0\].acceleration_psd: a station"):
        simulate.read(still, "s")


def test_load_takes_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(TEXT, encoding="utf-8")
    assert simulate.load(path) == simulate.load(str(path)) == simulate.read(TEXT)


def test_load_says_what_it_did_not_find(tmp_path: Path) -> None:
    with pytest.raises(ValueError) as caught:
        simulate.load("sampel")
    text = str(caught.value)
    assert "'sampel'" in text
    assert "(did you mean 'sample'?)" in text
    assert text.endswith(f"there are: {', '.join(simulate.scenarios())}")
    with pytest.raises(ValueError, match=r"scenario: there is no file 'no/such.toml'"):
        simulate.load("no/such.toml")
    with pytest.raises(ValueError, match="is a folder; expected a TOML file"):
        simulate.load(tmp_path)
    latin = tmp_path / "latin.toml"
    latin.write_bytes('title = "Möwe"'.encode("latin-1"))
    with pytest.raises(ValueError, match=r"latin.toml:1: expected UTF-8 text"):
        simulate.load(latin)
