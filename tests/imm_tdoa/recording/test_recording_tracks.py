"""Tracks as tables and as lines on a map."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import attrs
import numpy as np
import pymap3d
import pytest

from imm_tdoa import IMM, Bank, Stations, Track
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Static
from imm_tdoa.recording import geo, write_geojson, write_kml, write_track

FRAME = EastNorthUp(47.9, 9.2, 500.0)
CORNERS = np.array([[0, 0, 0], [2e3, 0, 50], [0, 2e3, 300], [2e3, 2e3, 900], [1e3, -1e3, 20.0]])


def tracked(d: int = 3, bank: Bank | None = None, missing: int | None = None) -> Track:
    """A track of an emitter on a straight line."""
    stations = Stations(CORNERS[:, :d])
    times = np.arange(0.0, 8.0, 0.5)
    path = np.array([500.0, 600.0, 700.0])[:d] + np.outer(times, [30.0, -10.0, 5.0][:d])
    ranges = np.linalg.norm(path[:, None] - stations.positions, axis=-1)
    values = (ranges[:, 1:] - ranges[:, :1]) / 299792458.0
    if missing is not None:
        values[missing] = np.nan
    bank = bank or Bank([ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)])
    return IMM(bank, TDOA(stations, toa_sigma=1e-8)).run(times, values)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_columns_and_numbers(tmp_path: Path) -> None:
    track = tracked(missing=5)
    write_track(tmp_path / "t.csv", {"ä,1": track}, FRAME)
    table = rows(tmp_path / "t.csv")
    xyz = ("x_m", "y_m", "z_m")
    speed = ("vx_mps", "vy_mps", "vz_mps")
    assert tuple(table[0]) == (
        *("time_s", "target", *xyz, *speed),
        *(f"s{name}" for name in (*xyz, *speed)),
        *("p_constant-velocity", "p_constant-acceleration", "nis"),
        *("lat_deg", "lon_deg", "height_m"),
    )
    assert {row["target"] for row in table} == {"ä,1"}
    assert table[0]["nis"] == ""  # the row of the fix
    assert table[5]["nis"] == ""  # nothing came in

    def numbers(*names: str) -> Any:
        return np.array([[float(row[name]) for name in names] for row in table])

    np.testing.assert_array_equal(numbers("time_s")[:, 0], track.times)
    np.testing.assert_array_equal(numbers(*xyz), track.position)
    np.testing.assert_array_equal(numbers(*speed), track.velocity)
    sigma = np.sqrt(np.diagonal(track.position_covariance, axis1=1, axis2=2))
    np.testing.assert_array_equal(numbers("sx_m", "sy_m", "sz_m"), sigma)
    index = [track.components.index(c) for c in ("vx", "vy", "vz")]
    sigma = np.sqrt(np.stack([track.covariance[:, i, i] for i in index], axis=-1))
    np.testing.assert_array_equal(numbers("svx_mps", "svy_mps", "svz_mps"), sigma)
    modes = numbers("p_constant-velocity", "p_constant-acceleration")
    np.testing.assert_array_equal(modes, track.mode_probability)
    assert float(table[3]["nis"]) == track.nis[3]
    earth = np.stack(pymap3d.enu2geodetic(*track.position.T, 47.9, 9.2, 500.0), axis=-1)
    np.testing.assert_allclose(numbers("lat_deg", "lon_deg", "height_m"), earth, atol=1e-7)


def test_a_bank_without_velocity_has_no_columns_for_it(tmp_path: Path) -> None:
    track = tracked(2, Bank([Static(psd=100.0)]))
    write_track(tmp_path / "t.csv", {"a": track})
    assert list(rows(tmp_path / "t.csv")[0]) == (
        ["time_s", "target", "x_m", "y_m", "sx_m", "sy_m", "p_static", "nis"]
    )


def test_parquet_holds_the_same(tmp_path: Path) -> None:
    import pyarrow.parquet

    tracks = {"a": tracked(missing=4), "b": tracked()}
    write_track(tmp_path / "t.csv", tracks, FRAME)
    write_track(tmp_path / "t.parquet", tracks, FRAME)
    data = pyarrow.parquet.read_table(tmp_path / "t.parquet").to_pydict()
    table = rows(tmp_path / "t.csv")
    assert list(data) == list(table[0])
    assert data["target"] == [row["target"] for row in table]
    for name in set(data) - {"target"}:
        cells = [None if row[name] == "" else float(row[name]) for row in table]
        assert data[name] == cells, name


def test_rows_before_the_start_are_left_out(tmp_path: Path) -> None:
    track = tracked()
    late = track.blanked(track.times < 2.0)
    write_track(tmp_path / "t.csv", {"a": track, "b": late})
    table = rows(tmp_path / "t.csv")
    times = [float(row["time_s"]) for row in table if row["target"] == "b"]
    np.testing.assert_array_equal(times, track.times[track.times >= 2.0])
    write_geojson(tmp_path / "t.geojson", {"b": late}, FRAME)
    feature = json.loads((tmp_path / "t.geojson").read_text())["features"][0]
    assert feature["properties"]["times_s"] == times


def test_what_is_refused(tmp_path: Path) -> None:
    track = tracked()
    flat = tracked(2)
    cases: list[tuple[Any, dict[str, Any], str]] = [
        ("t.txt", {"a": track}, r"path: expected a name that ends in \.csv or \.parquet, got 't"),
        ("t.csv", {}, "tracks: expected at least one track"),
        ("t.csv", {"a": track, "b": flat}, "tracks: expected tracks of one bank, that of 'b'"),
    ]
    for name, tracks, message in cases:
        with pytest.raises(ValueError, match=message):
            write_track(tmp_path / name, tracks)
    batch = attrs.evolve(
        track,
        log_mode_probability=np.stack([track.log_mode_probability] * 3),
        mode_means=tuple(np.stack([x] * 3) for x in track.mode_means),
        mode_covariances=tuple(np.stack([P] * 3) for P in track.mode_covariances),
    )
    with pytest.raises(ValueError, match=r"that of 'a' is a batch of shape \(3,\)"):
        write_track(tmp_path / "t.csv", {"a": batch})
    for write in (write_geojson, write_kml):
        with pytest.raises(ValueError, match="frame: a map needs an EastNorthUp frame, got None"):
            write(tmp_path / "t", {"a": track}, None)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_failed_writing_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "t.geojson"
    path.write_text("old")

    def fails(paths: Any) -> str:
        raise OSError("disk full")

    monkeypatch.setattr(geo, "geojson", fails)
    with pytest.raises(OSError, match="disk full"):
        write_geojson(path, {"a": tracked()}, FRAME)
    assert [p.name for p in tmp_path.iterdir()] == ["t.geojson"]
    assert path.read_text() == "old"


def test_geojson_reads_back(tmp_path: Path) -> None:
    tracks = {"a": tracked(), "b <&>": tracked(missing=3)}
    write_geojson(tmp_path / "new" / "t.geojson", tracks, FRAME)
    data = json.loads((tmp_path / "new" / "t.geojson").read_text(encoding="utf-8"))
    assert data["type"] == "FeatureCollection"
    assert [f["properties"]["target"] for f in data["features"]] == list(tracks)
    for feature, track in zip(data["features"], tracks.values(), strict=True):
        assert feature["type"] == "Feature"
        assert feature["geometry"]["type"] == "LineString"
        lon, lat, height = np.array(feature["geometry"]["coordinates"]).T
        back = np.stack(pymap3d.geodetic2enu(lat, lon, height, 47.9, 9.2, 500.0), axis=-1)
        np.testing.assert_allclose(back, track.position, atol=1e-6)
        assert feature["properties"]["times_s"] == track.times.tolist()


def test_kml_reads_back(tmp_path: Path) -> None:
    tracks = {"a": tracked(), "b <&>": tracked(missing=3)}
    write_kml(tmp_path / "t.kml", tracks, FRAME)
    text = (tmp_path / "t.kml").read_text(encoding="utf-8")
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>')
    space = {"k": "http://www.opengis.net/kml/2.2"}
    marks = ElementTree.parse(tmp_path / "t.kml").getroot().findall("k:Document/k:Placemark", space)
    assert [mark.findtext("k:name", "", space) for mark in marks] == list(tracks)
    for mark, track in zip(marks, tracks.values(), strict=True):
        assert mark.findtext("k:LineString/k:altitudeMode", "", space) == "absolute"
        places = mark.findtext("k:LineString/k:coordinates", "", space).split()
        lon, lat, height = np.array([p.split(",") for p in places], dtype=float).T
        back = np.stack(pymap3d.geodetic2enu(lat, lon, height, 47.9, 9.2, 500.0), axis=-1)
        np.testing.assert_allclose(back, track.position, atol=1e-6)


def test_a_track_in_the_plane_runs_at_z_zero(tmp_path: Path) -> None:
    track = tracked(2)
    write_geojson(tmp_path / "t.geojson", {"a": track}, FRAME)
    data = json.loads((tmp_path / "t.geojson").read_text())
    lon, lat, height = np.array(data["features"][0]["geometry"]["coordinates"]).T
    back = np.stack(pymap3d.geodetic2enu(lat, lon, height, 47.9, 9.2, 500.0), axis=-1)
    np.testing.assert_allclose(back[:, :2], track.position, atol=1e-6)
    np.testing.assert_allclose(back[:, 2], 0.0, atol=1e-6)
    write_kml(tmp_path / "t.kml", {"a": track}, FRAME)
    assert "<altitudeMode>clampToGround</altitudeMode>" in (tmp_path / "t.kml").read_text()
    write_track(tmp_path / "t.csv", {"a": track}, FRAME)
    assert [float(row["lat_deg"]) for row in rows(tmp_path / "t.csv")] == lat.tolist()


def test_a_single_row_is_a_point(tmp_path: Path) -> None:
    track = tracked()
    one = track.blanked(track.times > 0.0)
    none = track.blanked(track.times >= 0.0)
    write_geojson(tmp_path / "t.geojson", {"one": one, "none": none}, FRAME)
    features = json.loads((tmp_path / "t.geojson").read_text())["features"]
    assert features[0]["geometry"]["type"] == "Point"
    assert len(features[0]["geometry"]["coordinates"]) == 3
    assert features[1]["geometry"] is None
    write_kml(tmp_path / "t.kml", {"one": one}, FRAME)
    assert "<Point>" in (tmp_path / "t.kml").read_text()


def test_lines_are_cut_at_the_180th_meridian() -> None:
    place = np.array(
        [[10.0, 179.0, 0.0], [11.0, 179.5, 10.0], [12.0, -179.5, 20.0], [13.0, 179.0, 50.0]]
    )
    lines = geo.cut(place)
    np.testing.assert_allclose(lines[0], np.array([[179, 10, 0], [179.5, 11, 10], [180, 11.5, 15]]))
    np.testing.assert_allclose(
        lines[1], np.array([[-180, 11.5, 15], [-179.5, 12, 20], [-180, 12 + 1 / 3, 30]])
    )
    np.testing.assert_allclose(lines[2], np.array([[180, 12 + 1 / 3, 30], [179, 13, 50]]))
    text = geo.geojson([geo.Path("a", np.arange(4.0), place, True)])
    geometry = json.loads(text)["features"][0]["geometry"]
    assert geometry["type"] == "MultiLineString"
    assert len(geometry["coordinates"]) == 3
