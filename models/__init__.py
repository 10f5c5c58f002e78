"""The plug-in shelf: motion and measurement models that ship with the library.

Arguments and results of their methods are those of `imm_tdoa.contract.MotionModel` and
`imm_tdoa.contract.MeasurementModel`; each model says what is its own.
"""

from imm_tdoa.models.measurement.fdoa import FDOA
from imm_tdoa.models.measurement.height import Height
from imm_tdoa.models.measurement.phase_difference import PhaseDifference
from imm_tdoa.models.measurement.position import Position
from imm_tdoa.models.measurement.range_rate import RangeRate
from imm_tdoa.models.measurement.stack import Stack
from imm_tdoa.models.measurement.tdoa import TDOA
from imm_tdoa.models.measurement.toa import TOA
from imm_tdoa.models.motion.constant_acceleration import ConstantAcceleration
from imm_tdoa.models.motion.constant_velocity import ConstantVelocity
from imm_tdoa.models.motion.coordinated_turn import CoordinatedTurn
from imm_tdoa.models.motion.singer import Singer
from imm_tdoa.models.motion.static import Static

__all__ = [
    "FDOA",
    "TDOA",
    "TOA",
    "ConstantAcceleration",
    "ConstantVelocity",
    "CoordinatedTurn",
    "Height",
    "PhaseDifference",
    "Position",
    "RangeRate",
    "Singer",
    "Stack",
    "Static",
]
