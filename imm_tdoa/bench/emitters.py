"""Many emitters in one tracker, named and unnamed: time per scan as their number grows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial, reduce
from math import log
from typing import NamedTuple

import attrs

from imm_tdoa import bankfile, simulate
from imm_tdoa.bank import Bank
from imm_tdoa.bench.clock import Timing, side_by_side
from imm_tdoa.bench.measured import Figure, Goal, Measured, Point
from imm_tdoa.engine import Engine
from imm_tdoa.recording import Recording, Scan, unlabelled
from imm_tdoa.tracking import Scene, Settings, Tracker, advance

NAMED, UNNAMED = "many-aircraft", "busy-sky"  # scenarios: 20 stations, and 8
LINEAR = Goal(1.2)  # exponent of the number of targets that still counts as close to linear
SEED = 1


@attrs.frozen
class Size:
    """How much is computed.

    Attributes
    ----------
    named : tuple of int
        Numbers of aircraft whose rows are labelled.
    unnamed : tuple of int
        Numbers of emitters that nobody told apart.
    warm : int
        Scans after which these are timed: all of them have come up by then.
    scans : int
        Scans that are timed.
    repetitions : int
        How often each is timed.
    """

    named: tuple[int, ...] = (10, 50, 100, 200)
    unnamed: tuple[int, ...] = (5, 10, 20, 50)
    warm: int = 36
    scans: int = 8
    repetitions: int = 3


FULL, QUICK = Size(), Size(named=(10, 50), unnamed=(5, 20), scans=4)


def measure(size: Size, tell: Callable[[str], None], engine: Engine = "auto") -> Measured:
    """Measure; `tell` is told what comes next. A tracker chooses its engine itself."""
    bank = bankfile.load("aircraft")
    tell("labelled aircraft: data")
    flights = {n: sky(NAMED, n) for n in size.named}
    tell("labelled aircraft")
    named = side_by_side(
        {str(n): partial(Tracker(bank).run, r) for n, r in flights.items()}, size.repetitions
    )
    scans = {n: len(set(_times(recording))) for n, recording in flights.items()}
    tell("unlabelled emitters: up to the scans that are timed")
    warm = {n: Warm.of(bank, sky(UNNAMED, n), size) for n in size.unnamed}
    tell("unlabelled emitters")
    unnamed = side_by_side({str(n): w.run for n, w in warm.items()}, size.repetitions)
    steps = {n: len(w.scans) for n, w in warm.items()}
    rows = [
        ("labelled", "labelled aircraft", named, scans),
        ("unlabelled", "emitters nobody told apart", unnamed, steps),
    ]
    figures, points = [], []
    for against, what, spent, count in rows:
        for n, k in count.items():
            points.append(Point.of(against, n, spent[str(n)], n * k, "one thread"))
            figures.append(Figure.of(f"{n} {what}", spent[str(n)] / k, "ms per scan", 1e3))
        goal = LINEAR if against == "labelled" else None
        if len(count) > 1:
            figures.append(_growth(f"{what}: exponent of growth", spent, list(count), goal))
    living = ", ".join(f"{len(w.scene.confirmations)} of {n}" for n, w in warm.items())
    notes = (
        "Labelled: a whole recording of 20 stations through Tracker.run, scans of 10 s; each "
        "aircraft's own messages, all aircraft in one batch.",
        f"Unlabelled: 8 stations, a false difference per pair and scan; scans {size.warm + 1} to "
        f"{size.warm + size.scans}, when all emitters are there. Tracks confirmed by then: "
        f"{living}.",
        "Exponent: of the number of targets, from the fewest to the most.",
    )
    return Measured("emitters", "one tracker, many emitters", tuple(figures), tuple(points), notes)


def sky(scenario: str, count: int) -> Recording:
    """Return a recording of the first `count` emitters of a shipped scenario's swarm."""
    whole = simulate.load(scenario)
    swarms = (attrs.evolve(whole.swarms[0], count=count),)
    here = {f"{whole.swarms[0].name}-{i}" for i in range(1, count + 1)}
    weak = {name: p for name, p in whole.detection.target.items() if name in here}
    detection = attrs.evolve(whole.detection, target=weak)
    return simulate.simulate(attrs.evolve(whole, swarms=swarms, detection=detection), SEED)


def _times(recording: Recording) -> list[float]:
    """Times of the scans, at each of which the truth has a row."""
    assert recording.truth is not None
    times: list[float] = recording.truth["time_s"].tolist()
    return times


class Warm(NamedTuple):
    """A tracker's whole state, and the scans that come next: the same work as often as wanted."""

    settings: Settings
    scene: Scene
    scans: tuple[Scan, ...]

    @classmethod
    def of(cls, bank: Bank, recording: Recording, size: Size) -> Warm:
        """Track through the first scans of a recording."""
        found = unlabelled(recording)
        tracker = Tracker(bank, found.measurement)
        tracker.run(found.scans[: size.warm])
        later = found.scans[size.warm : size.warm + size.scans]
        return cls(tracker.settings, tracker.scene, later)

    def run(self) -> Scene:
        """Take the scans in."""
        return reduce(
            lambda scene, scan: advance(self.settings, scene, scan), self.scans, self.scene
        )


def _growth(what: str, spent: Mapping[str, Timing], counts: list[int], goal: Goal | None) -> Figure:
    """Return by which power of the number of targets the time grows."""
    few, many = min(counts), max(counts)
    ratio = spent[str(many)] / spent[str(few)]
    values = tuple(log(r) / log(many / few) for r in ratio.values)
    power = attrs.evolve(ratio, values=values)
    return Figure.of(what, power, goal=goal)
