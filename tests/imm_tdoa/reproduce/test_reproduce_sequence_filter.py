"""Source B: the spot that shrinks and when, kappa that foretells it, what movers pay (§6)."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from imm_tdoa.reproduce import sequence_filter
from imm_tdoa.reproduce.sequence_filter import (
    CASES,
    JUMPS,
    Outcome,
    Spots,
    Switches,
    geometries,
    moving,
    report,
    scenario,
)
from imm_tdoa.reproduce.sequence_filter.spots import radius, together
from imm_tdoa.sequence_filter import FilteredSequence, steady_lag

RUNS = 50


@cache
def outcome(name: str, weights: Any = "diagonal") -> Outcome:
    return sequence_filter.run(name, weights, RUNS)


@pytest.mark.parametrize("weights", ["full", "diagonal"])
def test_the_spot_shrinks(weights: Any) -> None:
    """Inside a ring of 6, iso: at least 15-fold, median of 50 runs, last 100 of 300 epochs."""
    found = outcome("iso", weights)
    assert found.kappa < 1.0
    assert len(found.spots.radius_m) == RUNS
    assert found.fixes.shape == (300, 2)
    assert found.spots.shrink >= 15.0
    assert found.spots.gain > 10.0
    # a small spot is not a small error
    assert together(found.spots.error_m) > 1.5 * together(found.spots.radius_m)


@pytest.mark.parametrize("name", ["iso", "bound", "four", "outside", "no-noise"])
def test_beside_the_figures_of_another_program(name: str) -> None:
    """§6.2. A run's ratio of radii has a spread of about a quarter, its error one of 0.4.

    Medians and rms of 50 runs in both programs, and the target not in quite the same place.
    """
    found = outcome(name)
    kappa, shrink, gain = found.case.reference
    assert found.kappa == pytest.approx(kappa, rel=0.04)
    spread = np.std(np.log(found.spots.raw_radius_m / found.spots.radius_m))
    allowed = 3.0 * np.sqrt(2.0) * 1.25 * spread / np.sqrt(RUNS) + 0.05
    assert abs(np.log(found.spots.shrink / shrink)) < allowed
    assert abs(np.log(found.spots.gain / gain)) < 3.0 * np.sqrt(2.0) * 0.4 / np.sqrt(RUNS)


def test_the_worst_case_bound_and_places_outside_do_not_shrink() -> None:
    for name in ("bound", "outside"):
        found = outcome(name)
        assert found.kappa > 1.0
        assert found.spots.shrink < 2.0
    scaled = sequence_filter.run("outside-auto", "full", 20)
    assert scaled.kappa == pytest.approx(0.5)
    assert scaled.spots.shrink > 15.0


def test_without_process_noise_as_theory_says() -> None:
    """A running mean whose first value weighs half: spot and error follow by hand."""
    found = outcome("no-noise")
    k = np.arange(300.0 - scenario.LAST, 300.0) + 0.5
    error = np.sqrt(np.mean(1.0 / k))
    within = np.sqrt(np.mean(1.0 / k) - np.mean(1.0 / np.maximum(k[:, None], k)))
    raw = together(found.spots.raw_error_m)
    for measured, predicted in ((found.spots.error_m, error), (found.spots.radius_m, within)):
        square = measured**2
        standard_error = np.std(square) / np.sqrt(RUNS)
        assert abs(square.mean() - (predicted * raw) ** 2) < 4.0 * standard_error


def test_kappa_foretells_it() -> None:
    """At least 9 of 10 random geometries, in two and three dimensions."""
    found = [sequence_filter.try_one(number, 8) for number in range(10)]
    assert {g.dims for g in found} == {2, 3}
    assert {g.predicted for g in found} == {True, False}
    assert sum(g.right for g in found) >= 9


def test_slow_targets_pay_with_lag() -> None:
    """§6.3: at 1 m/s 1.55 times narrower, 0.81 m behind, 0.906 m become 1.028."""
    slow = sequence_filter.band(1.0, "diagonal", RUNS)
    ratio, lag, raw, after = slow.reference
    assert slow.raw_width_m / slow.width_m == pytest.approx(ratio, rel=0.05)
    assert slow.lag_m == pytest.approx(lag, rel=0.05)
    assert slow.raw_error_m == pytest.approx(raw, rel=0.06)  # along another path
    assert slow.error_m == pytest.approx(after, rel=0.06)
    assert slow.error_m > slow.raw_error_m
    assert abs(slow.raw_lag_m) < 0.05
    assert slow.lag_m == pytest.approx(float(steady_lag(1.0, slow.gain)), rel=0.2)
    faster = sequence_filter.band(5.0, "diagonal", 20)
    assert faster.raw_width_m / faster.width_m == pytest.approx(1.06, abs=0.02)
    assert faster.error_m > faster.raw_error_m
    fast = sequence_filter.band(20.0, "full", 20)
    assert fast.raw_width_m / fast.width_m == pytest.approx(1.0, abs=0.01)
    assert fast.gain > 0.99
    assert all(np.isnan(fast.reference))


def test_without_process_noise_a_mover_is_all_gate() -> None:
    found = sequence_filter.band(1.0, "diagonal", 5, multiplier=0.0)
    assert found.gated > 0.9
    assert found.error_m == pytest.approx(found.raw_error_m, rel=1e-3)


def test_after_a_jump() -> None:
    found = {label: sequence_filter.jump(label, 10) for label in JUMPS}
    own, anew = found["gate, no reset (the source)"], found["gate, reset"]
    for jump in (own, anew):  # one epoch: what it was made of anew is no worse than a raw fix
        assert max(jump.told[0], jump.told[1]) < 1.6 * jump.raw_error_m
        assert jump.told[20] < 0.5 * jump.raw_error_m
    assert found["no gate"].told[0] > 25.0
    assert found["no gate"].told[20] < 1.0  # its own process noise brings it back
    assert found["Q = 0, no gate"].told[20] > 20.0
    assert found["Q = 0, gate, no reset"].told[20] == pytest.approx(own.raw_error_m, rel=0.4)
    assert found["Q = 0, gate, reset"].told[20] < 0.5 * own.raw_error_m


def test_a_spot_by_hand() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    assert radius(square) == pytest.approx(np.sqrt(2.0))
    assert together(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))
    points = np.tile(square, (2, 25, 1))
    shape = (2, 100, 1)
    result = FilteredSequence(
        times=np.arange(100.0),
        coloured_tdoa=np.zeros(shape),
        variance=np.zeros(shape),
        gain=np.zeros(shape),
        process_noise=np.zeros(shape),
        gated=np.zeros(shape, dtype=bool),
        measured=np.ones(shape, dtype=bool),
        multiplier=np.ones(shape[:2]),
        position=points / 4.0,
        covariance=np.zeros((2, 100, 2, 2)),
        raw_position=points,
        measurement=sequence_filter.Switches().stage(scenario.ring()).measurement,
    )
    spots = Spots.of(result, np.zeros((100, 2)))
    assert spots.shrink == pytest.approx(4.0)
    assert spots.gain == pytest.approx(4.0)
    assert together(spots.raw_error_m) == pytest.approx(2.0)


def test_arrivals_are_wrong_by_up_to_half_a_tick() -> None:
    stations, truth = scenario.ring(4), scenario.standing(np.array([10.0, 20.0]))
    found = scenario.measured(stations, truth, 30, np.random.default_rng(0))
    distance = np.linalg.norm(truth[0] - stations.positions, axis=-1)
    error = found - (distance[:-1] - distance[1:]) / scenario.SPEED
    assert np.max(np.abs(error)) < scenario.TICK_S
    assert np.var(error) == pytest.approx(scenario.TICK_S**2 / 6.0, rel=0.03)
    neighbours = np.corrcoef(error[..., 0].ravel(), error[..., 1].ravel())[0, 1]
    assert neighbours == pytest.approx(-0.5, abs=0.03)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Switches(rule="any"), "rule: expected one of"),  # type: ignore[arg-type]
        (lambda: Switches(test="any"), "test: expected one of"),  # type: ignore[arg-type]
        (lambda: Switches(reset_on_gate="x"), "reset_on_gate: expected"),  # type: ignore[arg-type]
        (lambda: sequence_filter.run("one"), "name: expected one of 'iso'"),
        (lambda: sequence_filter.run("iso", "own"), "weights: expected"),  # type: ignore[arg-type]
        (lambda: sequence_filter.run("iso", runs=1), "runs: expected a whole number"),
        (lambda: sequence_filter.compute(1), "runs: expected a whole number of at least 2, got 1"),
    ],
)
def test_bad_arguments(make: Any, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        make()
    assert str(raised.value).startswith(message)


def test_everything_together_counts_its_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in (
        (scenario, "EPOCHS", 12),
        (scenario, "LAST", 6),
        (moving, "EPOCHS", 12),
        (moving, "JUMP_EPOCH", 6),
        (moving, "JUMP_EPOCHS", 28),
        (geometries, "COUNT", 2),
    ):
        monkeypatch.setattr(module, name, value)
    told: list[str] = []
    result = sequence_filter.compute(2, 3, Switches(reset_on_gate=True), told.append)
    assert len(told) == sequence_filter.steps()
    tables = report.tables(result)
    assert len(tables["cases.csv"]["case"]) == 2 * len(CASES)
    assert len(tables["moving.csv"]["lag_m"]) == 6
    assert list(tables["jump.csv"]["filter"]) == list(JUMPS)
    summary = report.summary(result)
    assert summary["switches"] == {"rule": "iso", "test": "posterior", "reset_on_gate": True}
    assert summary["kappa"]["geometries"] == 2
    assert len(summary["claims"]) == 4
    json.dumps(summary)
