"""The shipped studies: each says what it asks, runs, and finds what is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imm_tdoa import bounds, study
from imm_tdoa.study.chunk import Task, work
from imm_tdoa.study.draw import clock, stations_of

NAMES = ("discrimination", "geometry", "mistuning", "mixing-rules", "motion-form")
# ALGORITHMS §11: share of runs that choose constant acceleration
TABLE = {
    0.0: (0.17, 0.02, 0.03, 0.00, 0.00, 0.02),
    0.5: (0.29, 0.06, 0.11, 0.00, 0.00, 0.06),
    1.0: (0.67, 0.31, 0.42, 0.08, 0.00, 0.09),
    2.0: (0.99, 0.91, 0.95, 0.65, 0.30, 0.39),
    3.0: (1.0, 1.0, 1.0, 0.98, 0.88, 0.85),
    5.0: (1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
}


def runs_of(plan: study.Study, scenario: str, runs: int) -> dict[str, Any]:
    """Return the figures of the first runs of a scenario."""
    number = [case.name for case in plan.scenarios].index(scenario)
    engines: Any = ("numpy",) * len(plan.banks)
    return work(Task(plan.text, number, 0, runs, engines)).arrays


def test_these_ship() -> None:
    assert study.shipped() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_each_says_what_it_asks_and_how_to_read_it(name: str) -> None:
    plan = study.load(name)
    for text in (plan.title, plan.question, plan.reading):
        assert len(text) > 30
    assert plan.question.rstrip().endswith("?")
    assert len({case.name for case in plan.scenarios}) == len(plan.scenarios)
    assert plan.runs >= 200


@pytest.mark.parametrize("a", sorted(TABLE))
def test_discrimination_finds_the_table(a: float) -> None:
    """Within ±0.10 and what chance does to so few runs; 1000 runs are within ±0.10 alone."""
    n = 80
    figures = runs_of(study.load("discrimination"), f"flight a={a:g} m/s²", n)
    share = (figures["selected_model"] == 1).mean(axis=1)
    known = np.array(TABLE[a])
    assert np.all(np.abs(share - known) <= 0.10 + 2.0 * np.sqrt(known * (1.0 - known) / n))


# ALGORITHMS §5.4: mean error, km, of static, CV, CA and the IMM under three rules
KNOWN = {
    "standing": (0.339, 0.593, 0.759, 0.339, 0.356, 0.349),
    "straight on": (11.08, 0.596, 0.767, 0.601, 0.606, 0.603),
    "accelerating": (27.7, 10.84, 0.782, 0.816, 0.787, 0.784),
}


@pytest.mark.parametrize("scenario", KNOWN)
def test_motion_form_finds_what_an_imm_costs(scenario: str) -> None:
    plan = study.load("motion-form")
    assert [bank.name for bank in plan.banks] == [
        "static",
        "CV",
        "CA",
        "CA tuned",
        "IMM birth",
        "IMM unbiased",
        "IMM zero",
    ]
    figures = runs_of(plan, scenario, 90)
    error = figures["position_error"][[0, 1, 2, 4, 5, 6]] / 1e3
    mean, spread = error.mean(axis=1), error.std(axis=1) / np.sqrt(90)
    # beside chance a tenth: the known figures are another program's, of a hundred runs
    assert np.all(np.abs(mean / KNOWN[scenario] - 1.0) < 0.1 + 3.0 * spread / mean)
    right = list(KNOWN).index(scenario)
    assert np.all(figures["selected_model"][0] == right)


def test_mixing_rules_matter_more_than_the_chain() -> None:
    """§5.4: on switching targets birth 0.56-0.59, unbiased 2.7-3.0, zero 7.2-8.1, best 0.79 km."""
    plan = study.load("mixing-rules")
    figures = runs_of(plan, "switching", 90)
    error = dict(zip([b.name for b in plan.banks], figures["position_error"], strict=True))
    mean = {name: values.mean() / 1e3 for name, values in error.items()}
    assert mean["0.99 birth"] == pytest.approx(0.59, rel=0.12)
    assert mean["0.99 birth"] < 0.9 * mean["CA tuned"]
    assert mean["CA tuned"] == pytest.approx(0.787, rel=0.12)
    for stay in ("0.99", "0.95", "0.80"):
        assert mean[f"{stay} birth"] < 0.5 * mean[f"{stay} unbiased"] < 0.5 * mean[f"{stay} zero"]
    assert mean["0.80 birth"] < 0.5 * mean["0.99 unbiased"]
    nees = dict(zip([b.name for b in plan.banks], figures["nees"].mean(axis=1), strict=True))
    assert nees["0.99 birth"] < 4.0
    assert nees["0.99 zero"] > 100.0


def test_geometry_tells_the_dilution_of_precision() -> None:
    plan = study.load("geometry")
    gdop = {}
    for case in plan.scenarios:
        if case.point["toa_sigma_s"] == 70e-9:
            from imm_tdoa.study import bounds as study_bounds

            small = study.load("geometry", runs=1)
            found = study_bounds.bound(small, case)
            where = np.array(case.plan.targets[0].position_m)
            times = clock(case.plan)
            first = bounds.gdop(stations_of(case.plan, times), where)
            assert found["gdop"][0] == pytest.approx(float(first))
            assert np.all(np.isfinite(found["position_bound"])), found["reason"]
            gdop[case.point["layout"]] = found["gdop"].mean()
    assert list(gdop) == sorted(gdop, key=lambda name: gdop[name])
    assert gdop["cluster"] > 20.0 * gdop["ring"]


def test_mistuning_knows_the_truth_best() -> None:
    plan = study.load("mistuning")
    figures = runs_of(plan, "vehicle stays 20 s", 30)
    names = [bank.name for bank in plan.banks]
    truth = names.index("IMM q×1 sojourn×1")
    evidence = figures["log_likelihood"]
    lead = evidence[truth] - np.delete(evidence, truth, axis=0)
    assert np.all(lead.mean(axis=1) > 0.0)  # Gibbs: no other law explains its data better
    nees = figures["nees"].mean(axis=1)
    assert nees[truth] < 3.0
    assert nees[names.index("IMM q×0.01 sojourn×10")] > 1.2 * nees[truth]


def test_bound_is_below_what_the_matching_filter_does(tmp_path: Path) -> None:
    """A single CV filter on straight targets: its error is the bound, within chance."""
    plan = study.load("motion-form", runs=90)
    case = plan.scenario("straight on")
    from imm_tdoa.study.bounds import bound

    least = bound(plan, case)["position_bound"]
    figures = runs_of(plan, "straight on", 90)
    square = figures["sum_position_square"][1, 1:] / figures["count_position_square"][1, 1:]
    assert np.sqrt(square.mean() / least[1:].mean()) == pytest.approx(1.0, abs=0.15)
