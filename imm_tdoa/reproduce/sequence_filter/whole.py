"""Everything that is computed again of Source B, at once."""

from __future__ import annotations

from collections.abc import Callable

import attrs

from imm_tdoa.reproduce.sequence_filter import cases, geometries, moving
from imm_tdoa.reproduce.sequence_filter.cases import CASES, Outcome
from imm_tdoa.reproduce.sequence_filter.geometries import Geometry
from imm_tdoa.reproduce.sequence_filter.moving import Band, Jump, Turn
from imm_tdoa.reproduce.sequence_filter.switches import Switches
from imm_tdoa.sequence_filter.loop_gain import Weights

BOTH: tuple[Weights, Weights] = ("diagonal", "full")


@attrs.frozen(eq=False)
class Reproduction:
    """All that is computed again of Source B, and beyond it.

    Attributes
    ----------
    outcomes : tuple of Outcome
        Targets that stand: every case, the fix weighing the differences either way.
    bands : tuple of Band
        Targets that move.
    turn : Turn
        One run of a slow turn.
    jumps : tuple of Jump
        A target that is suddenly elsewhere.
    geometries : tuple of Geometry
        Random geometries.
    """

    outcomes: tuple[Outcome, ...]
    bands: tuple[Band, ...]
    turn: Turn
    jumps: tuple[Jump, ...]
    geometries: tuple[Geometry, ...]
    switches: Switches
    runs: int
    seed: int

    def outcome(self, name: str, weights: Weights = "full") -> Outcome:
        """Return the outcome of a case."""
        return next(o for o in self.outcomes if o.case.name == name and o.weights == weights)

    @property
    def right(self) -> int:
        """In how many geometries the loop gain told right."""
        return sum(geometry.right for geometry in self.geometries)


def compute(
    runs: int = 50,
    seed: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Reproduction:
    """Compute everything.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs, at least 2; random geometries see at most 20 of them.
    seed : int
        Seed of the noise and of the geometries.
    switches : Switches, optional
        Readings of the source.
    tell : callable
        Is told what comes next, `steps` times.

    Raises
    ------
    ValueError
        Too few runs.
    """
    switches = Switches() if switches is None else switches
    cases.check_runs(runs)
    outcomes = []
    for case in CASES:
        tell(case.label)
        outcomes += [cases.run(case.name, w, runs, seed, switches) for w in BOTH]
    bands = []
    for speed in moving.SPEEDS_MPS:
        tell(f"{speed:g} m/s")
        bands += [moving.band(speed, w, runs, seed, switches) for w in BOTH]
    tell("a jump")
    jumps = [moving.jump(label, runs, seed, switches) for label in moving.JUMPS]
    found = []
    for number in range(geometries.COUNT):
        tell(f"random geometry {number + 1}")
        found.append(geometries.try_one(number, min(runs, 20), seed, switches))
    return Reproduction(
        outcomes=tuple(outcomes),
        bands=tuple(bands),
        turn=moving.turn(seed, switches),
        jumps=tuple(jumps),
        geometries=tuple(found),
        switches=switches,
        runs=runs,
        seed=seed,
    )


def steps() -> int:
    """Return how often `compute` tells what comes next."""
    return len(CASES) + len(moving.SPEEDS_MPS) + 1 + geometries.COUNT
