"""Everything that is computed again of Source C, at once."""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np

from imm_tdoa.reproduce.phase_difference.scenario import EMITTER, Scenario, Use
from imm_tdoa.reproduce.phase_difference.switches import Switches
from imm_tdoa.reproduce.phase_difference.tables import LEVELS, PAPER, Cell, Column, case
from imm_tdoa.reproduce.phase_difference.trials import Trial, trial

COUNTS = ((1, 55), (2, 28), (3, 18), (4, 14), (6, 9), (8, 7), (11, 5))  # hypotheses, every
SPEEDS_MPS = (100.0, 200.0, 300.0, 400.0)
OBSERVED_S = (10.0, 20.0, 30.0, 40.0)
SPEED_S = 20.0
SECTOR_DEG = (10.0, 20.0, 30.0, 40.0, 50.0)  # phase errors of the 40° sector
BOX_M = 10e3
EVERY_INTEGER = Scenario(count=None, every=1, lobe_deg=None, merging=False)


@attrs.frozen(eq=False)
class PhaseDifferences:
    """All that is computed again of Source C, and beyond it.

    Attributes
    ----------
    base : Trial
        The base case, phase and rate.
    lobes : Trial
        The same with a hypothesis for every ambiguity integer and no merging.
    trusting : Trial
        The base case with a filter that trusts its platform: no platform errors in R (§7.3).
    columns : tuple of Column
        Tables 1 and 2.
    counts : dict
        Fig. 4: trials by number of hypotheses.
    speeds : dict
        Fig. 6: trials by speed, m/s.
    sector : dict
        Fig. 7: trials by rows in use and phase error, °, rough bearings known to 10°.
    switches : Switches
        How the Gaussian sum is made.
    runs, seed : int
        Monte-Carlo runs of each case, seed of the errors.
    """

    base: Trial
    lobes: Trial
    trusting: Trial
    columns: tuple[Column, ...]
    counts: dict[int, Trial]
    speeds: dict[float, Trial]
    sector: dict[tuple[Use, float], Trial]
    switches: Switches
    runs: int
    seed: int

    def column(self, table: int, use: Use) -> Column:
        """Return one column of Tables 1 and 2."""
        return next(c for c in self.columns if (c.table, c.use) == (table, use))


def inside(trial: Trial, time: float) -> float:
    """Return the share of fixes within 10 km of the emitter east and north (Figs. 5 and 6)."""
    away = np.abs(trial.position[:, trial.index(time)] - EMITTER)
    return float(np.mean(np.all(away <= BOX_M, axis=-1)))


def compute(
    runs: int = 200,
    seed: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> PhaseDifferences:
    """Compute everything.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of each case, at least 2.
    seed : int
        Seed of the errors.
    switches : Switches, optional
        How the Gaussian sum is made; default what is right.
    tell : callable
        Is told what comes next, `steps` times.

    Raises
    ------
    ValueError
        Too few runs.
    """
    switches = Switches() if switches is None else switches

    def run(what: str, scenario: Scenario, using: Switches = switches) -> Trial:
        tell(what)
        return trial(scenario, runs, seed, using)

    trusting = attrs.evolve(switches, platform_noise=False)
    base = run("base case", Scenario())
    columns = []
    for (table, use), paper in PAPER.items():
        cells = []
        for level, time in zip(LEVELS[table], paper, strict=True):
            there = case(table, use, level)
            found = base if there == base.scenario else run(f"Table {table}, {use}", there)
            cells.append(Cell.of(level, time, found))
        columns.append(Column(table, use, tuple(cells)))
    return PhaseDifferences(
        base=base,
        lobes=run("a hypothesis for every integer", EVERY_INTEGER),
        trusting=run("platform errors not in R", Scenario(), trusting),
        columns=tuple(columns),
        counts={
            count: run("number of hypotheses", Scenario(count=count, every=step, lobe_deg=None))
            for count, step in COUNTS
        },
        speeds={v: run("speeds", Scenario(speed_mps=v)) for v in SPEEDS_MPS},
        sector={
            (use, level): run("40° sector", sector(use, level))
            for use in ("both", "phase")
            for level in SECTOR_DEG
        },
        switches=switches,
        runs=runs,
        seed=seed,
    )


def sector(use: Use, phase_deg: float) -> Scenario:
    """Return a case of the source's Fig. 7: a sector of 40°, twice the hypotheses to fill it."""
    return Scenario(use=use, phase_deg=phase_deg, bearing_deg=10.0, count=12)


def steps() -> int:
    """Return how often `compute` tells what comes next."""
    tables = sum(len(LEVELS[table]) for table, _ in PAPER)
    shared = sum(case(t, u, level) == Scenario() for t, u in PAPER for level in LEVELS[t])
    return 3 + tables - shared + len(COUNTS) + len(SPEEDS_MPS) + 2 * len(SECTOR_DEG)
