"""Source B: Kalman filtering of the TDOA sequence (Xu & Hua 2020, a patent; ALGORITHMS §6).

>>> from imm_tdoa.reproduce import sequence_filter
>>> sequence_filter.run("iso").spots.shrink

`run` filters targets that stand, `band` those that move, `jump` one that is suddenly elsewhere,
`try_one` one in a random geometry; `compute` does it all.
"""

from imm_tdoa.reproduce.sequence_filter.cases import CASES, Case, Outcome, run
from imm_tdoa.reproduce.sequence_filter.geometries import Geometry, try_one
from imm_tdoa.reproduce.sequence_filter.moving import JUMPS, Band, Jump, Turn, band, jump, turn
from imm_tdoa.reproduce.sequence_filter.scenario import RECONSTRUCTION
from imm_tdoa.reproduce.sequence_filter.spots import Spots
from imm_tdoa.reproduce.sequence_filter.switches import Switches
from imm_tdoa.reproduce.sequence_filter.whole import Reproduction, compute, steps

__all__ = [
    "CASES",
    "JUMPS",
    "RECONSTRUCTION",
    "Band",
    "Case",
    "Geometry",
    "Jump",
    "Outcome",
    "Reproduction",
    "Spots",
    "Switches",
    "Turn",
    "band",
    "compute",
    "jump",
    "run",
    "steps",
    "try_one",
    "turn",
]
