"""Targets that stand: which reading of the source lets the spot shrink (ALGORITHMS §6.2)."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.reproduce.sequence_filter import scenario
from imm_tdoa.reproduce.sequence_filter.scenario import INSIDE, OUTSIDE
from imm_tdoa.reproduce.sequence_filter.spots import Spots
from imm_tdoa.reproduce.sequence_filter.switches import Switches
from imm_tdoa.sequence_filter import FilteredSequence
from imm_tdoa.sequence_filter.loop_gain import WEIGHTS, Weights

FIRST = "iso"  # the case that the source's claim stands and falls with


@attrs.frozen(eq=False)
class Case:
    """A ring of stations, a place, a rule.

    Attributes
    ----------
    name, label : str
        Short name, and what tables say.
    stations : int
        How many on the ring.
    place : (2,)
        Where the target stands, m.
    arguments : dict
        What the filter is made with.
    reference : tuple of float
        Loop gain (NaN: none given), shrink and gain in error that another program found, its
        fix weighing the differences as if they were independent (ALGORITHMS §6.2).
    """

    name: str
    label: str
    stations: int
    place: Array
    arguments: dict[str, Any]
    reference: tuple[float, float, float]


CASES = (
    Case(FIRST, "6 stations, inside, iso", 6, INSIDE, {"rule": "iso"}, (0.61, 26.5, 13.4)),
    Case(
        "iso-quarter",
        "6 stations, inside, iso x 0.25",
        6,
        INSIDE,
        {"rule": "iso", "multiplier": 0.25},
        (0.15, 53.6, 15.0),
    ),
    Case("proj", "6 stations, inside, proj", 6, INSIDE, {"rule": "proj"}, (np.nan, 46.1, 14.9)),
    Case("bound", "6 stations, inside, bound", 6, INSIDE, {"rule": "bound"}, (2.4, 1.6, 1.6)),
    Case("four", "4 stations, inside, iso", 4, INSIDE, {"rule": "iso"}, (0.68, 22.8, 11.5)),
    Case("outside", "6 stations, outside, iso", 6, OUTSIDE, {"rule": "iso"}, (7.3, 1.3, 1.25)),
    Case(
        "outside-auto",
        "6 stations, outside, iso, auto",
        6,
        OUTSIDE,
        {"rule": "iso", "multiplier": "auto"},
        (0.5, 49.6, 15.0),
    ),
    Case(
        "no-noise",
        "6 stations, inside, Q = 0",
        6,
        INSIDE,
        {"rule": "iso", "multiplier": 0.0},
        (0.0, 58.6, 15.9),
    ),
)


@attrs.frozen(eq=False)
class Outcome:
    """What a case came to, and its fixes (T, 2) of the first run, m.

    Attributes
    ----------
    case : Case
        The case.
    weights : "full" or "diagonal"
        How the fix weighs the differences.
    kappa : float
        Loop gain.
    spots : Spots
        What came of the spot.
    gated : float
        Share of the differences that the gate refused.
    raw_fixes, fixes : (T, 2)
        Of the first run's measured and filtered differences, m.
    """

    case: Case
    weights: Weights
    kappa: float
    spots: Spots
    gated: float
    raw_fixes: Array
    fixes: Array


def check_runs(runs: int) -> int:
    """Return `runs`, or refuse what is not a whole number of at least 2."""
    if isinstance(runs, bool) or not isinstance(runs, int) or runs < 2:
        raise ValueError(f"runs: expected a whole number of at least 2, got {runs!r}")
    return runs


def run(
    name: str,
    weights: Weights = "full",
    runs: int = 50,
    seed: int = 1,
    switches: Switches | None = None,
) -> Outcome:
    """Filter one of `CASES`.

    Parameters
    ----------
    name : str
        Which.
    weights : "full" or "diagonal"
        How the fix weighs the differences. Both see the same noise.
    runs, seed : int
        How many runs, from which seed.

    Raises
    ------
    ValueError
        An unknown name or weights, too few runs.
    """
    _validate.one_of("name", name, [case.name for case in CASES])
    _validate.one_of("weights", weights, WEIGHTS)
    case = next(case for case in CASES if case.name == name)
    switches = Switches() if switches is None else switches
    stations, truth = scenario.ring(case.stations), scenario.standing(case.place)
    generator = np.random.default_rng([seed, case.stations])
    values = scenario.measured(stations, truth, check_runs(runs), generator)
    stage = switches.stage(stations, weights, **case.arguments)
    result: FilteredSequence = stage.run(np.arange(float(len(truth))), values)
    return Outcome(
        case=case,
        weights=weights,
        kappa=float(stage.kappa(case.place)),
        spots=Spots.of(result, truth),
        gated=float(np.mean(result.gated)),
        raw_fixes=result.raw_position[0],
        fixes=result.position[0],
    )
