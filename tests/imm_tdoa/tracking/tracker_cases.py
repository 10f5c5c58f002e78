"""Scenes for the tracker: stations, targets, and scans of rows that nobody labelled."""

from __future__ import annotations

import numpy as np

from imm_tdoa import Bank, Stations
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity
from imm_tdoa.tracking import Scan

SPEED = 299792458.0
ANGLE = 2.0 * np.pi * np.arange(6) / 6
RING = Stations(
    np.concatenate([[[0.0, 0.0]], 40e3 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=-1)])
)
MEASUREMENT = TDOA(RING, toa_sigma=70e-9)
BANK = Bank(
    [ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)],
    mean_sojourn=60.0,
    birth_std={"velocity": 150.0, "acceleration": 3.0},
)
PLACES = np.array([[8e3, 5e3], [-9e3, 12e3], [15e3, -11e3], [-14e3, -9e3]])
SPEEDS = np.array([[120.0, 40.0], [-80.0, 90.0], [60.0, -100.0], [100.0, 100.0]])
STEP = 2.0


def path(k, targets=slice(None)):
    """Positions (N, 2) at scan k of targets on straight lines."""
    return PLACES[targets] + SPEEDS[targets] * (STEP * k)


def scan(
    rng,
    k,
    targets=slice(None),
    *,
    detection=0.95,
    false=1,
    measurement=MEASUREMENT,
    positions=None,
    time=None,
):
    """One scan: who is there is heard by each pair with `detection`; `false` values per pair."""
    p = path(k, targets) if positions is None else positions
    who = np.arange(len(PLACES))[targets] if positions is None else np.arange(len(p))
    h = measurement.predict(p, np.zeros_like(p), 0.0)
    R = measurement.noise_covariance(np.zeros(2), np.zeros(2), 0.0)
    z = h + rng.normal(size=h.shape) @ np.linalg.cholesky(R).T
    s = measurement.stations.positions
    reach = np.linalg.norm(s[measurement.pairs[:, 0]] - s[measurement.pairs[:, 1]], axis=-1)
    values, row, target = [], [], []
    for i in range(measurement.size):
        heard = np.flatnonzero(rng.random(len(p)) < detection)
        values += [*z[heard, i], *rng.uniform(-reach[i], reach[i], false)]
        row += [i] * (len(heard) + false)
        target += [*(str(who[n]) for n in heard), *[""] * false]
    mixed = rng.permutation(len(values))
    return Scan(
        STEP * k if time is None else time,
        np.array(values)[mixed] / SPEED,
        np.array(row, dtype=np.int64)[mixed],
        target=np.array(target, dtype=str)[mixed],
    )
