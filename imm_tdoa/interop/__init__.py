"""Bridges to other people's programs: filterpy's Kalman filters become a bank, and back.

>>> from imm_tdoa import interop
>>> bank, measurement, state = interop.from_filterpy(filters, components=("x", "vx"), dt=0.5)
>>> filters, mode_probability, transition = interop.to_filterpy(bank, measurement, dt=0.5)
"""

from imm_tdoa.interop.fixed_step import FixedStep
from imm_tdoa.interop.from_kalman import from_filterpy
from imm_tdoa.interop.linear import LinearMeasurement
from imm_tdoa.interop.to_kalman import KalmanBank, to_filterpy

__all__ = ["FixedStep", "KalmanBank", "LinearMeasurement", "from_filterpy", "to_filterpy"]
