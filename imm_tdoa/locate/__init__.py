"""From one epoch's measurements to a position: fixes (ALGORITHMS §3)."""

from imm_tdoa.locate.chan_ho import chan_ho
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.gauss_newton import fix_scans, gauss_newton

__all__ = ["Fix", "chan_ho", "fix_scans", "gauss_newton"]
