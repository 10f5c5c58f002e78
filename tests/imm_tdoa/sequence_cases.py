"""Stations, courses and differences that the tests of the sequence filter share."""

from __future__ import annotations

import numpy as np

from imm_tdoa import Stations
from imm_tdoa.contract import Array

C = 299_792_458.0
SIGMA = 3e-9
PLACE = np.array([350.0, -350.0])
FIELD = np.array([[2e3, 100.0], [900.0, 1.8e3], [-1.1e3, 1.6e3], [-1.9e3, -200.0], [300.0, -2e3]])


def ring(count: int = 6) -> Stations:
    """Stations on a circle of 2 km."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return Stations(2000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def differences(
    positions: Array, truth: Array, seed: int, runs: tuple[int, ...] = (), sigma: float = SIGMA
) -> Array:
    """Adjacent differences (*runs, T, S - 1), s; positions of stations (S, d) or (T, S, d)."""
    distance = np.linalg.norm(truth[:, None] - positions, axis=-1)
    noise = np.random.default_rng(seed).normal(0.0, sigma, (*runs, *distance.shape))
    arrival = distance / C + noise
    return arrival[..., :-1] - arrival[..., 1:]


def course(T: int, speed: float = 4.0) -> Array:
    """Positions (T, 2), a second apart, of an emitter that moves straight on from PLACE."""
    return PLACE + speed * np.arange(float(T))[:, None] * np.array([0.6, 0.8])
