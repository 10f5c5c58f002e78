"""What is wrong in recording.toml is refused by its exact key; what TOML holds comes back."""

from __future__ import annotations

import datetime
import decimal
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_cases import FREE, GOOD, put, refusal

from imm_tdoa import recording
from imm_tdoa.recording.settings import dumps

TOML = GOOD["recording.toml"]
SETTINGS = {
    "wrong type": (
        "toa_sigma_s = 1e-4",
        "toa_sigma_s = 'abc'",
        "noise.toa_sigma_s: expected a number, got 'abc'",
    ),
    "truth value for a number": (
        "toa_sigma_s = 1e-4",
        "toa_sigma_s = true",
        "noise.toa_sigma_s: expected a number, got True",
    ),
    "sigma of nothing": (
        "toa_sigma_s = 1e-4",
        "toa_sigma_s = 0.0",
        "noise.toa_sigma_s: expected a number above 0, got 0.0",
    ),
    "sigma not finite": (
        "toa_sigma_s = 1e-4",
        "toa_sigma_s = nan",
        "noise.toa_sigma_s: expected a finite number, got nan",
    ),
    "unknown key": (
        "toa_sigma_s = 1e-4",
        "toa_sigma = 1e-4",
        "noise.toa_sigma: unknown key (did you mean 'toa_sigma_s'?); there are: toa_sigma_s, "
        "tdoa_sigma_s, range_rate_sigma_mps, bias_sigma_s, bias_time_s, sigma_floor_s",
    ),
    "unknown table": (
        "[noise]",
        "[nose]",
        "nose: unknown key (did you mean 'noise'?); there are: format, title, speed_mps, dims, "
        "labelled, frame, noise, truth, source, notes",
    ),
    "no format": ("format = 1\n", "", "format: missing; expected format = 1"),
    "another format": ("format = 1", "format = 2", "format: expected 1, got 2"),
    "format as text": ("format = 1", 'format = "1"', "format: expected a whole number, got '1'"),
    "format as truth": ("format = 1", "format = true", "format: expected a whole number, got True"),
    "text for truth": (
        "labelled = true",
        'labelled = "false"',
        "labelled: expected true or false, got 'false'",
    ),
    "number for truth": (
        "labelled = true",
        "labelled = 1",
        "labelled: expected true or false, got 1",
    ),
    "number for text": (
        'title = "three stations on a plain"',
        "title = 3",
        "title: expected text in quotes, got 3",
    ),
    "text for number": (
        "speed_mps = 343.0",
        'speed_mps = "fast"',
        "speed_mps: expected a number, got 'fast'",
    ),
    "no speed": (
        "speed_mps = 343.0",
        "speed_mps = 0",
        "speed_mps: expected a number above 0, got 0.0",
    ),
    "one dimension": ("dims = 2", "dims = 1", "dims: expected 2 or 3, got 1"),
    "broken dimension": ("dims = 2", "dims = 2.0", "dims: expected a whole number, got 2.0"),
    "kind of frame": (
        'kind = "local"',
        'kind = "ecef"',
        "frame.kind: expected 'local' or 'enu', got 'ecef'",
    ),
    "frame without origin": (
        'kind = "local"',
        'kind = "enu"',
        "frame.origin_lat_deg: missing; an ENU frame needs its origin",
    ),
    "origin of nothing": (
        'kind = "local"',
        'kind = "local"\norigin_lat_deg = 1.0',
        "frame.origin_lat_deg: a local frame has no origin; set kind = 'enu'",
    ),
    "origin beyond the pole": (
        'kind = "local"',
        'kind = "enu"\norigin_lat_deg = 91.0\norigin_lon_deg = 0.0\norigin_height_m = 0',
        "frame.origin_lat_deg: expected a number within ±90, got 91.0",
    ),
    "axes": (
        "[noise]",
        '[truth]\naxes = ["x", "q"]\n[noise]',
        "truth.axes: expected different ones of x, y, z, got ['x', 'q']",
    ),
    "axes as text": (
        "[noise]",
        '[truth]\naxes = "xy"\n[noise]',
        "truth.axes: expected a list of texts in quotes, got 'xy'",
    ),
    "axis as number": (
        "[noise]",
        '[truth]\naxes = ["x", 2]\n[noise]',
        "truth.axes[1]: expected text in quotes, got 2",
    ),
    "gap": (
        "[noise]",
        "[truth]\nmax_gap_s = -1\n[noise]",
        "truth.max_gap_s: expected a number above 0, got -1.0",
    ),
    "notes as text": (
        "format = 1",
        'format = 1\nnotes = "hm"',
        "notes: expected a table, got 'hm'",
    ),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_settings(tmp_path: Path, case: str) -> None:
    old, new, message = SETTINGS[case]
    assert old in TOML
    folder = put(tmp_path, GOOD | {"recording.toml": TOML.replace(old, new)})
    assert refusal(folder) == f"recording.toml: {message}"


def test_a_section_that_is_no_table(tmp_path: Path) -> None:
    text = "format = 1\nnoise = 3\n"
    message = refusal(put(tmp_path, GOOD | {"recording.toml": text}))
    assert message == "recording.toml: noise: expected a table, got 3"


def test_source_and_notes_are_free(tmp_path: Path) -> None:
    text = TOML + "\n[source]\nanything = [1, 'a']\n[notes.deep]\nx = 1979-05-27\n"
    made = recording.read(put(tmp_path, GOOD | {"recording.toml": text}))
    assert made.source["anything"] == [1, "a"]
    assert made.notes["deep"]["x"].year == 1979


def test_no_toml(tmp_path: Path) -> None:
    text = "format = 1\ntitle = unquoted\n"
    message = refusal(put(tmp_path, GOOD | {"recording.toml": text}))
    assert message == "recording.toml:2:9: Invalid value"


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.text(max_size=5), FREE, max_size=4))
def test_toml_writer_against_the_standard_reader(data: dict[str, Any]) -> None:
    assert tomllib.loads(dumps(data)) == data


