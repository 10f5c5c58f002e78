"""Whose message is whose: against every pair of target and message tried one by one."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from tracker_cases import BANK, PLACES, RING, SPEED, SPEEDS

from imm_tdoa import IMM
from imm_tdoa.models import TOA
from imm_tdoa.tracking import Unlabelled
from imm_tdoa.tracking.batches import select, whole
from imm_tdoa.tracking.messages import choose

ARRIVALS = TOA(RING, sigma=70e-9)
GATE, REGION = 0.9999, 25.0


def scene(seed, update):
    """Three targets, one of them hardly known; messages of two of them and of a stranger."""
    rng = np.random.default_rng(seed)
    imm = IMM(BANK, ARRIVALS, update=update)
    std = np.array([50.0, 200.0, 500.0])[:, None, None]
    off = rng.normal(size=(3, 2)) * std[:, 0]
    mean = np.concatenate([PLACES[:3] + off, SPEEDS[:3], np.zeros((3, 2))], axis=1)
    cov = np.zeros((3, 6, 6))
    cov[:, :2, :2] = std**2 * np.eye(2)
    cov[:, 2:4, 2:4], cov[:, 4:, 4:] = 100.0 * np.eye(2), np.eye(2)
    state = whole(imm.start(np.zeros(3), mean, cov))
    sent = PLACES[[2, 0, 3]]
    values = ARRIVALS.predict(sent, np.zeros_like(sent), 0.0) + rng.normal(size=(3, 7)) * 20.0
    values += rng.uniform(0.0, 1e4, (3, 1))  # nobody knows when they were sent
    emission = np.repeat(np.arange(3), 7)
    return imm, state, Unlabelled(values.ravel(), np.tile(np.arange(7), 3), emission=emission)


@pytest.mark.parametrize("update", ["ekf", "iekf"])
@pytest.mark.parametrize("seed", range(3))
def test_the_likeliest_pairs_within_the_gate(seed, update):
    """Iterating leaves out pairs that the gate rejects: with them the answer is the same."""
    imm, state, scan = scene(seed, update)
    got = choose(imm, ARRIVALS, state, scan, GATE, REGION, exclusive=True)
    z = scan.values.reshape(3, 7) / SPEED
    after = [[imm.step(select(state, [n]), 0.0, z[[e]]) for e in range(3)] for n in range(3)]
    gate = chi2.ppf(GATE, 6)  # seven arrivals, one unknown emission time
    cost = np.array(
        [[-2.0 * a.log_likelihood[0] if a.taken.nis[0] <= gate else np.inf for a in row]
         for row in after]
    )  # fmt: skip
    best = None
    for order in permutations([0, 1, 2, -1, -1, -1], 3):
        pairs = [(n, e) for n, e in enumerate(order) if e >= 0]
        total = sum(cost[n, e] for n, e in pairs)
        key = (-len(pairs), total)
        if np.isfinite(total) and (best is None or key < best[0]):
            best = key, order
    expected = np.full((3, 7), -1)
    for n, e in enumerate(best[1]):
        if e >= 0:
            expected[n] = 7 * e + np.arange(7)
            assert_allclose(got.state.mean[n], after[n][e].mean[0], rtol=1e-9, atol=1e-6)
        else:
            assert_array_equal(got.state.mean[n], state.mean[n])
    assert_array_equal(got.members, expected)
    assert_array_equal(expected[:, 0], [7, -1, 0])


def test_without_messages_nothing_changes():
    imm, state, scan = scene(0, "iekf")
    nothing = Unlabelled(scan.values * np.nan, scan.row, emission=scan.emission)
    got = choose(imm, ARRIVALS, state, nothing, GATE, REGION, exclusive=True)
    assert np.all(got.members == -1)
    assert_array_equal(got.state.mean, state.mean)
