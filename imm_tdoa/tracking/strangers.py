"""How dense emitters are that no track has: what a track's claim to a message competes with."""

from __future__ import annotations

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.tracking.clutter import REGION, extent
from imm_tdoa.tracking.memory import Memory

TO_SIGMA = 1.4826  # a normal distribution's standard deviation over its median deviation
LEAST = 1.0  # m; nothing is known to be closer together
FEW = 4  # fixes beyond the dimensions that say how emitters scatter


def log_density(measurement: MeasurementModel, memory: Memory, time: float) -> float:
    """Return the log of how many emitters without a track there are at most, per m^d.

    Each of the last fixes that no track took may be of another one. They are as dense as in the
    middle of where these fixes scatter; where these are too few to say, of the stations.
    """
    d, places = measurement.dims, memory.strangers
    count = max(len(places), 1)
    spread = np.full(d, extent(measurement, time) / REGION)
    if len(places) >= d + FEW:
        away: Array = np.abs(places - np.median(places, axis=0))
        spread = np.maximum(TO_SIGMA * np.median(away, axis=0), LEAST)
    return float(np.log(count) - 0.5 * d * gaussian.LOG_2PI - np.sum(np.log(spread)))
