"""Timing, goals, and every measurement at its smallest, by NumPy."""

from __future__ import annotations

import itertools

import pytest

from imm_tdoa import bench
from imm_tdoa.bench import (
    batch,
    clock,
    cold,
    engines,
    fresh,
    machine,
    memory,
    scaling,
    small,
    streaming,
    studies,
)
from imm_tdoa.bench.clock import Timing
from imm_tdoa.bench.measured import Figure, Goal, Point


def quiet(_: str) -> None:
    """Listen to nothing."""


def test_a_timing_has_a_middle_and_divides_turn_by_turn():
    spent = Timing((3.0, 1.0, 2.0))
    assert (spent.median, spent.low, spent.high) == (2.0, 1.0, 3.0)
    assert (spent / 2.0).values == (1.5, 0.5, 1.0)
    assert (spent / Timing((1.0, 0.5, 4.0))).values == (3.0, 2.0, 0.5)
    assert (Timing((1.0,), 2) / Timing((1.0,), 3) / 2.0).again == 5


def test_tasks_are_timed_in_turns_after_one_call_each(monkeypatch):
    ticks = itertools.count()
    monkeypatch.setattr(clock, "perf_counter", lambda: float(next(ticks)))
    called = []
    tasks = {name: lambda name=name: called.append(name) for name in ("a", "b")}
    spent = clock.side_by_side(tasks, 2, {"b": 4})
    assert called == ["a", "b", "a", *"bbbb", "a", *"bbbb"]
    assert spent["a"].values == (1.0, 1.0)
    assert spent["b"].values == (0.25, 0.25)


@pytest.mark.parametrize(
    ("lost", "kept", "again"),
    [
        ((0.0,), 0.25, 0),
        ((0.005,), 0.25, 0),  # a fiftieth
        ((0.1, 0.0), 0.5, 1),
        ((0.1, 0.6, 0.15, 0.0), 0.75, 2),  # in vain for a second: the smallest share
    ],
)
def test_what_the_host_disturbed_is_timed_again(lost, kept, again, monkeypatch):
    """The k-th try takes k / 4 seconds, `lost[k - 1]` of which the host took away."""
    tries, clocks = itertools.count(1), {"stolen": 0.0}

    def seconds(task, times):
        k = next(tries)
        clocks["stolen"] += lost[k - 1]
        return 0.25 * k / times

    monkeypatch.setattr(clock, "seconds", seconds)
    monkeypatch.setattr(clock, "stolen", lambda: clocks["stolen"])
    with clock.patient(1.0):
        assert clock.undisturbed(lambda: None, 5) == (kept / 5, again)
    lost = (1.0,) * 5
    assert clock.undisturbed(lambda: None)[1] == 0  # nobody said to be patient


def test_steal_time_is_read_where_the_system_tells_it(monkeypatch, tmp_path):
    assert machine.stolen() >= 0.0
    told = tmp_path / "stat"
    monkeypatch.setattr(machine, "Path", lambda _: told)
    assert machine.stolen() == 0.0
    told.write_text("cpu  1 2 3 4 5 6 7 80 9 10\ncpu0 1 2 3 4 5 6 7 8 9 10\n")
    assert machine.stolen() == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("goal", "value", "verdict"),
    [
        (Goal(2.0), 2.0, "met"),
        (Goal(2.0), 2.1, "missed"),
        (Goal(2.0, "at least"), 2.0, "met"),
        (Goal(2.0, "at least"), 1.9, "missed"),
        (None, 1.0, ""),
    ],
)
def test_goals(goal, value, verdict):
    assert Figure("it", value, "s", value, value, 1, goal).verdict == verdict


def test_figures_and_points_have_their_units():
    spent = Timing((2e-3, 1e-3, 4e-3))
    figure = Figure.of("it", spent, "ms", 1e3)
    assert (figure.value, figure.low, figure.high, figure.repetitions) == (2.0, 1.0, 4.0, 3)
    point = Point.of("targets", 10, spent, 1000, "one thread")
    assert (point.cost, point.low, point.high) == pytest.approx((2.0, 1.0, 4.0))


def by_itself(size, tell, engine):
    """Measure a study; its size decides the engine."""
    return studies.measure(size, tell)


SMALLEST = [
    (
        batch.measure,
        batch.Size(targets=8, scans=4, peer_targets=1, repetitions=2, turns=2),
    ),
    (streaming.measure, streaming.Size(scans=20, repetitions=1)),
    (small.measure_source_a, small.Size(times=1, repetitions=1)),
    (small.measure_single_rows, small.Size(differences=20, repetitions=1)),
    (engines.measure, engines.Size(targets=4, scans=3, repetitions=2)),
    (
        scaling.measure,
        scaling.Size((2, 20), 3, (2, 4), 4, (1, 3), (3, 5), (4, 3), repetitions=2),
    ),
    (memory.measure, memory.Size(targets=100, scans=3)),
    (by_itself, studies.Size(runs=2, peer_runs=1, repetitions=1, commands=0)),
]


