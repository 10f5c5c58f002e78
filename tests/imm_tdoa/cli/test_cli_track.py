"""``imm-tdoa track``, end to end."""

from __future__ import annotations

import json
from contextlib import chdir
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_cases import (
    SPEED,
    STATIONS,
    TIMES,
    assert_drawn,
    path_at,
    run,
    table,
    words,
    write_recording,
)

RECORDINGS = Path(__file__).parents[4] / "shared" / "data"
SAMPLE = resources.files("imm_tdoa").joinpath("sample")
KEYS_2D = {
    "scans",
    "position_rmse_m",
    "position_median_m",
    "velocity_rmse_mps",
    "mean_nees",
    "log_likelihood",
    "lost_scans",
    "rows_left_out",
    "seconds",
    "engine",
}
KEYS_3D = KEYS_2D | {"horizontal_rmse_m", "horizontal_median_m"}


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The output folder of a run without arguments, and what it printed."""
    home = tmp_path_factory.mktemp("home")
    with chdir(home):
        code, text = run("track")
    assert code == 0
    return home / "imm-tdoa-out" / "sample", text


def test_sample_writes_everything(sample: tuple[Path, str]) -> None:
    out, text = sample
    assert {f.name for f in out.iterdir()} == {
        "track.csv",
        "summary.json",
        "track.png",
        "error.png",
    }
    for name in ("track.png", "error.png"):
        assert_drawn(out / name)
    assert "bank static-cv-ca: static, constant-velocity, constant-acceleration" in words(text)
    assert "written to imm-tdoa-out/sample: error.png, summary.json, track.csv" in words(text)


def test_sample_summary_agrees_with_its_table(sample: tuple[Path, str]) -> None:
    """The figures follow from track.csv and truth.csv, put together here by hand."""
    out, text = sample
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert set(summary["overall"]) == KEYS_2D | {"targets"}
    (found,) = summary["targets"].values()
    assert set(found) == KEYS_2D
    assert summary["bank"] == "static-cv-ca"
    assert summary["modes"] == ["static", "constant-velocity", "constant-acceleration"]
    assert summary["robust"] is None
    assert summary["failed"] == {}
    rows = table(out / "track.csv")
    with resources.as_file(SAMPLE) as folder:
        truth = {float(row["time_s"]): row for row in table(folder / "truth.csv")}
    error = np.array(
        [
            [float(row[c]) - float(truth[float(row["time_s"])][c]) for c in ("x_m", "y_m")]
            for row in rows
        ]
    )
    speed = np.array(
        [
            [float(row[c]) - float(truth[float(row["time_s"])][c]) for c in ("vx_mps", "vy_mps")]
            for row in rows
        ]
    )
    distance = np.hypot(*error.T)
    assert found["scans"] == len(rows)
    assert found["position_rmse_m"] == pytest.approx(np.sqrt(np.mean(distance**2)), rel=1e-9)
    assert found["position_median_m"] == pytest.approx(np.median(distance), rel=1e-9)
    assert found["velocity_rmse_mps"] == pytest.approx(
        np.sqrt(np.mean(np.sum(speed**2, axis=1))), rel=1e-9
    )
    assert found["position_rmse_m"] < 20.0
    assert 1.0 < found["mean_nees"] < 4.0
    assert f"{found['position_rmse_m']:.1f}" in text


def test_sample_modes_are_probabilities(sample: tuple[Path, str]) -> None:
    rows = table(sample[0] / "track.csv")
    names = ["p_static", "p_constant-velocity", "p_constant-acceleration"]
    p = np.array([[float(row[n]) for n in names] for row in rows])
    np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-9)
    assert p[30, 0] > 0.9  # it stands on its pad


def test_targets_together_and_alone(tmp_path: Path) -> None:
    """Several targets: all on one map, each on its own, geographic files; figures pooled."""
    folder = write_recording(tmp_path / "rec", targets=("one", "two/2"))
    out = tmp_path / "out"
    code, text = run("track", folder, "--bank", "ship", "--out", out, "--robust", "gate")
    assert code == 0
    names = {f.name for f in out.iterdir()}
    assert names == {
        "track.csv",
        "track.geojson",
        "track.kml",
        "summary.json",
        "track.png",
        "error.png",
        "track-one.png",
        "error-one.png",
        "track-two_2.png",
        "error-two_2.png",
    }
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert sorted(summary["files"]) == sorted(names)
    assert summary["robust"] == "gate"
    each = summary["targets"]
    assert set(each) == {"one", "two/2"}
    overall = summary["overall"]
    assert overall["scans"] == sum(t["scans"] for t in each.values()) == 30
    assert overall["targets"] == 2
    squares = [t["position_rmse_m"] ** 2 for t in each.values()]
    assert overall["position_rmse_m"] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)
    assert overall["position_rmse_m"] < 1.0
    assert overall["log_likelihood"] == pytest.approx(
        sum(t["log_likelihood"] for t in each.values())
    )
    geo = json.loads((out / "track.geojson").read_text("utf-8"))
    assert geo["type"] == "FeatureCollection"
    code, text = run("track", folder, "--target", "one", "--out", tmp_path / "one")
    assert code == 0
    assert "two/2" not in text
    summary = json.loads((tmp_path / "one" / "summary.json").read_text("utf-8"))
    assert list(summary["targets"]) == ["one"]


def test_a_target_that_cannot_be_started_is_listed(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec", targets=("good",))
    with (folder / "toa.csv").open("a", encoding="utf-8") as file:
        file.write("29.0,lost0,a,1e-5,lost\n29.0,lost0,b,2e-5,lost\n")
    code, text = run("track", folder, "--out", tmp_path / "out")
    assert code == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    assert list(summary["targets"]) == ["good"]
    assert list(summary["failed"]) == ["lost"]
    assert "not tracked: 1 of 2 targets lost: values: no run of up to" in words(text)
    code, text = run("track", folder, "--target", "lost", "--out", tmp_path / "none")
    assert code == 2
    assert text.startswith(
        "imm-tdoa: error: no target can be tracked: target 'lost': values: no run of up to"
    )
    assert text.count("\n") == 1
    assert not (tmp_path / "none").exists()


def test_without_truth_there_is_null(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec", files={"truth.csv": ""})
    code, text = run("track", folder, "--out", tmp_path / "out")
    assert code == 0
    assert "no truth to compare with" in text
    summary = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    (found,) = summary["targets"].values()
    assert set(found) == KEYS_2D
    assert found["position_rmse_m"] is None
    assert found["mean_nees"] is None
    assert found["log_likelihood"] < 0.0


def test_own_bank_and_an_old_folder(tmp_path: Path) -> None:
    """A bank file; the folder that is there is used again, its other files stay."""
    folder = write_recording(tmp_path / "rec")
    bank = tmp_path / "mine.toml"
    bank.write_text(
        'mean_sojourn_s = 30\n[[modes]]\nmodel = "constant-velocity"\nname = "on"\npsd = 0.01\n',
        "utf-8",
    )
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine", "utf-8")
    (out / "track.csv").write_text("old", "utf-8")
    code, _ = run("track", folder, "--bank", bank, "--out", out, "--engine", "numpy")
    assert code == 0
    assert (out / "notes.txt").read_text("utf-8") == "mine"
    assert table(out / "track.csv")[0]["p_on"] == "1.0"
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["modes"] == ["on"]
    assert not [f for f in out.iterdir() if f.name.startswith(".")]


@pytest.mark.recordings
def test_real_recording(tmp_path: Path) -> None:
    """Aircraft in three dimensions, many targets of a few messages each."""
    folder = RECORDINGS / "locards_mlat" / "set5"
    if not folder.is_dir():
        pytest.skip("the real recordings are not beside the project")
    options = ["--bank", "aircraft", "--robust", "gate"]
    assert run("track", folder, *options, "--out", tmp_path)[0] == 0
    summary: dict[str, Any] = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert summary["targets"]
    for figures in [summary["overall"], *summary["targets"].values()]:
        assert set(figures) - {"targets"} == KEYS_3D
    assert_drawn(tmp_path / "track.png")
    assert (tmp_path / "track.kml").exists()


def test_looking_back_over_all_of_it_halves_the_error(tmp_path: Path) -> None:
    figures = {}
    for name, more in (("plain", ()), ("smooth", ("--smooth", "--robust", "student-t"))):
        code, text = run("track", *more, "--out", tmp_path / name)
        assert code == 0, text
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["smoothed"] == (name == "smooth")
        figures[name] = summary["overall"]["position_rmse_m"]
    assert figures["smooth"] < 0.8 * figures["plain"]
    assert summary["robust"] == "student-t"
    assert "trusted less than half" in text


def test_targets_in_one_batch_are_tracked_as_by_themselves(tmp_path: Path) -> None:
    """Differences: targets with clocks of their own, a pair missing here and there."""
    rng = np.random.default_rng(4)
    places = np.array(list(STATIONS.values()))
    rows = []
    for i, name in enumerate(("one", "two", "lost")):
        for k, time in enumerate(np.array(TIMES) + 0.3 * i):
            away = np.linalg.norm(path_at(time + 40.0 * i) - places, axis=-1)
            seen = (away - away[0]) / SPEED + 1e-9 * rng.normal(size=5)
            for j, station in enumerate(list(STATIONS)[1:], start=1):
                if (name == "lost" and j + k > 1) or (k > 2 and rng.random() < 0.2):
                    continue
                rows.append((time, f"{float(time)!r},{station},a,{float(seen[j])!r},{name}"))
    text = "\n".join(["time_s,station,reference,tdoa_s,target", *(r for _, r in sorted(rows))])
    files = {"tdoa.csv": text + "\n", "toa.csv": "", "truth.csv": ""}
    folder = write_recording(tmp_path / "rec", files=files)
    out = tmp_path / "out"
    code, _ = run("track", folder, "--out", out, "--smooth")
    assert code == 0
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert list(summary["targets"]) == ["one", "two"]
    assert list(summary["failed"]) == ["lost"]
    assert all(row["seconds"] > 0.0 for row in summary["targets"].values())
    together = table(out / "track.csv")
    for name in ("one", "two"):
        code, _ = run("track", folder, "--target", name, "--out", tmp_path / name, "--smooth")
        assert code == 0
        alone = table(tmp_path / name / "track.csv")
        mine = [row for row in together if row["target"] == name]
        assert len(mine) == len(alone) == 15
        for a, b in zip(mine, alone, strict=True):
            for key in (key for key in b if key != "target"):
                assert a[key] == b[key] or float(a[key]) == pytest.approx(
                    float(b[key]), rel=1e-9, abs=1e-9
                )
