"""Gaussian sums: one motion model and many starting hypotheses, for what one Gaussian cannot say.

A first measurement that leaves many places open (an ambiguous phase, one hyperbola) becomes many
Gaussians; each is a Kalman filter, and what is measured later decides between them.

>>> start = lobes(interferometer, times[0], values[0], bearing=0.9, bearing_sigma=0.09)
>>> gs = GaussianSum(Static(psd=0.0), interferometer)
>>> track = gs.run(times[1:], values[1:], gs.start(times[0], *start))
"""

from imm_tdoa.gaussian_sum.filter import GaussianSum
from imm_tdoa.gaussian_sum.hyperbolas import hyperbola
from imm_tdoa.gaussian_sum.hypotheses import Hypotheses
from imm_tdoa.gaussian_sum.interferometers import Interferometer, lobes
from imm_tdoa.gaussian_sum.state import SumState
from imm_tdoa.gaussian_sum.track import SumTrack, settled

__all__ = [
    "GaussianSum",
    "Hypotheses",
    "Interferometer",
    "SumState",
    "SumTrack",
    "hyperbola",
    "lobes",
    "settled",
]
