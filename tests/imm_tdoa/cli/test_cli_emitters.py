"""``imm-tdoa track`` on recordings whose rows nobody told apart, end to end."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from cli_cases import run, words, write_recording
from numpy.testing import assert_allclose

from imm_tdoa import metrics, recording
from imm_tdoa.contract import Array
from imm_tdoa.recording import Table
from imm_tdoa.simulate import load, simulate

OF_TRACKS = {
    *("scans", "position_rmse_m", "position_median_m", "velocity_rmse_mps", "mean_nees"),
    *("log_likelihood", "lost_scans", "seconds", "engine", "born_s", "confirmed_s", "heard_s"),
    *("ended_s", "reason", "scans_heard", "rows", "emitter", "purity"),
}
PICTURES = {"tracks.png", "lives.png", "rows.png", "gospa.png"}
BANK = """mean_sojourn_s = 60.0
[birth_std]
velocity = 30.0
[[modes]]
model = "constant-velocity"
psd = 0.01
"""


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bank and the first minute of the shipped crossing as a recording."""
    home = tmp_path_factory.mktemp("home")
    (home / "straight.toml").write_text(BANK, "utf-8")
    data = simulate(load("crossing"), seed=2)
    recording.write(first(data, 60.0), home / "pair")
    return home


def first(data: recording.Recording, until: float) -> recording.Recording:
    """The recording up to a time."""
    tables: dict[str, Any] = {}
    for name in ("tdoa", "toa", "truth"):
        rows = getattr(data, name)
        if rows is not None:
            keep = rows["time_s"] <= until
            tables[name] = Table({column: rows[column][keep] for column in rows})
    return attrs.evolve(data, **tables)


@pytest.fixture(scope="module")
def tracked(place: Path) -> tuple[Path, str]:
    """The output folder of a run, and what it printed."""
    code, text = run(
        "track", place / "pair", "--bank", place / "straight.toml", "--out", place / "out"
    )
    assert code == 0
    return place / "out", text


def positions(out: Path, times: Array) -> Array:
    """Positions (N, T, 2) from tracks.csv, from each track's confirmation on."""
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    result = np.full((len(summary["targets"]), len(times), 2), np.nan)
    names = list(summary["targets"])
    for row in table(out / "tracks.csv"):
        n, t = names.index(row["target"]), float(row["time_s"])
        if t >= summary["targets"][row["target"]]["confirmed_s"]:
            result[n, np.searchsorted(times, t)] = float(row["x_m"]), float(row["y_m"])
    return result


def test_two_emitters_are_found(tracked: tuple[Path, str]) -> None:
    out, text = tracked
    assert {f.name for f in out.iterdir()} == {"tracks.csv", "summary.json", *PICTURES}
    for name in PICTURES:
        assert len((out / name).read_bytes()) > 15_000
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert list(summary["targets"]) == ["1", "2"]
    assert set(summary["targets"]["1"]) == OF_TRACKS
    assert {row["emitter"] for row in summary["targets"].values()} == set(summary["emitters"])
    overall = summary["overall"]
    assert overall["tracks"] == overall["living"] == overall["emitters"] == 2
    assert overall["false_tracks"] == overall["id_switches"] == 0
    assert overall["purity"] == 1.0
    said = words(text)
    assert "2 tracks, 2 of them alive at the end" in said
    assert "2 emitters, 0 never followed; 0 false tracks; 0 id switches; purity 1.00" in said


def test_figures_follow_from_the_table(tracked: tuple[Path, str], place: Path) -> None:
    """GOSPA, OSPA, latency and RMSE from tracks.csv and truth.csv, put together by hand."""
    out, _ = tracked
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    rows = table(place / "pair" / "truth.csv")
    names = list(dict.fromkeys(row["target"] for row in rows))
    times = np.unique([float(row["time_s"]) for row in rows])
    truth = np.full((2, len(times), 2), np.nan)
    for row in rows:
        k = np.searchsorted(times, float(row["time_s"]))
        truth[names.index(row["target"]), k] = float(row["x_m"]), float(row["y_m"])
    found = positions(out, times)
    cutoff = summary["overall"]["cutoff_m"]
    gospa = metrics.gospa_curve(truth, found, cutoff)
    assert_allclose(summary["overall"]["gospa_m"], gospa.distance.mean(), rtol=1e-6)
    assert_allclose(summary["overall"]["gospa_missed_m2"], gospa.missed.mean(), rtol=1e-6)
    ospa = metrics.ospa_curve(truth, found, cutoff).mean()
    assert_allclose(summary["overall"]["ospa_m"], ospa, rtol=1e-6)
    late = metrics.latency(np.isfinite(truth[..., 0]), metrics.follow(truth, found, cutoff), times)
    assert_allclose([summary["emitters"][n]["latency_s"] for n in names], late)
    for name, row in summary["targets"].items():
        own = [r for r in table(out / "tracks.csv") if r["target"] == name]
        who = truth[names.index(row["emitter"])]
        at = np.searchsorted(times, [float(r["time_s"]) for r in own])
        place_ = np.array([[float(r["x_m"]), float(r["y_m"])] for r in own])
        assert_allclose(row["position_rmse_m"], metrics.rmse(place_ - who[at]), rtol=1e-6)
        assert row["scans"] == len(own)
        assert row["born_s"] == float(own[0]["time_s"])


