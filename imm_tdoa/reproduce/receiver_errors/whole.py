"""Everything that is computed of Source D, at once."""

from __future__ import annotations

from collections.abc import Callable

import attrs

from imm_tdoa.locate.linear_steps import Weights
from imm_tdoa.reproduce.receiver_errors.coordinate import Coordinate, shared_coordinate
from imm_tdoa.reproduce.receiver_errors.levels import DRAWN, LEVELS, Curve, sweep
from imm_tdoa.reproduce.receiver_errors.points import REFERENCE, Table, table

SWEPT = 200  # most runs of a level of the curves
SHARED = 500  # most runs of a distance


@attrs.frozen(eq=False)
class ReceiverErrors:
    """All that is computed of Source D.

    Attributes
    ----------
    table : Table
        The points where an independent program's figures are known.
    curves : tuple of Curve
        Over noise levels.
    coordinate : Coordinate
        Where the emitter shares a coordinate with the reference receiver.
    """

    table: Table
    curves: tuple[Curve, ...]
    coordinate: Coordinate


def compute(
    runs: int = 2000,
    seed: int = 1,
    weights: Weights = "both",
    tell: Callable[[str], None] = lambda _: None,
) -> ReceiverErrors:
    """Compute everything.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of each point of the table, at least 2; the curves take up to 200, the
        shared coordinate up to 500.
    seed : int
        Seed of the noise.
    weights : "both", "first" or "none"
        Which steps' weights know of the receiver errors.
    tell : callable
        Is told what comes next, `steps` times.

    Raises
    ------
    ValueError
        Too few runs.
    """
    first = table(runs, seed, weights, tell)
    curves = sweep(min(runs, SWEPT), seed, weights, tell)
    tell("a shared coordinate")
    return ReceiverErrors(first, curves, shared_coordinate(min(runs, SHARED), seed))


def steps() -> int:
    """Return how often `compute` tells what comes next."""
    return len(REFERENCE) + len(DRAWN) * len(LEVELS) + 1
