"""The Dataset and the tables of a study against numpy on all runs at once."""

from __future__ import annotations

import csv
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from results_cases import DIMS, SCANS, Shelf, bank, chunk, grid, study, sweep, tuned
from scipy import stats

from imm_tdoa.study import results
from imm_tdoa.study.results import collecting


@pytest.fixture(scope="module")
def swept() -> tuple[Any, Shelf, xr.Dataset]:
    given, shelf = sweep()
    return given, shelf, results.collect(given, shelf)


def whole(shelf: Shelf, scenario: str, name: str) -> Any:
    return np.concatenate([shelf.load(p)[name] for p in shelf.chunks(scenario)], axis=-1)


def test_errors_of_every_bank(swept: tuple[Any, Shelf, xr.Dataset]) -> None:
    given, shelf, data = swept
    for case in given.scenarios:
        mse = whole(shelf, case.name, "position_mse")
        there = data.sel(scenario=case.name)
        np.testing.assert_allclose(there["position_rmse"], np.sqrt(mse.mean(axis=1)))
        assert np.all(there["position_rmse_low"] < there["position_rmse"])
        assert np.all(there["position_rmse"] < there["position_rmse_high"])
        nees = whole(shelf, case.name, "nees").mean(axis=1) / DIMS
        np.testing.assert_allclose(there["nees_ratio"], nees)
        nis = whole(shelf, case.name, "nis").sum(1) / whole(shelf, case.name, "nis_dof").sum(1)
        np.testing.assert_allclose(there["nis_ratio"], nis)
        np.testing.assert_allclose(there["bound_ratio"], np.sqrt(mse.mean(axis=1)) / np.sqrt(150.0))
        np.testing.assert_allclose(
            there["position_error"], whole(shelf, case.name, "position_error").mean(axis=1)
        )
    assert np.all(data["runs_used"] == given.runs)
    np.testing.assert_allclose(data["seconds_per_step"][0], [1e-5, 2e-5, 3e-5])


def test_pairs_are_tested_on_the_same_runs(swept: tuple[Any, Shelf, xr.Dataset]) -> None:
    given, shelf, data = swept
    case = given.scenarios[1].name
    a, b, c = whole(shelf, case, "position_mse")
    there = data.sel(scenario=case)
    p = [stats.ttest_rel(x, y).pvalue for x, y in ((a, b), (a, c), (b, c))]
    upper = ([0, 0, 1], [1, 2, 2])
    np.testing.assert_allclose(there["p"].values[upper], p, rtol=1e-6)
    ordered = np.sort(p) * [3, 2, 1]
    np.testing.assert_allclose(np.sort(there["p_holm"].values[upper]), ordered, rtol=1e-6)
    np.testing.assert_allclose(
        there["rmse_ratio"].sel(bank="ca", other="cv"), np.sqrt(b.mean() / a.mean())
    )
    assert np.isnan(np.diag(there["p"])).all()
    assert there["letters"].values.tolist() == ["a", "b", "b"]
    assert there["place"].values[0] == 1


def test_evidence_is_paired_too(swept: tuple[Any, Shelf, xr.Dataset]) -> None:
    given, shelf, data = swept
    case = given.scenarios[0].name
    evidence = whole(shelf, case, "log_likelihood")
    there = data.sel(scenario=case)
    best = int(np.argmax(evidence.mean(axis=1)))
    np.testing.assert_allclose(
        there["evidence_gap"], (evidence - evidence[best]).mean(axis=1), atol=1e-12
    )
    low, high = stats.ttest_rel(evidence[1], evidence[best]).confidence_interval(0.95)
    np.testing.assert_allclose(there["evidence_gap_low"][1], low)
    np.testing.assert_allclose(there["evidence_gap_high"][1], high)
    wins = np.mean(np.argmax(evidence, axis=0) == 0)
    np.testing.assert_allclose(there["evidence_wins"][0], wins)
    ranked = np.sort(evidence, axis=0)
    np.testing.assert_allclose(there["evidence_margin"], np.mean(ranked[-1] - ranked[-2]))


def test_likelihoods_of_other_measurements_are_not_compared() -> None:
    given = study({"one": {}}, [bank("all"), bank("gated")], runs=20)
    shelf = Shelf()
    part = chunk(np.random.default_rng(0), 20, [1.0, 1.0], lead=[0.0, 50.0])
    part["nis_dof"][0, 3] -= 3.0
    shelf.add("one", 0, part)
    data = results.collect(given, shelf)
    assert np.isnan(data["evidence_gap"].values[0, 0])
    assert data["evidence_gap"].values[0, 1] == 0.0