def test_rows_are_accounted_for(tracked: tuple[Path, str], place: Path) -> None:
    out, _ = tracked
    overall = json.loads((out / "summary.json").read_text("utf-8"))["overall"]
    assert overall["rows"] == len(table(place / "pair" / "tdoa.csv"))
    assert 0 < overall["rows_taken"] <= overall["rows"]
    parts = (overall[f"rows_{name}"] for name in ("taken", "ignored", "left"))
    assert overall["rows"] == sum(parts)
    assert overall["scans"] == len({row["time_s"] for row in table(place / "pair" / "tdoa.csv")})


def test_another_associator_and_its_numbers(place: Path, tmp_path: Path) -> None:
    code, text = run(
        *("track", place / "pair", "--bank", place / "straight.toml", "--out", tmp_path / "o"),
        *("--associator", "jpda", "--detection-probability", "0.95", "--cutoff", "55"),
    )
    assert code == 0
    assert "cutoff 55 m" in words(text)
    overall = json.loads((tmp_path / "o" / "summary.json").read_text("utf-8"))["overall"]
    assert overall["emitters_never_followed"] == 0
    assert overall["cutoff_m"] == 55.0


def test_smoothing_makes_tracks_better(
    place: Path, tracked: tuple[Path, str], tmp_path: Path
) -> None:
    code, _ = run(
        *("track", place / "pair", "--bank", place / "straight.toml", "--smooth"),
        *("--out", tmp_path / "o"),
    )
    assert code == 0
    after = json.loads((tmp_path / "o" / "summary.json").read_text("utf-8"))
    before = json.loads((tracked[0] / "summary.json").read_text("utf-8"))
    assert after["smoothed"]
    assert after["overall"]["position_rmse_m"] < 0.8 * before["overall"]["position_rmse_m"]
    assert after["overall"]["rows_taken"] == before["overall"]["rows_taken"]


def test_hidden_labels_say_how_pure_the_tracks_are(tmp_path: Path, place: Path) -> None:
    """Two targets heard in turns by name; the names come back as purity, not as tracks."""
    folder = write_recording(tmp_path / "r", targets=("ship", "boat"))
    bank = place / "straight.toml"
    code, text = run(
        "track", folder, "--hide-labels", "--bank", bank, "--cutoff", "40", "--out", tmp_path / "o"
    )
    assert code == 0
    summary = json.loads((tmp_path / "o" / "summary.json").read_text("utf-8"))
    assert "ship" not in summary["targets"]
    assert all(0.0 < row["row_purity"] <= 1.0 for row in summary["targets"].values())
    assert 0.5 <= summary["overall"]["row_purity"] <= 1.0
    assert "rows of a track from its main emitter" in text
    names = {f.name for f in (tmp_path / "o").iterdir()}
    assert {"tracks.geojson", "tracks.kml"} <= names


def test_nothing_but_false_rows(tmp_path: Path) -> None:
    """A recording of noise: nothing is confirmed, and that is said."""
    data = first(simulate(load("crossing"), seed=2), 20.0)
    assert data.tdoa is not None
    columns = {name: data.tdoa[name] for name in data.tdoa}
    rng = np.random.default_rng(1)
    columns["tdoa_s"] = rng.uniform(-2e-5, 2e-5, len(data.tdoa))
    some = rng.random(len(data.tdoa)) < 0.3
    noise = Table({name: column[some] for name, column in columns.items()})
    recording.write(attrs.evolve(data, tdoa=noise, truth=None), tmp_path / "noise")
    code, text = run("track", tmp_path / "noise", "--out", tmp_path / "o")
    assert code == 0
    assert "no track was confirmed" in text
    assert "no truth to compare with" in text
    assert {f.name for f in (tmp_path / "o").iterdir()} == {"rows.png", "summary.json"}
    summary = json.loads((tmp_path / "o" / "summary.json").read_text("utf-8"))
    assert summary["overall"]["tracks"] == 0
    assert summary["targets"] == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--target", "1"), "--target: nobody knows whose rows are whose"),
        (("--engine", "compiled"), "--engine: only the tracks of labelled recordings"),
        (("--robust", "gate"), "--robust: only for labelled recordings; without labels a row that"),
        (("--detection-probability", "1.5"), "--detection-probability: expected a probability"),
        (("--cutoff", "-1"), "--cutoff: expected"),
    ],
)
def test_wrong_options_are_named(place: Path, options: tuple[str, str], message: str) -> None:
    code, text = run("track", place / "pair", *options, "--out", place / "none")
    assert code == 2
    assert message in words(text)
    assert not (place / "none").exists()


@pytest.mark.parametrize("option", ["--associator=jpda", "--cutoff=5"])
def test_association_of_what_is_labelled_is_refused(tmp_path: Path, option: str) -> None:
    folder = write_recording(tmp_path / "r")
    code, text = run("track", folder, option, "--out", tmp_path / "o")
    assert code == 2
    assert "--hide-labels ignores that" in words(text)
