"""``imm-tdoa locate --sequence-filter``: which rows it takes, and what comes of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from cli_cases import HEAD, SPEED, STATIONS, run, table, words, write_recording
from numpy.testing import assert_allclose

from imm_tdoa import SequenceFilter, Stations, recording
from imm_tdoa.cli import sequences
from imm_tdoa.contract import Array
from imm_tdoa.recording.table import Table

PLACE = np.array([600.0, 400.0])
T = 60
SIGMA = 1e-9
CHAIN = (("c", "a"), ("c", "e"), ("b", "e"), ("b", "d"))  # a-c-e-b-d, some the other way round
DATA = Path(__file__).parents[4] / "shared" / "data"


def arrivals(seed: int = 1) -> Array:
    """Noisy arrivals (T, 5) from an emitter that stands, s."""
    places = np.array(list(STATIONS.values()))
    exact = np.linalg.norm(PLACE - places, axis=-1) / SPEED
    return exact + SIGMA * np.random.default_rng(seed).standard_normal((T, 5))


def toa_rows(arrival: Array) -> str:
    rows = ["time_s,emission,station,toa_s,target"]
    rows += [
        f"{2.0 * k},m{k},{s},{float(t)!r},buoy"
        for k, of_epoch in enumerate(arrival)
        for s, t in zip(STATIONS, of_epoch, strict=True)
        if np.isfinite(t)
    ]
    return "\n".join(rows) + "\n"


def tdoa_rows(arrival: Array, pairs: Sequence[tuple[str, str]]) -> str:
    column = {s: i for i, s in enumerate(STATIONS)}
    rows = ["time_s,station,reference,tdoa_s,target"]
    rows += [
        f"{2.0 * k},{a},{b},{float(t[column[a]] - t[column[b]])!r},buoy"
        for k, t in enumerate(arrival)
        for a, b in pairs
        if np.isfinite(t[column[a]] - t[column[b]])
    ]
    return "\n".join(rows) + "\n"


def buoy(folder: Path, **files: str) -> Path:
    """A recording of an emitter that stands, with its truth."""
    truth = "time_s,target,x_m,y_m\n" + "".join(
        f"{2.0 * k},buoy,{PLACE[0]},{PLACE[1]}\n" for k in range(T)
    )
    named = {name.replace("_", "."): text for name, text in files.items()}
    given = {"toa.csv": "", "truth.csv": truth, **named}
    return write_recording(folder, files=given)


def positions(out: Path) -> Array:
    rows = table(out / "fixes.csv")
    return np.array([[float(r["x_m"] or "nan"), float(r["y_m"] or "nan")] for r in rows])


def located(folder: Path) -> Array:
    """Positions (T, 2) as the command finds them, without its pictures."""
    return sequences.filtered_fixes(recording.read(folder), "buoy")[0].fix.position


def settings(head: str, sigma: str) -> str:
    return head.replace("toa_sigma_s = 1e-9", sigma)


def test_arrivals_of_an_emitter_that_stands(tmp_path: Path) -> None:
    arrival = arrivals()
    arrival[20, 2] = np.nan
    folder, out = buoy(tmp_path / "rec", toa_csv=toa_rows(arrival)), tmp_path / "out"
    code, text = run("locate", folder, "--sequence-filter", "--out", out)
    assert code == 0
    assert {f.name for f in out.iterdir()} == {"fixes.csv", "summary.json", "gdop.png", "error.png"}
    stage = SequenceFilter(
        Stations(np.array(list(STATIONS.values()))), toa_sigma=SIGMA, multiplier="auto"
    )
    found = stage.run(2.0 * np.arange(T), arrival[:, :-1] - arrival[:, 1:])
    assert_allclose(positions(out), found.position, atol=1e-4)
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert (summary["method"], summary["robust"]) == ("gauss-newton", None)
    told = summary["sequence_filter"]
    assert (told["rule"], told["multiplier"], told["gate"]) == ("iso", "auto", 3.0)
    own = told["targets"]["buoy"]
    assert own["differences"] == T * 4 - 2
    raw = np.linalg.norm(found.raw_position - PLACE, axis=-1)
    quartiles = own["unfiltered_position_error_quartiles_m"]
    assert_allclose(quartiles, np.quantile(raw, [0.25, 0.5, 0.75]), rtol=1e-4)
    assert summary["overall"]["position_error_quartiles_m"][1] < 0.5 * quartiles[1]
    assert summary["overall"]["converged"] == T
    said = words(text)
    assert "gauss-newton, filtered sequences" in said
    assert "buoy: gate failed at" in said
    assert "error without the filter" in said


@pytest.mark.parametrize("sigma", ["toa_sigma_s = 1e-9", "tdoa_sigma_s = 1.4142e-9"])
def test_differences_that_make_a_chain(sigma: str, tmp_path: Path) -> None:
    """In any order and either way round: the same as the filter on the chain's own differences."""
    arrival = arrivals(2)
    files = {"tdoa_csv": tdoa_rows(arrival, CHAIN), "recording_toml": settings(HEAD, sigma)}
    folder = buoy(tmp_path / "rec", **files)
    along = np.array([0, 2, 4, 1, 3])
    places = np.array(list(STATIONS.values()))[along]
    noise: dict[str, Any] = {"toa_sigma": 1e-9}
    if sigma.startswith("tdoa"):
        noise = {"tdoa_sigma": 1.4142e-9}
    stage = SequenceFilter(Stations(places), multiplier="auto", **noise)
    some = arrival[:, along]
    found = stage.run(2.0 * np.arange(T), some[:, :-1] - some[:, 1:])
    assert_allclose(located(folder), found.position, atol=1e-4)


