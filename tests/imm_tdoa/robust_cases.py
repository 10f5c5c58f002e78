"""Stations, and arrivals with gross errors, that the tests of the robust rules share."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from imm_tdoa import Stations
from imm_tdoa.observation import observe, with_sources

C = 299_792_458.0
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
STATIONS = Stations(CORNERS)
P0 = np.array([700.0, 900.0])
SIGMA = 1e-8
HERE, NONE = np.arange(2), np.arange(0)
SPREAD = [25.0 * np.eye(2)]
seeds = st.integers(0, 2**32 - 1)


def spd(rng, n):
    """A random covariance (n, n)."""
    A = rng.normal(size=(n, n + 2))
    return A @ A.T


def against(measurement, values, place=(702.0, 899.0)):
    """A scan as the robust rules see it from one mode that expects the emitter at `place`."""
    x, z = np.array(place), np.asarray(values)
    seen = observe(measurement, [x], [HERE], [NONE], 0.0, z)
    return with_sources(seen, measurement, x, HERE, NONE, 0.0, z)


def arrivals(**gross):
    """Noise-free arrival times (5,), s, of an emitter at P0; s2=1e-6 makes station 2's late."""
    z = np.linalg.norm(P0 - CORNERS, axis=1) / C
    for station, error in gross.items():
        z[int(station[1:])] += error
    return z