def test_text_of_several_lines_is_written_so_that_it_can_be_read() -> None:
    data = {"notes": {"text": 'one\n"two"\n\tthree'}}
    assert dumps(data) == '[notes]\ntext = """\none\n\\"two\\"\n\tthree"""\n'
    # not where the ends of its lines would change
    assert dumps({"text": "one\r\ntwo"}) == 'text = "one\\r\\ntwo"\n'


def test_toml_of_every_kind_of_value() -> None:
    data = {
        "text": 'line\nnext """ \\ \r\n\t end',
        "infinite": float("inf"),
        "whole": -(2**63),
        "noon": datetime.time(12, 0, 0, 5),
        "tables": [{"text": "a\nb" * 50, "c": {"d": [[1], [2.5]]}}, {"": "\x7f\x00\u2028"}],
        "day": datetime.date(1979, 5, 27),
        "moment": datetime.datetime(1979, 5, 27, 7, 32, tzinfo=datetime.UTC),
        "list": [{"a": [1.0, True]}, {}],
        "a.b": {"empty": {}, "c d": {"e": 1}},
    }
    assert tomllib.loads(dumps(data)) == data


BAD = {
    "nothing": (None, "key"),
    "bytes": (b"bytes", "key"),
    "more than 64 bits": (2**63, "key"),
    "a number that reads back as another": (decimal.Decimal("0.1"), "key"),
    "a time of day elsewhere": (datetime.time(12, tzinfo=datetime.UTC), "key"),
    "deep inside": ({"inner": [1, object()]}, r"key\.inner\[1\]"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_toml_cannot_hold_is_named(case: str) -> None:
    value, place = BAD[case]
    with pytest.raises(ValueError, match=rf"^{place}: a recording\.toml cannot hold "):
        dumps({"key": value})


def test_keys_are_text() -> None:
    with pytest.raises(ValueError, match=r"expected text as a key of recording\.toml, got 1"):
        dumps({"inner": {1: 2}})
