"""Stations, times and matrices that the tests of the posterior bound share."""

from __future__ import annotations

import numpy as np

SQUARE = np.array([(0, 0), (9e3, 1e3), (8e3, 9e3), (-1e3, 7e3)], float)
T3 = np.arange(3.0)


def spd(rng, n, scale=1.0):
    """A random covariance (n, n)."""
    A = rng.normal(size=(n, n))
    return scale * (A @ A.T / n + 0.1 * np.eye(n))