def test_time_modes_and_choices(swept: tuple[Any, Shelf, xr.Dataset]) -> None:
    given, shelf, data = swept
    case = given.scenarios[2].name
    parts = [shelf.load(path) for path in shelf.chunks(case)]
    there = data.sel(scenario=case)
    count = sum(part["count_position_square"] for part in parts)
    total = sum(part["sum_position_square"] for part in parts)
    np.testing.assert_allclose(there["position_rmse_by_time"], np.sqrt(total / count))
    low, high = stats.chi2.interval(0.95, given.runs * DIMS)
    np.testing.assert_allclose(
        there["nees_ratio_by_time_low"], np.full((3, SCANS), low / given.runs / DIMS)
    )
    np.testing.assert_allclose(there["nees_ratio_by_time_high"][0, 0], high / given.runs / DIMS)
    inside = (there["nees_ratio_by_time"] > low / given.runs / DIMS) & (
        there["nees_ratio_by_time"] < high / given.runs / DIMS
    )
    np.testing.assert_allclose(there["nees_inside"], inside.mean("time"))
    np.testing.assert_allclose(there["mode_probability"].sel(bank="imm").sum("mode"), 1.0)
    np.testing.assert_allclose(there["position_bound_by_time"], np.sqrt(150.0))
    chosen = whole(shelf, case, "selected_model")
    np.testing.assert_allclose(there["chosen"][:, 1], chosen.mean(axis=1))
    exact = stats.binomtest(int(chosen[0].sum()), given.runs).proportion_ci(method="wilson")
    np.testing.assert_allclose(there["chosen_low"][0, 1], exact.low)
    selected = whole(shelf, case, "selected")[2]
    np.testing.assert_allclose(there["selected"].sel(bank="imm")[0], np.mean(selected == 0))
    assert np.isnan(there["selected"].sel(bank="cv")).all()  # one mode chooses nothing


def test_it_does_not_matter_how_runs_are_cut_into_chunks(
    swept: tuple[Any, Shelf, xr.Dataset],
) -> None:
    given, shelf, data = swept
    one = Shelf()
    one.bounds = shelf.bounds
    for case in given.scenarios:
        parts = [shelf.load(path) for path in shelf.chunks(case.name)]
        joined = {}
        for name in parts[0]:
            if name.startswith(("count_", "sum")):
                joined[name] = np.sum([part[name] for part in parts], axis=0)
            elif name in ("times", "dims"):
                joined[name] = parts[0][name]
            else:
                joined[name] = np.concatenate([part[name] for part in parts], axis=-1)
        one.add(case.name, 0, joined)
    again = results.collect(given, one)
    assert set(again) == set(data)
    for name in data:
        kind = data[name].dtype.kind
        compare = np.testing.assert_allclose if kind == "f" else np.testing.assert_array_equal
        compare(
            again[name].values,
            data[name].values,
            **({"rtol": 1e-9, "atol": 1e-12} if kind == "f" else {}),
        )


def test_failed_runs_count_as_failures_and_nowhere_else() -> None:
    given = study({"one": {}}, [bank("good"), bank("bad"), bank("ugly")], runs=40)
    part = chunk(np.random.default_rng(1), 40, [1.0, 1.0, 4.0])
    for name in ("position_mse", "velocity_mse", "position_error", "nees", "log_likelihood"):
        part[name][1, :10] = np.nan
        part[name][2] = np.nan
    part["failed"][1, :10] = part["failed"][2] = True
    part["selected"][1, :10] = part["selected"][2] = -1
    shelf = Shelf()
    shelf.add("one", 0, part)
    data = results.collect(given, shelf)
    np.testing.assert_allclose(data["failed"][0], [0.0, 0.25, 1.0])
    np.testing.assert_array_equal(data["runs_used"][0], [40, 30, 0])
    mse = part["position_mse"]
    np.testing.assert_allclose(data["position_rmse"][0, 1], np.sqrt(mse[1, 10:].mean()))
    p = stats.ttest_rel(mse[0, 10:], mse[1, 10:]).pvalue
    np.testing.assert_allclose(data["p"].values[0, 0, 1], p)
    np.testing.assert_allclose(data["p_holm"].values[0, 0, 1], p)  # the only pair that there is
    assert data["letters"].values[0, 2] == ""
    assert data["place"].values[0, 2] == 3