@pytest.mark.parametrize(("measure", "size"), SMALLEST)
def test_every_measurement_has_its_figures(measure, size, monkeypatch):
    monkeypatch.setattr(scaling, "WHOLE", 1)
    told = []
    found = measure(size, told.append, "numpy")
    assert told
    assert found.name in bench.MEASUREMENTS
    assert found.figures
    for figure in found.figures:
        assert figure.low <= figure.value <= figure.high
        # Departures and differences may well be nothing at all.
        may_vanish = figure.unit == "σ" or "difference" in figure.what or "departure" in figure.what
        assert figure.value > 0.0 or may_vanish
    for point in found.points:
        assert 0.0 < point.low <= point.cost <= point.high
    for figure in found.figures:
        if figure.goal in (batch.SAME, engines.SAME, studies.SAME):
            assert figure.verdict == "met"


def test_scaling_has_every_curve(monkeypatch):
    monkeypatch.setattr(scaling, "WHOLE", 1)
    monkeypatch.setattr(scaling, "processors", lambda: 3)
    size = SMALLEST[5][1]
    found = scaling.measure(size, quiet, "numpy")
    curves = {
        against: [p.x for p in found.points if p.against == against and "all" not in p.curve]
        for against in ("targets", "scans", "modes", "stations", "threads")
    }
    assert curves == {
        "targets": [2, 20], "scans": [2, 4], "modes": [1, 3], "stations": [3, 5],
        "threads": [1, 2, 3],
    }  # fmt: skip


def test_a_job_with_a_fixed_cost_is_linear_and_one_that_grows_faster_is_not():
    scans = (10, 50, 100, 400)
    linear = [Timing(((3e-3 + 2e-4 * T) / T,) * 2) for T in scans]
    assert scaling._departure("", scans, linear).value < 1e-12
    square = [Timing((1e-6 * T**2 / T,) * 2) for T in scans]
    assert scaling._departure("", scans, square).verdict == "missed"
    assert scaling._spread("", square, scaling.FLAT).value == pytest.approx(40.0)


def test_batches_beyond_the_memory_are_left_out(monkeypatch):
    monkeypatch.setattr(scaling, "memory", lambda: 10**6)
    assert scaling._fitting(scaling.Size(targets=(10, 100, 10**6))) == [10, 100]


def test_one_processor_is_compared_with_none(monkeypatch):
    monkeypatch.setattr(batch, "processors", lambda: 1)
    found = batch.measure(SMALLEST[0][1], quiet, "numpy")
    assert not any("threads" in figure.what for figure in found.figures)
    assert any("one processor" in note for note in found.notes)


def test_cold_start_imports_in_a_fresh_process():
    found = cold.measure(cold.Size(imports=1, samples=0, compilations=0, later=0), quiet)
    (figure,) = found.figures
    assert figure.what == "import imm_tdoa"
    assert 0.0 < figure.value < 60.0


def test_a_fresh_process_reports_or_says_what_failed():
    code = "from imm_tdoa.bench import fresh; import os; fresh.report(it=os.environ['IT'])"
    spent, found = fresh.python(["-c", code], {"IT": "was told"})
    assert spent > 0.0
    assert found == {"it": "was told"}
    with pytest.raises(ValueError, match=r"exit code 1\): ValueError: no good"):
        fresh.python(["-c", "raise ValueError('no good')"])


def test_a_fresh_process_takes_no_package_from_the_folder_it_is_started_in(tmp_path):
    (tmp_path / "imm_tdoa.py").write_text("raise RuntimeError('the wrong one')")
    assert fresh.python(["-c", "import imm_tdoa"], cwd=str(tmp_path))[1] == {}


def test_memory_is_known():
    assert 10 * 2**20 < memory.resident("VmRSS") <= memory.resident("VmHWM")


def test_run_refuses_what_it_does_not_know():
    with pytest.raises(ValueError, match=r"only: expected any of batch, .* got 'speed'"):
        next(bench.run(["speed"]))


def test_run_measures_what_is_asked_for(monkeypatch):
    made = []

    def measure(size, tell):
        made.append(size)
        tell("it")
        return bench.Measured("memory", "", ())

    monkeypatch.setattr(memory, "measure", measure)
    told = []
    (found,) = bench.run(["memory"], True, lambda done, what: told.append((done, what)))
    assert found.name == "memory"
    assert made == [memory.QUICK]
    assert told == [(0, "it")]
