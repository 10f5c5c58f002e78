"""Source A's geometry (§5.3) and its three motion forms, many runs at once."""

from __future__ import annotations

import numpy as np

from imm_tdoa import Stations
from imm_tdoa.contract import Array
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Static

BIRTH = {"velocity": 5000.0, "acceleration": 500.0}
TIMES = 2.0 * np.arange(21)
FORMS = ("static", "constant-velocity", "constant-acceleration")
START = np.array([[300e3, 400e3], [350e3, 450e3], [250e3, 350e3]])
SPEED = np.array([[0.0, 1000.0], [0.0, -1000.0], [0.0, 1000.0]])
PUSH = np.array([[-100.0, 0.0], [100.0, 0.0], [100.0, 0.0]])


def models() -> list[Static | ConstantVelocity | ConstantAcceleration]:
    """The three candidates, without process noise."""
    return [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)]


def star() -> TDOA:
    """A master and three slaves at 100 km; 100 ns per difference, independent."""
    azimuth = np.radians([0.0, 120.0, 240.0])
    slaves = 100e3 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    return TDOA(Stations(np.concatenate([np.zeros((1, 2)), slaves])), tdoa_sigma=100e-9)


def path(form: int, times: Array = TIMES) -> Array:
    """Positions (3, T, 2) of the three targets, m."""
    t = times[:, None]
    p = START[:, None] + (form > 0) * SPEED[:, None] * t
    return p + (form > 1) * 0.5 * PUSH[:, None] * t**2


def measured(measurement: TDOA, p: Array, rng: np.random.Generator, runs: int = 100) -> Array:
    """TDOAs (runs, ..., T, m) of emitters at `p` (..., T, 2), s."""
    clean = measurement.predict(p, np.zeros_like(p), 0.0) / measurement.speed
    return clean + rng.normal(0.0, 100e-9, (runs, *clean.shape))
