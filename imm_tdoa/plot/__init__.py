"""Pictures of tracks, errors, geometry and scenes, drawn without pyplot's global state."""

from imm_tdoa.plot.agreement import calibration
from imm_tdoa.plot.claims import claims
from imm_tdoa.plot.differences import differences, has_differences
from imm_tdoa.plot.dilution import gdop
from imm_tdoa.plot.errors import error
from imm_tdoa.plot.evidence import evidence
from imm_tdoa.plot.lives import lives
from imm_tdoa.plot.scenes import scene
from imm_tdoa.plot.sets import gospa
from imm_tdoa.plot.tracks import track

__all__ = [
    "calibration",
    "claims",
    "differences",
    "error",
    "evidence",
    "gdop",
    "gospa",
    "has_differences",
    "lives",
    "scene",
    "track",
]
