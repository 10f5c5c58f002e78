"""A recording that was written reads back exactly, and is written whole or not at all."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from recording_cases import GOOD, assert_same, put, recordings

from imm_tdoa import Stations, recording
from imm_tdoa.recording import Recording, Table, _csv


@pytest.mark.parametrize("tables", ["csv", "parquet"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(made=recordings())
def test_round_trip_is_exact(made: Recording, tables: Any) -> None:
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / "a" / "b"
        recording.write(made, where, tables=tables)
        assert_same(recording.read(where), made)


def test_csv_and_parquet_of_files_agree(tmp_path: Path) -> None:
    plain = recording.read(put(tmp_path / "csv", GOOD))
    recording.write(plain, tmp_path / "parquet", tables="parquet")
    assert {p.suffix for p in (tmp_path / "parquet").iterdir()} == {".toml", ".parquet"}
    assert_same(recording.read(tmp_path / "parquet"), plain)


def test_written_csv_is_what_the_format_says(tmp_path: Path) -> None:
    recording.write(recording.read(put(tmp_path / "in", GOOD)), tmp_path / "out")
    text = (tmp_path / "out" / "tdoa.csv").read_text()
    assert text.splitlines()[:3] == [
        "time_s,station,reference,tdoa_s,sigma_s",
        "1.0,b,a,0.1,0.0001",
        "1.0,c,a,-0.2,",
    ]
    assert (tmp_path / "out" / "stations.csv").read_text().startswith("station,x_m,y_m\na,0.0,0.0")


def test_names_that_look_like_numbers_stay_names(tmp_path: Path) -> None:
    files = {name: text.replace("a,", "007,") for name, text in GOOD.items() if name != "toa.csv"}
    files["tdoa.csv"] = "time_s,station,reference,tdoa_s\n1,b,007,0.1\n"
    files["stations.csv"] = "station,x_m,y_m\n007,0,0\nb,1000,0\n"
    made = recording.read(put(tmp_path / "in", files))
    assert made.stations.names == ("007", "b")
    assert made.tdoa is not None
    assert made.tdoa["reference"].tolist() == ["007"]


def test_parquet_takes_whole_numbers_as_names_and_numbers(tmp_path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    folder = put(tmp_path / "r", {k: v for k, v in GOOD.items() if k in ("recording.toml",)})
    stations = {"station": [7, 8, 9], "x_m": [0, 1000, 0], "y_m": [0, 0, 1000]}
    toa = {"time_s": [1, 1], "emission": [5, 5], "station": [7, 8], "toa_s": [0.5, None]}
    for name, data in {"stations": stations, "toa": toa}.items():
        pyarrow.parquet.write_table(pyarrow.table(data), folder / f"{name}.parquet")
    made = recording.read(folder)
    assert made.stations.names == ("7", "8", "9")
    assert made.toa is not None
    assert made.toa["emission"].tolist() == ["5", "5"]
    np.testing.assert_array_equal(made.toa["toa_s"], [0.5, np.nan])


def test_parquet_without_pyarrow_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    made = recording.read(put(tmp_path / "in", GOOD))
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=r"stations\.parquet: Parquet needs pyarrow: install imm"):
        recording.write(made, tmp_path / "out", tables="parquet")
    assert not (tmp_path / "out").exists()


def test_stations_in_latitude_and_longitude(tmp_path: Path) -> None:
    files = dict(GOOD)
    frame = 'kind = "enu"\norigin_lat_deg = 48.0\norigin_lon_deg = 9.0\norigin_height_m = 400.0'
    files["recording.toml"] = files["recording.toml"].replace('kind = "local"', frame)
    files["stations.csv"] = (
        "station,lat_deg,lon_deg,height_m\na,48.0,9.0,400\nb,48.0,9.01,400\nc,48.01,9.0,400\n"
    )
    flat = recording.read(put(tmp_path / "flat", files))
    assert flat.dims == 2
    files["recording.toml"] = files["recording.toml"].replace("dims = 2\n", "dims = 3\n")
    del files["truth.csv"]
    solid = recording.read(put(tmp_path / "solid", files))
    assert solid.frame is not None
    x = solid.stations.positions
    np.testing.assert_allclose(x[0], 0.0, atol=1e-8)
    # A hundredth of a degree: prime vertical radius N cos(lat), meridian radius M.
    sin2 = np.sin(np.radians(48.0)) ** 2
    a, e2 = 6378137.0, 6.69437999014e-3
    N, M = a / np.sqrt(1 - e2 * sin2), a * (1 - e2) / (1 - e2 * sin2) ** 1.5
    step = np.radians(0.01)
    np.testing.assert_allclose(x[1, 0], (N + 400) * np.cos(np.radians(48.0)) * step, rtol=1e-6)
    np.testing.assert_allclose(x[2, 1], (M + 400) * step, rtol=1e-5)
    np.testing.assert_allclose(flat.stations.positions, x[:, :2])
    recording.write(solid, tmp_path / "again")
    assert_same(recording.read(tmp_path / "again"), solid)


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    made = recording.read(put(tmp_path / "in", GOOD))
    full = tmp_path / "full"
    full.mkdir()
    (full / "diary.txt").write_text("dear")
    with pytest.raises(ValueError, match=r"folder: .* is not empty; overwrite=True replaces it"):
        recording.write(made, full)
    with pytest.raises(ValueError, match="not empty and no recording"):
        recording.write(made, full, overwrite=True)
    assert [p.name for p in full.iterdir()] == ["diary.txt"]
    with pytest.raises(ValueError, match="is a file"):
        recording.write(made, full / "diary.txt")
    (tmp_path / "empty").mkdir()
    recording.write(made, tmp_path / "empty")
    assert_same(recording.read(tmp_path / "empty"), made)


def test_overwriting_replaces_the_recording_and_nothing_else(tmp_path: Path) -> None:
    folder = put(tmp_path / "r", GOOD)
    (folder / "README.md").write_text("keep me")
    put(folder / "extra", {"tdoa.csv": "nonsense"})
    made = recording.read(folder)
    less = attrs.evolve(made, tdoa=None, title="less")
    recording.write(less, folder, tables="parquet", overwrite=True)
    assert_same(recording.read(folder), less)
    assert not (folder / "tdoa.csv").exists()
    assert (folder / "README.md").read_text() == "keep me"
    assert (folder / "extra" / "tdoa.csv").read_text() == "nonsense"
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overwrite: bool
) -> None:
    folder = put(tmp_path / "r", GOOD)
    made = recording.read(folder)
    real = _csv.write
    written: list[Path] = []

    def fails(path: Path, table: Table) -> None:
        if len(written) == 2:
            raise OSError("disk full")
        written.append(path)
        real(path, table)

    monkeypatch.setattr(_csv, "write", fails)
    where = folder if overwrite else tmp_path / "new"
    with pytest.raises(OSError, match="disk full"):
        recording.write(attrs.evolve(made, title="changed"), where, overwrite=overwrite)
    assert [p.name for p in tmp_path.iterdir()] == ["r"]
    assert {p.name: p.read_text() for p in folder.iterdir()} == GOOD


def test_what_the_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    made = recording.read(put(tmp_path / "in", GOOD))
    P, Q = made.stations.positions, np.tile(np.eye(2), (3, 1, 1))
    names = made.stations.names
    cases = [
        (Stations(P, names=names, position_covariance=Q), "no columns for their position_cov"),
        (Stations(P, names=names, velocities=P), "no velocities of stations without times"),
        (Stations(P, names=("a", "b", " c")), r"stations\[2\]: station: expected a name of"),
    ]
    for stations, message in cases:
        toa = None if "b" not in stations.names else made.toa
        assert toa is not None
        few = Table({c: toa[c][:2] for c in toa})
        with pytest.raises(ValueError, match=message):
            recording.write(Recording(stations, toa=few), tmp_path / "out")
    with pytest.raises(ValueError, match=r"notes\.a: a recording\.toml cannot hold None"):
        recording.write(attrs.evolve(made, notes={"a": None}), tmp_path / "out")
    with pytest.raises(ValueError, match="tables: expected 'csv' or 'parquet', got 'xlsx'"):
        recording.write(made, tmp_path / "out", tables="xlsx")  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()
