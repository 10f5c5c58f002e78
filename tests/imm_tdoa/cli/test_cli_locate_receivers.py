"""``imm-tdoa locate`` by the estimators that know of receiver errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_cases import HEAD, STATIONS, path_at, run, table, write_recording


@pytest.mark.parametrize("method", ["two-step", "joint"])
@pytest.mark.parametrize("sigma", [None, "2.5"])
def test_noise_free_fixes_are_the_truth(method: str, sigma: str | None, tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec", targets=("ship", "boat"))
    out = tmp_path / "out"
    more = [] if sigma is None else ["--station-sigma", sigma]
    code, _ = run("locate", folder, "--method", method, *more, "--out", out)
    assert code == 0
    rows = table(out / "fixes.csv")
    t = np.array([float(row["time_s"]) for row in rows])
    found = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    np.testing.assert_allclose(found, path_at(t), atol=1e-3)
    assert {row["converged"] for row in rows} == {"true"}
    spread = np.array([float(row["sx_m"]) for row in rows])
    assert np.all(spread < 0.5 if sigma is None else spread > 1.0)
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["method"] == method
    assert summary["robust"] is None
    assert summary["station_sigma_m"] == (None if sigma is None else 2.5)


def test_least_squares_takes_station_errors_too(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec")
    spreads = []
    for i, more in enumerate(([], ["--station-sigma", "2.5"])):
        out = tmp_path / str(i)
        assert run("locate", folder, "--no-robust", *more, "--out", out)[0] == 0
        spreads.append(float(table(out / "fixes.csv")[0]["sx_m"]))
    assert spreads[1] > 3.0 * spreads[0]


@pytest.mark.parametrize("method", ["two-step", "joint"])
def test_what_these_methods_cannot_take_is_told(method: str, tmp_path: Path) -> None:
    names = list(STATIONS)[: 2 if method == "joint" else 3]
    stations = "station,x_m,y_m\n" + "\n".join(
        f"{s},{STATIONS[s][0]},{STATIONS[s][1]}" for s in names
    )
    rows = "\n".join(f"0.0,e,{s},{1e-6 * i},ship" for i, s in enumerate(names))
    toa = f"time_s,emission,station,toa_s,target\n{rows}\n"
    few = write_recording(tmp_path / "few", files={"stations.csv": stations + "\n", "toa.csv": toa})
    code, text = run("locate", few, "--method", method, "--out", tmp_path / "out")
    assert code == 2
    assert f"{method.replace('-', '_')} needs at least" in text
    assert text.count("\n") == 1
    fdoa = "time_s,station,reference,range_rate_difference_mps,target\n0.0,b,a,1.0,ship\n"
    head = HEAD + "range_rate_sigma_mps = 0.1\n"
    only = write_recording(
        tmp_path / "only", files={"toa.csv": "", "fdoa.csv": fdoa, "recording.toml": head}
    )
    code, text = run("locate", only, "--method", method, "--out", tmp_path / "out")
    assert code == 2
    assert f"--method {method}: the recording has no time differences" in text


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--station-sigma", "0"], "--station-sigma: expected a number above 0"),
        (["--station-sigma", "-1"], "--station-sigma: expected a number above 0"),
        (["--station-sigma", "nan"], "--station-sigma: expected a finite number"),
        (["--station-sigma", "big"], "Invalid value for '--station-sigma'"),
        (["--method", "three-step"], "Invalid value for '--method'"),
    ],
)
def test_bad_options_are_one_line(arguments: list[str], part: str, tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "rec")
    code, text = run("locate", folder, *arguments, "--out", tmp_path / "out")
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert part in text
    assert text.count("\n") == 1
    assert not (tmp_path / "out").exists()
