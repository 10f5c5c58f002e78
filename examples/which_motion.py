"""Which motion was it? Decide after the fact, and see how small a manoeuvre can be noticed."""

import numpy as np

from imm_tdoa import Stations, selection
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Static

# Four receivers, m; an emitter 500 km off that flies 1 km/s along y, 2 s between scans.
azimuth = np.radians([0.0, 120.0, 240.0])
slaves = 100e3 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
measurement = TDOA(Stations(np.concatenate([np.zeros((1, 2)), slaves])), tdoa_sigma=100e-9)
times = 2.0 * np.arange(21)
path = np.stack([np.full(21, 300e3), 400e3 + 1000.0 * times], axis=-1)
clean = measurement.predict(path, np.zeros_like(path), times) / measurement.speed
tdoa = clean + np.random.default_rng(1).normal(0.0, 100e-9, clean.shape)

# Every model alone, from one start. What is believed beforehand is part of the question.
found = selection.compare(
    [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
    measurement,
    times,
    tdoa,
    birth_std={"velocity": 5000.0, "acceleration": 500.0},
)
print(found)

# How large must an acceleration be to be noticed? Share of 40 runs that choose constant
# acceleration, for AIC, BIC and Bayes factors with three beliefs about it (m/s²).
print("\nshare of runs in which each criterion chooses constant acceleration")
print(selection.discrimination([0.0, 1.0, 2.0, 5.0], runs=40, seed=1))
