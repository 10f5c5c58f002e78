"""Source C: one observer, one ambiguous interferometer, a Gaussian sum (ALGORITHMS §7).

>>> from imm_tdoa.reproduce import phase_difference
>>> phase_difference.trial(phase_difference.Scenario(), runs=200).time_below(0.05)

`trial` runs one case, `compute` all of the source's tables and figures.
"""

from imm_tdoa.reproduce.phase_difference.scenario import Scenario
from imm_tdoa.reproduce.phase_difference.switches import Switches
from imm_tdoa.reproduce.phase_difference.tables import Cell, Column
from imm_tdoa.reproduce.phase_difference.trials import Trial, trial
from imm_tdoa.reproduce.phase_difference.whole import PhaseDifferences, compute, steps

__all__ = [
    "Cell",
    "Column",
    "PhaseDifferences",
    "Scenario",
    "Switches",
    "Trial",
    "compute",
    "steps",
    "trial",
]
