"""A fix that corrects the receivers too."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa._brief import brief
from imm_tdoa.contract import Array
from imm_tdoa.locate.fix import Fix


@attrs.frozen(eq=False, kw_only=True)
class JointFix(Fix):
    """A `Fix` with the receivers as the measurements see them.

    Attributes
    ----------
    stations : (..., S, d)
        Receiver positions, m: the declared ones, corrected where they were heard and have a
        declared error.
    station_velocities : (..., S, d)
        Likewise their velocities, m/s.
    station_covariance : (..., S, d, d)
        Covariance of each corrected position, m²; they are correlated between stations.
    """

    stations: Array = attrs.field(factory=lambda: np.zeros((0, 0)))
    station_velocities: Array = attrs.field(factory=lambda: np.zeros((0, 0)))
    station_covariance: Array = attrs.field(factory=lambda: np.zeros((0, 0, 0)))

    __repr__ = brief
