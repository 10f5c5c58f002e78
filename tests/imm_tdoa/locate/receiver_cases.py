"""Receivers that are not where they say: what the tests of `two_step` and `joint` share."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import Stations
from imm_tdoa.contract import Array

POSITIONS = np.array(
    [
        (300, 100, 150),
        (400, 150, 100),
        (300, 500, 200),
        (350, 200, 100),
        (-100, -100, -100),
        (200, -300, -200),
    ],
    float,
)
VELOCITIES = np.array(
    [(30, -20, 20), (-30, 10, 20), (10, -20, 10), (10, 20, 30), (-20, 10, 10), (20, -10, 10)],
    float,
)
NEAR, MID, FAR = (285.0, 325.0, 275.0), (600.0, 650.0, 550.0), (2000.0, 2500.0, 3000.0)
VELOCITY = np.array([-20.0, 15.0, 40.0])
RELATIVE = np.array([1.0, 2.0, 10.0, 40.0, 20.0, 3.0])


def model(q: Array, v: Array, s: Array, vs: Array) -> tuple[Array, Array]:
    """Ranges and range rates (..., S), written out."""
    away = q[..., None, :] - s
    r = np.sqrt(np.sum(away**2, axis=-1))
    return r, np.sum(away * (v[..., None, :] - vs), axis=-1) / r


def against_first(rows: Array) -> Array:
    return rows[..., 1:] - rows[..., :1]


def sigmas(variance: float) -> dict[str, float]:
    return {
        "toa_sigma": float(np.sqrt(variance / 2)),
        "range_rate_sigma": float(np.sqrt(0.05 * variance)),
        "speed": 1.0,
    }


def declared(receiver_variance: float, velocity_variance: float = 0.0) -> Stations:
    """The receivers where they truly are, with the errors they declare."""
    Q = receiver_variance * RELATIVE[:, None, None] * np.eye(3)
    Qv = velocity_variance * np.broadcast_to(np.eye(3), (6, 3, 3))
    return Stations(
        POSITIONS,
        velocities=VELOCITIES,
        position_covariance=Q,
        velocity_covariance=Qv if velocity_variance else None,
    )


def experiments(
    source: Any,
    variance: float,
    receiver_variance: float,
    runs: int,
    seed: int,
    velocity_variance: float = 0.0,
) -> tuple[Stations, Array, Array, dict[str, Any]]:
    """Stations as declared in run k at time k, range and rate differences, and arguments."""
    rng = np.random.default_rng(seed)
    shape = (runs, 6, 3)
    s = POSITIONS + np.sqrt(receiver_variance * RELATIVE)[:, None] * rng.normal(size=shape)
    vs = VELOCITIES + np.sqrt(velocity_variance) * rng.normal(size=shape)
    stations = Stations(
        s,
        velocities=vs,
        times=np.arange(float(runs)),
        position_covariance=declared(receiver_variance).position_covariance,
        velocity_covariance=declared(1.0, velocity_variance).velocity_covariance,
    )
    r, rate = model(np.asarray(source, float), VELOCITY, POSITIONS, VELOCITIES)
    sigma = sigmas(variance)
    r = r + sigma["toa_sigma"] * rng.normal(size=(runs, 6))
    rate = rate + sigma["range_rate_sigma"] * rng.normal(size=(runs, 6))
    arguments = {"range_rate": against_first(rate), "time": stations.times, **sigma}
    return stations, against_first(r), against_first(rate), arguments


def rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))