def test_scenarios_of_different_length_and_a_study_that_was_interrupted() -> None:
    given = study({"long": {}, "short/er": {}}, [bank("a"), bank("b")], runs=50)
    shelf, rng = Shelf(), np.random.default_rng(2)
    shelf.add("long", 0, chunk(rng, 20, [1.0, 2.0]))
    cut = chunk(rng, 50, [1.0, 2.0])
    for name, values in cut.items():
        if name.startswith(("count_", "sum")):
            cut[name] = values[:, :7]
    cut["times"] = cut["times"][:7]
    shelf.add("short/er", 0, cut)
    data = results.collect(given, shelf)
    assert data["runs_done"].values.tolist() == [20, 50]
    assert np.isfinite(data["time_s"]).sum("time").values.tolist() == [SCANS, 7]
    assert np.isnan(data["position_rmse_by_time"][1, :, 7:]).all()
    assert np.isnan(data["run_nees"][0, :, 20:]).all()
    shelf.chunks_of["short/er"] = []
    with pytest.raises(ValueError, match="no finished run of scenario 'short/er'"):
        results.collect(given, shelf)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_what_is_written_reads_back(swept: tuple[Any, Shelf, xr.Dataset], tmp_path: Path) -> None:
    given, shelf, data = swept
    files = results.write(data, given, shelf, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(files)
    with xr.open_dataset(tmp_path / "results.nc", engine="scipy") as read:
        assert "seconds_per_step" not in read
        np.testing.assert_array_equal(read["position_rmse"], data["position_rmse"])
        assert read["letters"].values.tolist() == data["letters"].values.tolist()
        assert read["scenario"].values.tolist() == data["scenario"].values.tolist()
        assert read.attrs["seed"] == str(2**63 + 5)
        assert read["position_rmse"].attrs["units"] == "m"
    summary = rows(tmp_path / "summary.csv")
    (one,) = [
        row
        for row in summary
        if (row["acceleration_mps2"], row["bank"], row["metric"]) == ("2.0", "ca", "position_rmse")
    ]
    assert float(one["value"]) == data["position_rmse"].values[2, 1]
    assert float(one["high"]) == data["position_rmse_high"].values[2, 1]
    assert (one["unit"], one["place"], one["letters"]) == ("m", "1", "a")
    assert len(rows(tmp_path / "pairs.csv")) == 4 * 3
    assert len(rows(tmp_path / "by_time.csv")) == 4 * 3 * SCANS
    assert len(rows(tmp_path / "modes_by_time.csv")) == 4 * SCANS * 2
    every = rows(tmp_path / "runs.csv")
    assert len(every) == 4 * 120 * 3
    assert [row["run"] for row in every[:360:3]] == [str(i) for i in range(120)]
    picked = every[3 * 57 + 2]
    mse = whole(shelf, given.scenarios[0].name, "position_mse")[2, 57]
    assert (picked["bank"], float(picked["position_rmse_m"])) == ("imm", np.sqrt(mse))
    assert picked["selected"] in ("cv", "ca")
    assert every[0]["mode_hit"] == ""
    choices = rows(tmp_path / "choices_by_run.csv")
    assert len(choices) == 4 * 120 * 2
    share = np.mean([row["chosen"] == "ca" for row in choices[:240:2]])
    np.testing.assert_allclose(share, data["chosen"].values[0, 0, 1])


def test_parquet_says_the_same(swept: tuple[Any, Shelf, xr.Dataset], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    given, shelf, data = swept
    results.write(data, given, shelf, tmp_path)
    for path in tmp_path.glob("*.parquet"):
        table = parquet.read_table(path).to_pylist()
        read = rows(path.with_suffix(".csv"))
        assert len(table) == len(read)
        for row, line in zip(table[::37], read[::37], strict=True):
            for name, value in row.items():
                text = line[name]
                assert text == ("" if value is None else str(value))


def test_all_but_the_cost_is_the_same_to_the_last_byte(tmp_path: Path) -> None:
    given, shelf = sweep(runs=30)
    for name in ("a", "b"):
        data = results.collect(given, shelf)
        if name == "b":
            data["seconds_per_step"] = 2.0 * data["seconds_per_step"]
        results.write(data, given, shelf, tmp_path / name)
    for path in (tmp_path / "a").iterdir():
        same = path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
        assert same == (path.stem != "cost")


@pytest.mark.parametrize("make", [grid, tuned])
def test_a_study_without_some_axes_reads_back(make: Any, tmp_path: Path) -> None:
    """NetCDF 3 has no axis of length 0: no criteria, nothing swept."""
    given, shelf = make(runs=12)
    results.write(results.collect(given, shelf), given, shelf, tmp_path)
    with xr.open_dataset(tmp_path / "results.nc", engine="scipy") as read:
        assert read.sizes["bank"] == len(given.banks)
    assert not (tmp_path / "choices.csv").exists()


class Lazy(Shelf):
    """Makes its chunks when they are read."""

    def __init__(self, chunks: int) -> None:
        super().__init__()
        self.chunks_of = {"one": [Path(f"one-{40 * k:08d}.npz") for k in range(chunks)]}

    def load(self, path: Path) -> dict[str, Any]:
        return chunk(np.random.default_rng(int(path.stem[4:])), 40, [1.0, 2.0])

    def steps(self, path: Path) -> int:
        return 40 * SCANS

    def cost(self, path: Path) -> Any:
        return np.ones(2)


def test_memory_does_not_grow_with_the_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collecting, "KEPT_RUNS", 0)
    peaks = []
    for chunks in (3, 3, 15):  # the first warms up
        given = study({"one": {}}, [bank("a"), bank("b")], runs=40 * chunks)
        tracemalloc.start()
        data = results.collect(given, Lazy(chunks))
        results.write(data, given, Lazy(chunks), tmp_path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert "run" not in data.dims
    assert len(rows(tmp_path / "runs.csv")) == 1200
    assert peaks[2] < 1.3 * peaks[1]