def test_differences_against_one_reference(tmp_path: Path) -> None:
    """Made of arrivals of one standard deviation they say what the arrivals say."""
    arrival = arrivals(3)
    star = [(s, "c") for s in STATIONS if s != "c"]
    of_arrivals = located(buoy(tmp_path / "toa", toa_csv=toa_rows(arrival)))
    of_differences = located(buoy(tmp_path / "tdoa", tdoa_csv=tdoa_rows(arrival, star)))
    assert_allclose(of_differences, of_arrivals, atol=1e-4)


def test_stations_that_never_heard_are_left_out(tmp_path: Path) -> None:
    arrival = arrivals(4)
    arrival[:, 2] = np.nan
    found = located(buoy(tmp_path / "rec", toa_csv=toa_rows(arrival)))
    assert np.all(np.linalg.norm(found[20:] - PLACE, axis=-1) < 1.0)


def refused(folder: Path, tmp_path: Path, *more: str) -> str:
    code, text = run("locate", folder, "--sequence-filter", "--out", tmp_path / "out", *more)
    assert code == 2
    assert text.startswith("imm-tdoa: error: ")
    assert text.count("\n") == 1
    assert not (tmp_path / "out").exists()
    return text.removeprefix("imm-tdoa: error: ")


def test_other_methods_are_refused(tmp_path: Path) -> None:
    folder = buoy(tmp_path / "rec", toa_csv=toa_rows(arrivals()))
    text = refused(folder, tmp_path, "--method", "chan-ho")
    assert text.startswith("--sequence-filter: expected --method gauss-newton, got chan-ho")


@pytest.mark.parametrize(
    ("pairs", "sigma"),
    [
        ((("a", "b"), ("b", "c"), ("c", "a")), "toa_sigma_s = 1e-9"),  # a ring
        ((("a", "b"), ("c", "d"), ("d", "e")), "toa_sigma_s = 1e-9"),  # two pieces
        ((("a", "b"), ("a", "c"), ("a", "d")), "tdoa_sigma_s = 1e-9"),  # a star, independent
    ],
)
def test_pairs_that_make_no_chain_are_refused(
    pairs: tuple[tuple[str, str], ...], sigma: str, tmp_path: Path
) -> None:
    files = {"tdoa_csv": tdoa_rows(arrivals(), pairs), "recording_toml": settings(HEAD, sigma)}
    text = refused(buoy(tmp_path / "rec", **files), tmp_path)
    assert text.startswith("--sequence-filter: expected pairs that join the stations to one chain")


def test_pairs_that_change_are_refused(tmp_path: Path) -> None:
    rows = ["time_s,station,reference,tdoa_s,target"]
    rows += [f"{k},{'bcde'[k % 4]},a,1e-6,buoy" for k in range(8)]
    text = refused(buoy(tmp_path / "rec", tdoa_csv="\n".join(rows) + "\n"), tmp_path)
    assert text.startswith("--sequence-filter: expected differences of the same pairs of stations")


def test_no_neighbours_are_refused(tmp_path: Path) -> None:
    """Every scan lacks a station; no two differences of neighbours are there together."""
    arrival = arrivals()
    arrival[0::2, [1, 3]] = np.nan
    arrival[1::2, [0, 2]] = np.nan
    text = refused(buoy(tmp_path / "rec", toa_csv=toa_rows(arrival)), tmp_path)
    assert text.startswith(
        "--sequence-filter: no scan of target 'buoy' has 2 differences of stations next to each "
        "other in stations.csv, the fullest 1"
    )


def test_no_time_differences_are_refused(tmp_path: Path) -> None:
    rates = "time_s,emission,station,range_rate_mps,target\n" + "".join(
        f"0.0,m0,{s},1.0,buoy\n" for s in STATIONS
    )
    head = HEAD + "range_rate_sigma_mps = 0.1\n"
    folder = buoy(tmp_path / "rec", range_rate_csv=rates, recording_toml=head)
    (folder / "range.rate.csv").rename(folder / "range_rate.csv")
    text = refused(folder, tmp_path)
    assert text == "--sequence-filter: the recording has no time differences of arrival\n"


@pytest.mark.recordings
@pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not beside the project")
def test_a_car_drive_is_followed_with_a_lag() -> None:
    """Satellites move, receivers drop out; a target that drives is no target for this filter."""
    data = recording.read(DATA / "gnss_phone_drive")
    toa = data.toa
    assert toa is not None
    early = toa["time_s"] < 300.0
    some = Table({name: toa[name][early] for name in toa})
    fixes, result = sequences.filtered_fixes(attrs.evolve(data, toa=some), "phone")
    assert np.mean(fixes.good) > 0.97
    true, _ = data.truth_at("phone", fixes.times)
    error = np.linalg.norm(result.position - true, axis=-1)
    told = sequences.facts(data, "phone", result)["unfiltered_position_error_quartiles_m"]
    assert 8.0 < told[1] < 16.0
    assert told[1] < np.nanmedian(error) < 25.0
