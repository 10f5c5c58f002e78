"""Sentences say what the figures say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from results_cases import SCANS, Shelf, bank, chunk, grid, study, sweep, tuned

from imm_tdoa.study import results
from imm_tdoa.study.report import conclusions, lessons, words


def said(given: Any, shelf: Shelf) -> tuple[Any, dict[str, str]]:
    data = results.collect(given, shelf)
    return data, {name: "\n".join(lines) for name, lines in conclusions.conclude(data).items()}


def one(runs: int, variance: list[float], **options: Any) -> tuple[Any, Shelf, dict[str, Any]]:
    names = ["first", "second", "third", "fourth"][: len(variance)]
    given, shelf = study({"here": {}}, [bank(name) for name in names], runs=runs), Shelf()
    part = chunk(np.random.default_rng(3), runs, variance, **options)
    shelf.add("here", 0, part)
    return given, shelf, part


def test_the_best_is_named_with_its_figures() -> None:
    given, shelf, _ = one(200, [400.0, 100.0, 150.0])
    data, text = said(given, shelf)
    rmse = data["position_rmse"].values[0, 1]
    low, high = data["position_rmse_low"].values[0, 1], data["position_rmse_high"].values[0, 1]
    shown = words.measured(rmse, low, high, "m")
    assert text["here"].startswith(
        f"second is the most accurate: its position RMSE is {shown[0]} (95 % interval {shown[1]})"
    )
    gain = words.percent(1.0 - data["rmse_ratio"].values[0, 1, 2])
    assert f"{gain} (" in text["here"]
    assert "below that of third, the next (p < 0.001" in text["here"]
    assert "first errs most" in text["here"]


def test_what_cannot_be_told_apart_is_not_ranked() -> None:
    given, shelf, _ = one(100, [100.0, 100.5, 400.0])
    _, text = said(given, shelf)
    assert "cannot be told apart by 100 runs" in text["here"]
    assert "most accurate" not in text["here"]
    assert "Of those, first costs least: 10.0 µs a step, second 2.0 times that." in text["here"]


def test_overconfidence_and_care_are_told() -> None:
    given, shelf, part = one(100, [100.0, 100.0, 100.0])
    part["nees"][0] *= 2.0
    part["nees"][1] *= 0.5
    _, text = said(given, shelf)
    assert "first (2" in text["here"]
    assert "is too sure of itself; second (0.5" in text["here"]
    assert "is more careful than needed; third states its errors rightly" in text["here"]
    fair, shelf, _ = one(100, [100.0, 100.0, 100.0])
    assert "All banks state their errors rightly." in said(fair, shelf)[1]["here"]


def test_rare_losses_and_failures_are_told() -> None:
    given, shelf, part = one(100, [100.0, 100.0])
    part["position_mse"][0, :3] = 1e6
    for name in ("position_mse", "velocity_mse", "position_error", "nees", "log_likelihood"):
        part[name][1, :7] = np.nan
    part["failed"][1, :7] = True
    _, text = said(given, shelf)
    assert "The error of first rests on few runs: they weigh as much as 3.0 of 100" in text["here"]
    assert "second failed in 7 of 100 runs (3.4 % to 14 %)" in text["here"]


def test_nothing_left() -> None:
    given, shelf, part = one(30, [100.0, 100.0])
    for name, values in part.items():
        if values.dtype == float and values.shape == (2, 30):
            part[name] = np.full((2, 30), np.nan)
        if name.startswith("count_"):
            part[name] = np.zeros((2, SCANS))
    part["failed"][:] = True
    _, text = said(given, shelf)
    assert text["here"].startswith("No bank came through this scenario")
    assert "first failed in 30 of 30 runs" in text["here"]


@pytest.mark.parametrize(
    ("bound", "sentence"),
    [
        (200.0, "first reaches the Cramér-Rao bound"),
        (100.0, "no estimator can gain more than that"),
        (500.0, "first errs less than the Cramér-Rao bound"),
        (190.0, "little is left to gain"),
    ],
)
def test_the_bound(bound: float, sentence: str) -> None:
    """Two components of variance 100: the mean squared error is 200."""
    given, shelf, _ = one(400, [100.0])
    shelf.bounds["here"] = {"position_bound": np.full(SCANS, bound)}
    data, text = said(given, shelf)
    assert sentence in text["here"]
    np.testing.assert_allclose(data["bound_ratio"], np.sqrt(200.0 / bound), rtol=0.02)


def test_no_bound_has_a_reason() -> None:
    given, shelf, _ = one(10, [100.0])
    shelf.bounds["here"] = {"position_bound": np.full(SCANS, np.nan), "reason": "legs differ"}
    assert "no Cramér-Rao bound to compare with: legs differ." in said(given, shelf)[1]["here"]


def test_evidence_that_disagrees_with_accuracy_is_told() -> None:
    given, shelf, _ = one(150, [100.0, 200.0], lead=[0.0, 5.0])
    _, text = said(given, shelf)
    assert "second explains the measurements best" in text["here"]
    assert "though first is the more accurate" in text["here"]


def test_along_a_sweep_it_says_where_the_best_changes() -> None:
    _, text = said(*sweep())
    whole = text[""]
    assert (
        "Over acceleration from 0 to 4 m/s², cv is not beaten at first, from 2 m/s² on ca" in whole
    )
    assert "ca is chosen in most runs by aic and bic from 2 m/s² on" in whole
    assert "ca is more accurate than cv only from 2 m/s² on; below it is worse." in whole
    assert "risks least" in whole


def test_a_criterion_that_sees_more_than_helps() -> None:
    """Chosen from the beginning, more accurate nowhere."""
    given, shelf = sweep()
    rng = np.random.default_rng(8)
    for case in given.scenarios:
        shelf.chunks_of[case.name] = []
        part = chunk(rng, 120, [100.0, 300.0, 310.0], modes=2, choice=[1.0, 0.0])
        shelf.add(case.name, 0, part)
    _, text = said(given, shelf)
    assert "ca is chosen in most runs by aic from 0 m/s² on and by bic nowhere for good" in text[""]
    assert "Nowhere here is ca more accurate than cv." in text[""]


def test_over_two_parameters_it_counts_the_cells() -> None:
    given, shelf = grid(runs=300)
    data, text = said(given, shelf)
    alone = sum(lessons.undefeated(data, i) == [1] for i in range(12))
    assert f"fast is the best alone in {alone} (noise factor of 2 and more)" in text[""]
    assert "Of 12 points over noise factor and interval: " in text[""]
    over = lessons.regret(data)
    safe = int(np.argmin(over.max(axis=0)))
    worst = words.number(float(over.max(axis=0)[safe]))
    assert f"{given.banks[safe].name} risks least: its error is at worst {worst}" in text[""]


def test_a_parameter_that_is_a_name_counts_as_one() -> None:
    points = {
        f"x {layout} {s:g}": {"layout": layout, "noise_factor": s}
        for layout in ("ring", "line")
        for s in (1.0, 2.0)
    }
    given, shelf = study(points, [bank("a"), bank("b")], runs=60, base="x"), Shelf()
    for case in given.scenarios:
        good = 1.0 if case.point["layout"] == "ring" else 4.0
        shelf.add(case.name, 0, chunk(np.random.default_rng(1), 60, [good, 2.0]))
    _, text = said(given, shelf)
    assert "Of 4 points over layout and noise factor: " in text[""]
    assert "Over noise factor from" not in text[""]


def test_what_mistuning_costs() -> None:
    data, text = said(*tuned(runs=400))
    assert "The process noise factor is best at 1 on average" in text[""]
    over = lessons.regret(data)
    value = data["bank_value"].values[:, 0]
    mean = np.exp(np.log(over).mean(axis=0))
    cost = mean[value == 10.0].min() / mean[value == 1.0].min() - 1.0
    assert f"{words.percent(cost)} at 10" in text[""]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (9.996, "10.0"), (12.34, "12.3"), (1234.0, "1234"), (1e-5, "1.00e-05")],
)
def test_numbers(value: float, text: str) -> None:
    assert words.number(value) == text


def test_figures_are_told_to_what_is_uncertain() -> None:
    assert words.measured(14.4169, 14.0724, 14.7925, "m") == ("14.42 m", "14.07 to 14.79 m")
    assert words.measured(23456.0, 23000.0, 24000.0, "m") == ("23.46 km", "23.00 to 24.00 km")
    assert words.measured(5.0, 5.0, 5.0, "s") == ("5.00 s", "5.00 to 5.00 s")
    assert words.measured(5.0, np.nan, np.nan, "s") == ("5.00 s", "-")
    assert words.measured(5.0, 1.0, np.inf) == ("5.00", "-")
    assert [words.percent(p) for p in (0.0, 0.017, 0.5, 0.995, 1.0)] == [
        "0 %",
        "1.7 %",
        "50 %",
        "99.5 %",
        "100 %",
    ]
    assert words.seconds(3.81e-5) == "38.1 µs"
    assert words.axis("toa_sigma_s") == "toa sigma [ns]"
    assert words.amount("toa_sigma_s", 7e-8) == "70 ns"
