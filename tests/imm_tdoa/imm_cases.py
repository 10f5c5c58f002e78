"""Stations, a bank of three motions and noisy differences that the tests of the IMM share."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from imm_oracles import C, pair_covariance, range_differences

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Static

SIGMA = 10e-9  # s per arrival, 3 m
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
STATIONS = Stations(CORNERS)
BIRTH = {"velocity": 30.0, "acceleration": 3.0}
KINDS = [Static(psd=0.5), ConstantVelocity(psd=2.0), ConstantAcceleration(psd=0.3)]
seeds = st.integers(0, 2**32 - 1)


def truth_values(rng, times, pairs, p=(700.0, 900.0), v=(12.0, -9.0)):
    """Noisy differences (T, m), s, of an emitter that moves straight on."""
    path = np.array(p) + np.array(v) * np.asarray(times)[:, None]
    clean = np.stack([range_differences(q, CORNERS, pairs)[0] for q in path])
    R = pair_covariance([(C * SIGMA) ** 2] * len(CORNERS), pairs)
    return (clean + rng.multivariate_normal(np.zeros(len(R)), R, size=len(path))) / C


def imm_2d(**more):
    """The three motions on differences to the first station."""
    return IMM(Bank(KINDS, birth_std=BIRTH), TDOA(STATIONS, toa_sigma=SIGMA), **more)


def bank_of(orders=(0, 1, 2), **more):
    """A bank of motions of these orders: 0 stands, 1 moves straight on, 2 accelerates."""
    return Bank([KINDS[o] for o in orders], birth_std=BIRTH, **{"mean_sojourn": 20.0, **more})


def arrivals(rng, times, p=(700.0, 900.0), v=(12.0, -9.0), stations=CORNERS, sigma=SIGMA):
    """Noisy arrival times (T, S), s, each scan with an unknown emission time."""
    path = np.array(p) + np.array(v) * np.asarray(times)[:, None]
    clean = np.linalg.norm(path[:, None] - stations, axis=-1) / C
    return clean + sigma * rng.normal(size=clean.shape)


def irregular(rng, count):
    """Times, s, some of them repeated."""
    return np.cumsum(rng.choice([0.0, 0.4, 1.0, 3.0], size=count))


def differences(toa, pairs):
    """Arrivals of each pair's station minus its reference."""
    return toa[..., pairs[:, 0]] - toa[..., pairs[:, 1]]
