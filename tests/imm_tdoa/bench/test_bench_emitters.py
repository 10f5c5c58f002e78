"""The tracker's measurement: that it measures what it says."""

from __future__ import annotations

import numpy as np
import pytest

from imm_tdoa import bankfile
from imm_tdoa.bench import emitters
from imm_tdoa.bench.clock import Timing
from imm_tdoa.bench.emitters import Size, Warm

SMALL = Size(named=(2, 4), unnamed=(2, 3), warm=4, scans=2, repetitions=1)


def test_points_and_figures_say_the_same():
    told: list[str] = []
    found = emitters.measure(SMALL, told.append)
    assert told
    each = {f.what: f for f in found.figures}
    for against, word in (
        ("labelled", "labelled aircraft"),
        ("unlabelled", "emitters nobody told apart"),
    ):
        points = [p for p in found.points if p.against == against]
        assert [p.x for p in points] == list(
            SMALL.named if against == "labelled" else SMALL.unnamed
        )
        for p in points:
            per_scan = each[f"{p.x} {word}"]
            assert per_scan.unit == "ms per scan"
            assert p.cost * p.x == pytest.approx(1e3 * per_scan.value)
    assert each["labelled aircraft: exponent of growth"].goal == emitters.LINEAR


def test_growth_is_the_exponent():
    spent = {str(n): Timing((1e-3 * n**1.5,) * 2) for n in (5, 10, 40)}
    assert emitters._growth("", spent, [5, 10, 40], emitters.LINEAR).value == pytest.approx(1.5)
    assert emitters._growth("", spent, [5, 10, 40], emitters.LINEAR).verdict == "missed"


def test_the_same_work_every_time():
    warm = Warm.of(
        bankfile.load("aircraft"), emitters.sky(emitters.UNNAMED, 2), Size(warm=30, scans=2)
    )
    assert len(warm.scans) == 2
    assert len(warm.scene.confirmations) == 2
    first, again = warm.run(), warm.run()
    assert first.scans == warm.scene.scans + 2
    np.testing.assert_array_equal(first.state.mean, again.state.mean)


def test_fewer_emitters_are_the_first_of_many():
    few, many = emitters.sky(emitters.UNNAMED, 2), emitters.sky(emitters.UNNAMED, 4)
    assert set(few.truth["target"].tolist()) < set(many.truth["target"].tolist())
    assert few.stations.names == many.stations.names
