"""How well an emitter can be located and tracked at best: Cramér-Rao bounds, dilution of precision.

>>> from imm_tdoa import bounds
>>> bounds.crlb(stations, position, toa_sigma=70e-9)  # one epoch
>>> bounds.pcrlb(bank, measurement, times, trajectory).position_rms  # a whole track
"""

from imm_tdoa.bounds.fix import crlb, fisher_information, gdop
from imm_tdoa.bounds.mean import mean_error
from imm_tdoa.bounds.posterior import PosteriorBound, pcrlb
from imm_tdoa.bounds.trusting import trusting_mse

__all__ = [
    "PosteriorBound",
    "crlb",
    "fisher_information",
    "gdop",
    "mean_error",
    "pcrlb",
    "trusting_mse",
]
