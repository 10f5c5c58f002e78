"""Everything that is computed again of Source A, at once."""

from __future__ import annotations

from collections.abc import Callable

import attrs

from imm_tdoa.reproduce.motion_form.interacting import RULES, Rivals, rivals
from imm_tdoa.reproduce.motion_form.scenario import MODELS, MOTIONS
from imm_tdoa.reproduce.motion_form.switches import Switches
from imm_tdoa.reproduce.motion_form.switching_target import (
    Sweep,
    Switching,
    levels,
    sweep,
    switching,
)
from imm_tdoa.reproduce.motion_form.table_one import Table, table


@attrs.frozen(eq=False)
class MotionForm:
    """All that is computed again of Source A, and beyond it.

    Attributes
    ----------
    table : Table
        Its Table 1.
    rivals : tuple of Rivals
        One IMM beside the single filters, by motion of the targets.
    switching : Switching
        Targets that change their motion.
    sweep : Sweep
        The single filters on those.
    """

    table: Table
    rivals: tuple[Rivals, ...]
    switching: Switching
    sweep: Sweep

    @property
    def switches(self) -> Switches:
        """What was taken as printed."""
        return self.table.switches


def compute(
    runs: int = 100,
    seed: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> MotionForm:
    """Compute everything.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of the three targets, at least 2.
    seed : int
        Seed of the noise.
    switches : Switches, optional
        What to take as printed; default nothing.
    tell : callable
        Is told what comes next, `steps` times.

    Raises
    ------
    ValueError
        Too few runs.
    """
    tell("Table 1")
    first = table(runs, seed, switches)
    return MotionForm(
        table=first,
        rivals=rivals(runs, seed, switches, tell),
        switching=switching(runs, seed, switches, tell),
        sweep=sweep(runs, seed, switches, tell),
    )


def steps() -> int:
    """Return how often `compute` tells what comes next."""
    return 1 + len(MOTIONS) + len(RULES) + sum(len(levels(model)) for model in MODELS)
