"""keep="final" holds no array of all targets at all times."""

from __future__ import annotations

import numpy as np

from imm_tdoa import IMM, Bank
from imm_tdoa.models import ConstantVelocity, Position

TARGETS, SCANS = 100_000, 40


def test_the_final_state_needs_no_room_for_the_others():
    """Besides the values, which are one array for all, two records a target."""
    import tracemalloc

    imm = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(10.0, dims=1))
    rng = np.random.default_rng(0)
    at = rng.uniform(-1e3, 1e3, (TARGETS, 1))
    start = imm.start(0.0, at, np.eye(1))
    times, values = np.arange(1.0, SCANS + 1.0), np.zeros((1, SCANS, 1))
    tracemalloc.start()
    try:
        track = imm.run(times, values, start=start, engine="compiled", keep="final", threads=2)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert track.mean.shape == (TARGETS, 1, 2)
    record = imm.plan.record.size
    every = 8 * TARGETS * SCANS
    assert peak < 3 * 8 * TARGETS * record
    assert peak < every * record / 10
    some = np.arange(0, TARGETS, 10_007)
    part = imm.start(0.0, at[some], np.eye(1))
    want = imm.run(times, values, start=part, engine="numpy", keep="final")
    np.testing.assert_allclose(track.mean[some], want.mean, rtol=1e-9)
