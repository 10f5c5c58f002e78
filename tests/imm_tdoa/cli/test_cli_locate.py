"""``imm-tdoa locate``: fixes, their errors, both methods."""

from __future__ import annotations

import json
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
from cli_cases import HEAD, SPEED, STATIONS, path_at, run, table, words, write_recording

from imm_tdoa.contract import Array


def positions(rows: list[dict[str, str]]) -> Array:
    return np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])


def tdoa_table(reference: str, t: Array) -> str:
    """Noise-free differences against one station."""
    places = np.array(list(STATIONS.values()))
    lines = ["time_s,station,reference,tdoa_s,target"]
    for time, p in zip(t, path_at(t), strict=True):
        arrival = dict(zip(STATIONS, np.linalg.norm(p - places, axis=-1) / SPEED, strict=True))
        lines += [
            f"{time},{s},{reference},{float(a - arrival[reference])!r},ship"
            for s, a in arrival.items()
            if s != reference
        ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("method", ["gauss-newton", "chan-ho"])
def test_noise_free_fixes_are_the_truth(method: str, tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec", targets=("ship", "boat"))
    out = tmp_path / "out"
    code, text = run("locate", folder, "--method", method, "--out", out)
    assert code == 0
    assert {f.name for f in out.iterdir()} == {
        "fixes.csv",
        "summary.json",
        "gdop.png",
        "error.png",
    }
    rows = table(out / "fixes.csv")
    assert list(rows[0]) == [
        "time_s",
        "target",
        "x_m",
        "y_m",
        "sx_m",
        "sy_m",
        "chi2",
        "dof",
        "converged",
        "mirror_x_m",
        "mirror_y_m",
        "lat_deg",
        "lon_deg",
        "height_m",
    ]
    assert [row["target"] for row in rows] == ["ship"] * 15 + ["boat"] * 15
    t = np.array([float(row["time_s"]) for row in rows])
    np.testing.assert_allclose(positions(rows), path_at(t), atol=1e-3)
    assert {row["converged"] for row in rows} == {"true"}
    assert {row["dof"] for row in rows} == {"2"}
    assert abs(float(rows[0]["lat_deg"]) - 47.0) < 0.1
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["method"] == method
    assert summary["robust"] == ("student-t" if method == "gauss-newton" else None)
    overall = summary["overall"]
    assert (overall["scans"], overall["converged"], overall["failed"]) == (30, 30, 0)
    assert max(overall["position_error_quartiles_m"]) < 1e-3
    assert set(summary["targets"]) == {"ship", "boat"}
    assert "all 30 30 0 0" in words(text)


def test_quartiles_are_those_of_the_table(tmp_path: Path) -> None:
    """Noisy arrival times; the quartiles follow from fixes.csv and the known path."""
    folder = write_recording(tmp_path / "rec", times=tuple(2.0 * k for k in range(25)))
    rng = np.random.default_rng(3)
    lines = (folder / "toa.csv").read_text("utf-8").splitlines()
    noisy = [lines[0]]
    for line in lines[1:]:
        time, emission, station, toa, target = line.split(",")
        value = float(toa) + rng.normal(0.0, 1e-8)
        noisy.append(f"{time},{emission},{station},{value!r},{target}")
    (folder / "toa.csv").write_text("\n".join(noisy) + "\n", "utf-8")
    out = tmp_path / "out"
    assert run("locate", folder, "--no-robust", "--out", out)[0] == 0
    rows = table(out / "fixes.csv")
    t = np.array([float(row["time_s"]) for row in rows])
    error = np.linalg.norm(positions(rows) - path_at(t), axis=1)
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["robust"] is None
    np.testing.assert_allclose(
        summary["overall"]["position_error_quartiles_m"],
        np.quantile(error, [0.25, 0.5, 0.75]),
        rtol=1e-9,
    )


def test_robust_fixes_shrug_off_a_gross_error(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec")
    lines = (folder / "toa.csv").read_text("utf-8").splitlines()
    cells = lines[2].split(",")
    cells[3] = repr(float(cells[3]) + 5e-7)  # 150 m late
    lines[2] = ",".join(cells)
    (folder / "toa.csv").write_text("\n".join(lines) + "\n", "utf-8")
    errors = []
    for i, switch in enumerate(["--robust", "--no-robust"]):
        out = tmp_path / str(i)
        assert run("locate", folder, switch, "--out", out)[0] == 0
        errors.append(
            np.linalg.norm(positions(table(out / "fixes.csv")[:1]) - path_at(np.zeros(1)))
        )
    assert errors[0] < 1.0 < 20.0 < errors[1]


@pytest.mark.parametrize("reference", ["a", "d"])
def test_chan_ho_takes_any_common_reference(reference: str, tmp_path: Path) -> None:
    t = np.array([0.0, 2.0, 4.0])
    folder = write_recording(
        tmp_path / "rec",
        times=t.tolist(),
        files={"toa.csv": "", "tdoa.csv": tdoa_table(reference, t)},
    )
    assert run("locate", folder, "--method", "chan-ho", "--out", tmp_path / "out")[0] == 0
    np.testing.assert_allclose(
        positions(table(tmp_path / "out" / "fixes.csv")), path_at(t), atol=1e-3
    )


def test_chan_ho_with_sigmas_per_row(tmp_path: Path) -> None:
    """Every scan has its own standard deviations; noise-free, so the truth comes out."""
    folder = write_recording(tmp_path / "rec")
    lines = (folder / "toa.csv").read_text("utf-8").splitlines()
    lines = [lines[0] + ",sigma_s"] + [
        f"{line},{1e-9 * (1 + k % 7)!r}" for k, line in enumerate(lines[1:])
    ]
    (folder / "toa.csv").write_text("\n".join(lines) + "\n", "utf-8")
    assert run("locate", folder, "--method", "chan-ho", "--out", tmp_path / "out")[0] == 0
    rows = table(tmp_path / "out" / "fixes.csv")
    t = np.array([float(row["time_s"]) for row in rows])
    np.testing.assert_allclose(positions(rows), path_at(t), atol=1e-3)


def test_incomplete_scans_fail_by_chan_ho_only(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec")
    lines = (folder / "toa.csv").read_text("utf-8").splitlines()
    del lines[3]
    (folder / "toa.csv").write_text("\n".join(lines) + "\n", "utf-8")
    for method, failed in (("chan-ho", 1), ("gauss-newton", 0)):
        out = tmp_path / method
        assert run("locate", folder, "--method", method, "--out", out)[0] == 0
        summary = json.loads((out / "summary.json").read_text("utf-8"))
        assert summary["overall"]["failed"] == failed
        assert table(out / "fixes.csv")[0]["converged"] == ("false" if failed else "true")
        assert (table(out / "fixes.csv")[0]["x_m"] == "") == bool(failed)


def test_one_pair_at_a_time_gives_no_fix(tmp_path: Path) -> None:
    rows = ["time_s,station,reference,tdoa_s,target"]
    rows += [f"{k},{'bcde'[k % 4]},a,1e-6,ship" for k in range(8)]
    folder = write_recording(
        tmp_path / "rec", files={"toa.csv": "", "tdoa.csv": "\n".join(rows) + "\n"}
    )
    code, text = run("locate", folder, "--out", tmp_path / "out")
    assert code == 2
    assert text.startswith("imm-tdoa: error: no scan has enough rows for a position of its own")
    assert text.count("\n") == 1


def test_chan_ho_refuses_several_references(tmp_path: Path) -> None:
    rows = ["time_s,station,reference,tdoa_s,target"]
    for k in range(3):
        rows += [f"{k},{s},{r},1e-6,ship" for s, r in ("ba", "cb", "dc", "ed")]
    folder = write_recording(
        tmp_path / "rec", files={"toa.csv": "", "tdoa.csv": "\n".join(rows) + "\n"}
    )
    code, text = run("locate", folder, "--method", "chan-ho")
    assert code == 2
    assert text == (
        "imm-tdoa: error: --method chan-ho: expected differences against one common reference "
        "station, got 4; use gauss-newton\n"
    )


def test_chan_ho_refuses_moving_stations(tmp_path: Path) -> None:
    lines = ["time_s,station,x_m,y_m,z_m"]
    for k in range(15):
        lines += [f"{2.0 * k},{s},{x},{y},0.0" for s, (x, y) in STATIONS.items()]
    head = HEAD.replace("dims = 2", "dims = 3")
    folder = write_recording(
        tmp_path / "rec",
        files={"stations.csv": "\n".join(lines) + "\n", "recording.toml": head, "truth.csv": ""},
    )
    code, text = run("locate", folder, "--method", "chan-ho")
    assert code == 2
    assert text == (
        "imm-tdoa: error: --method chan-ho: expected stations that stand still, these move; "
        "use gauss-newton\n"
    )


def test_without_a_recording_the_shipped_one(tmp_path: Path) -> None:
    """Twenty metres of noise per arrival, five stations: a fix is about as good as the noise."""
    with chdir(tmp_path):
        code, text = run("locate")
    assert code == 0
    summary = json.loads((tmp_path / "imm-tdoa-out/sample-fixes/summary.json").read_text("utf-8"))
    assert summary["recording"] == "sample"
    assert 10.0 < summary["overall"]["position_error_quartiles_m"][1] < 25.0
    assert "written to imm-tdoa-out/sample-fixes" in words(text)
