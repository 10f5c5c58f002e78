"""Source A: locating targets by the form of their motion (Li, Liu & Li 2024; ALGORITHMS §5).

>>> from imm_tdoa.reproduce import motion_form
>>> motion_form.table(runs=100).row("scenario-1").sample.mean_km

`table` is the paper's Table 1, `rivals` and `switching` put one IMM in the place of its choice
between filters, `sweep` tries every single filter, `compute` does it all.
"""

from imm_tdoa.reproduce.motion_form.interacting import Rivals, rivals
from imm_tdoa.reproduce.motion_form.scenario import MODELS, RECONSTRUCTION
from imm_tdoa.reproduce.motion_form.switches import Switches
from imm_tdoa.reproduce.motion_form.switching_target import Sweep, Switching, sweep, switching
from imm_tdoa.reproduce.motion_form.table_one import Row, Table, table
from imm_tdoa.reproduce.motion_form.whole import MotionForm, compute, steps

__all__ = [
    "MODELS",
    "RECONSTRUCTION",
    "MotionForm",
    "Rivals",
    "Row",
    "Sweep",
    "Switches",
    "Switching",
    "Table",
    "compute",
    "rivals",
    "steps",
    "sweep",
    "switching",
    "table",
]
