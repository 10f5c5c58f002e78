"""Geometries, noise and oracles that the tests of `locate` share."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from imm_tdoa import Stations
from imm_tdoa.contract import Array

C = 299_792_458.0
RING = np.array([(0, 0), (1000, 0), (0, 1000), (1100, 1200), (500, -400), (-700, 300)], float)
GROUND = np.array(
    [(0, 0, 0), (9e3, 0, 50), (0, 8e3, 120), (1e4, 1.1e4, 10), (5e3, -4e3, 300), (-6e3, 2e3, 80)]
)

SENSORS = np.array(
    [(0, 0), (-5, 8), (4, 6), (-2, 4), (7, 3), (-7, 5), (2, 5), (-4, 2), (3, 3), (1, 8)], float
)
LINE = np.array([(-(i - 1) if i % 2 else i, 0) for i in range(1, 11)], float)
SOURCE = np.array([8.0, 22.0])

HO_XU = np.array(
    [(300, 100, 150), (400, 150, 100), (300, 500, 200), (350, 200, 100), (-100, -100, -100)], float
)
HO_XU_VELOCITY = np.array(
    [(30, -20, 20), (-30, 10, 20), (10, -20, 10), (10, 20, 30), (-20, 10, 10)], float
)
HO_XU_SOURCE_VELOCITY = np.array([-20.0, 15.0, 40.0])
HO_XU_FAR, HO_XU_NEAR = np.array([2000.0, 2500.0, 3000.0]), np.array([600.0, 650.0, 550.0])


def distances(p: Any, s: Any) -> Array:
    """Distance of each p (..., d) from each station (S, d), as a reader would write it."""
    p, s = np.asarray(p, float), np.asarray(s, float)
    return np.sqrt(np.sum((p[..., None, :] - s) ** 2, axis=-1))


def differences(arrivals: Array, reference: int = 0) -> Array:
    """Arrivals (..., S) minus the reference's, the reference itself left out."""
    return np.delete(arrivals - arrivals[..., reference : reference + 1], reference, axis=-1)


def pairs_against(S: int, reference: int) -> Array:
    """Pairs (S - 1, 2) [station, reference]."""
    return np.array([[i, reference] for i in range(S) if i != reference])


def noisy_differences(
    rng: np.random.Generator, p: Array, s: Array, sigma: float, runs: int
) -> Array:
    """Range differences (runs, S - 1) against station 0, arrival noise `sigma` m."""
    return differences(distances(p, s) + rng.normal(0.0, sigma, (runs, len(s))))


def mahalanobis(error: Array, covariance: Array) -> Array:
    """Squared error (..., n) in units of `covariance`."""
    return np.einsum("...i,...i->...", error, np.linalg.solve(covariance, error[..., None])[..., 0])


def information(p: Array, s: Array, sigma: float) -> Array:
    """Information (d, d) of arrival times at p, emission time unknown (§1.1, reference-free)."""
    u = (p - s) / distances(p, s)[:, None]
    u = u - u.mean(axis=0)
    return u.T @ u / sigma**2


def undamped(p: Array, s: Array, z: Array, steps: int) -> Array:
    """Plain Gauss-Newton (Foy 1976) for differences z (N, S - 1) against station 0: positions."""
    Q = np.linalg.inv(np.eye(len(s) - 1) + 1.0)
    x = np.broadcast_to(p, (len(z), len(p))).copy()
    for _ in range(steps):
        r = distances(x, s)
        u = (x[:, None] - s) / r[..., None]
        H, e = u[:, 1:] - u[:, :1], z - differences(r)
        A = np.einsum("nki,kl,nlj->nij", H, Q, H)
        x += np.linalg.solve(A, np.einsum("nki,kl,nl->ni", H, Q, e)[..., None])[..., 0]
    return x


@st.composite
def geometries(
    draw: st.DrawFn, dims: int, stations: int, reach: float = 3.0
) -> tuple[Stations, Array]:
    """Stations in a box of 2 km and an emitter up to `reach` km from its middle, well placed.

    Well placed: the arrival times determine it, with a dilution of precision up to 300, and no
    two stations stand within 50 m.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    while True:
        s = rng.uniform(-1000.0, 1000.0, (stations, dims))
        direction = rng.normal(size=dims)
        p = rng.uniform(0.0, 1000.0 * reach) * direction / np.linalg.norm(direction)
        apart = distances(s, s) + 1e9 * np.eye(stations)
        w = np.linalg.eigvalsh(information(p, s, 1.0))
        if apart.min() > 50.0 and distances(p, s).min() > 10.0 and w[0] > 1e-5:
            return Stations(s), p
