"""A ring of stations with ticking clocks, targets inside and outside (ALGORITHMS §6.2, §6.3)."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.stations import Stations

TICK_S = 10e-9
SPEED = 299792458.0
RADIUS_M = 2000.0
EPOCHS = 300
LAST = 100  # epochs that are judged, when the filters have settled
INSIDE = np.array([350.0, -350.0])  # m
OUTSIDE = np.array([2500.0, 700.0])  # 2.6 km from the centre
RECONSTRUCTION = (
    "The source gives no figures, only the claims; its formula for the process noise is lost. "
    "Geometry and noise here: stations on a ring of radius 2 km, clocks that tick every 10 ns, "
    "one epoch a second, 300 epochs of which the last 100 are judged."
)


def ring(count: int = 6) -> Stations:
    """Return stations evenly around a ring of 2 km."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return Stations(RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def measured(stations: Stations, truth: Array, runs: int, generator: np.random.Generator) -> Array:
    """Return time differences (runs, T, S - 1) of adjacent stations for positions (T, d), s.

    Each arrival is wrong by up to half a tick, uniformly.
    """
    distance = np.linalg.norm(truth[:, None] - stations.positions, axis=-1)
    error = generator.uniform(-0.5, 0.5, (runs, *distance.shape)) * TICK_S
    arrival = distance / SPEED + error
    result: Array = arrival[..., :-1] - arrival[..., 1:]
    return result


def standing(place: Array) -> Array:
    """Return positions (EPOCHS, d) of a target that stands at `place` (d,)."""
    return np.broadcast_to(place, (EPOCHS, len(place)))
