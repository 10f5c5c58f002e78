"""Speed of the tracker, by pytest-benchmark (extra ``bench``); no test asserts a time.

    pytest -n 0 tests/benchmarks/bench_tracker.py

`imm-tdoa bench --only emitters` is the larger programme, with the growth as a figure.
"""

from __future__ import annotations

import pytest

from imm_tdoa import Tracker, bankfile
from imm_tdoa.bench import emitters
from imm_tdoa.bench.emitters import Size, Warm


@pytest.mark.benchmark(group="labelled aircraft over 20 stations, a whole recording")
@pytest.mark.parametrize("count", [10, 50, 200])
def test_labelled(benchmark, count):
    recording = emitters.sky(emitters.NAMED, count)
    tracker = Tracker(bankfile.load("aircraft"))
    tracks = benchmark.pedantic(tracker.run, (recording,), rounds=3, warmup_rounds=1)
    assert len(tracks) == count


@pytest.mark.benchmark(group="emitters nobody told apart over 8 stations, eight scans")
@pytest.mark.parametrize("count", [5, 20, 50])
def test_unlabelled(benchmark, count):
    recording = emitters.sky(emitters.UNNAMED, count)
    warm = Warm.of(bankfile.load("aircraft"), recording, Size())
    scene = benchmark.pedantic(warm.run, rounds=3, warmup_rounds=1)
    assert len(scene.confirmations) >= 0.9 * count


@pytest.mark.benchmark(group="two emitters that cross, a whole recording")
@pytest.mark.parametrize("associator", ["nearest", "global", "jpda"])
def test_associators(benchmark, associator):
    from imm_tdoa.simulate import load, simulate

    recording = simulate(load("crossing"), seed=1)
    bank = bankfile.load("static-cv-ca")
    benchmark.pedantic(
        lambda: Tracker(bank, associator=associator).run(recording), rounds=3, warmup_rounds=1
    )
