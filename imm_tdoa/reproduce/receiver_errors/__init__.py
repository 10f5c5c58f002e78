"""Source D: locating by TDOA and FDOA with uncertain receivers (CN112444776A; ALGORITHMS §8).

>>> from imm_tdoa.reproduce import receiver_errors
>>> receiver_errors.table(runs=400).points[0].samples["joint"].position_rmse_m

`table` compares five estimators with the Cramér-Rao bound, `sweep` does over noise levels,
`shared_coordinate` shows where the squared second step fails, `compute` does it all.
"""

from imm_tdoa.reproduce.receiver_errors.coordinate import Coordinate, shared_coordinate
from imm_tdoa.reproduce.receiver_errors.levels import Curve, sweep
from imm_tdoa.reproduce.receiver_errors.points import Point, Table, table
from imm_tdoa.reproduce.receiver_errors.sample import ESTIMATORS, Sample
from imm_tdoa.reproduce.receiver_errors.scenario import RECONSTRUCTION, SOURCES, Case
from imm_tdoa.reproduce.receiver_errors.whole import ReceiverErrors, compute, steps

__all__ = [
    "ESTIMATORS",
    "RECONSTRUCTION",
    "SOURCES",
    "Case",
    "Coordinate",
    "Curve",
    "Point",
    "ReceiverErrors",
    "Sample",
    "Table",
    "compute",
    "shared_coordinate",
    "steps",
    "sweep",
    "table",
]
