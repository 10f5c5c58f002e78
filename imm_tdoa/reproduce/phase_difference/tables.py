"""The source's Tables 1 and 2: how soon the error is below 5 % of the distance."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.reproduce.phase_difference.scenario import Scenario, Use
from imm_tdoa.reproduce.phase_difference.trials import Trial

SHARE = 0.05


@attrs.frozen
class Cell:
    """One entry of a table.

    Attributes
    ----------
    level : float
        Phase error, °, or rate error, °/s.
    paper_s : float or None
        The paper's time; None where it says the location fails.
    rms_s, mean_s : float
        Our times, by the runs' root mean square and mean error; NaN where they are not below 5 %
        within the time flown.
    rms_error_s, mean_error_s : float
        Their standard errors.
    end : float
        Root mean square error at the end, share of the distance.
    """

    level: float
    paper_s: float | None
    rms_s: float
    rms_error_s: float
    mean_s: float
    mean_error_s: float
    end: float

    @classmethod
    def of(cls, level: float, paper_s: float | None, trial: Trial) -> Cell:
        """Return what a trial says."""
        return cls(
            level,
            paper_s,
            *trial.time_below(SHARE, "rms"),
            *trial.time_below(SHARE, "mean"),
            float(trial.over_time()[-1]),
        )


@attrs.frozen
class Column:
    """One method in one of the tables.

    Attributes
    ----------
    table : int
        1: over the phase error, 2: over its rate's.
    use : "both", "phase" or "rate"
        What the filter takes in.
    cells : tuple of Cell
        Its times.
    """

    table: int
    use: Use
    cells: tuple[Cell, ...]

    @property
    def levels(self) -> list[float]:
        """Errors that the table is over."""
        return [cell.level for cell in self.cells]


LEVELS: dict[int, tuple[float, ...]] = {1: (10.0, 20.0, 30.0, 40.0), 2: (0.3, 0.5, 1.0, 2.0)}
PAPER: dict[tuple[int, Use], tuple[float | None, ...]] = {
    (1, "phase"): (25.0, 30.0, 33.0, 34.0),
    (1, "both"): (18.0, 18.0, 20.0, 21.0),
    (2, "rate"): (20.0, 23.0, None, None),
    (2, "both"): (16.0, 18.0, 25.0, None),
}


def case(table: int, use: Use, level: float) -> Scenario:
    """Return the case behind one entry."""
    if table == 1:
        return Scenario(use=use, phase_deg=level)
    return Scenario(use=use, rate_deg=level)


def seconds(value: float | None) -> str:
    """Return a time as a table shows it, ``-`` where there is none."""
    return "-" if value is None or np.isnan(value) else f"{value:.1f}"
