"""From one epoch's measurements to a position: fixes (ALGORITHMS §3)."""

from imm_tdoa.locate.chan_ho import chan_ho
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.gauss_newton import fix_scans, gauss_newton
from imm_tdoa.locate.joint import joint, joint_scans
from imm_tdoa.locate.joint_fix import JointFix
from imm_tdoa.locate.two_step import two_step, two_step_scans

__all__ = [
    "Fix",
    "JointFix",
    "chan_ho",
    "fix_scans",
    "gauss_newton",
    "joint",
    "joint_scans",
    "two_step",
    "two_step_scans",
]
