"""Targets shared out to threads: each is taken once, and what goes wrong is said."""

from __future__ import annotations

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imm_tdoa.kernel import sharing
from imm_tdoa.kernel.sharing import shares, work


@given(
    targets=st.integers(1, 100_000),
    scans=st.integers(1, 100_000),
    workers=st.integers(1, 9),
    lanes=st.sampled_from([1, 4, 16]),
)
def test_shares_are_whole_blocks_each_target_in_one(targets, scans, workers, lanes):
    parts = shares(targets, scans, workers, lanes)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == targets
    sizes = [part.stop - part.start for part in parts]
    assert all(size % lanes == 0 for size in sizes[:-1])
    assert 0 < min(sizes) <= max(sizes) < sharing.CHUNK + lanes


@given(
    targets=st.integers(1, 100_000),
    scans=st.integers(1, 500),
    workers=st.integers(2, 9),
    speed=st.floats(0.5, 1.0),
)
def test_workers_end_together_though_one_is_slow(targets, scans, workers, speed):
    """Whoever ends last takes one of the smallest shares last.

    A share of the rest R is R / 2w at most. Of a worker half as fast it takes R / w, and before
    that the w - 1 others cannot end what is left, R (1 - 1 / 2w).
    """
    clock = [0.0] * workers
    for part in shares(targets, scans, workers, 1):
        k = clock.index(min(clock))
        clock[k] += (part.stop - part.start) / (speed if k == 0 else 1.0)
    evenly = targets / (workers - 1 + speed)
    smallest = max(sharing.PIECE // scans, 1)
    assert max(clock) <= (evenly + smallest / speed) * (1.0 + 1e-9)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_each_is_done_once_and_what_went_wrong_is_returned(workers):
    done, lock = [], threading.Lock()

    def job(a):
        def do():
            with lock:
                done.append(a)
            return a if a % 3 == 0 else None

        return do

    assert sorted(work([*range(40)], job, workers)) == list(range(0, 40, 3))
    assert sorted(done) == list(range(40))


@pytest.mark.parametrize("workers", [1, 3])
def test_an_error_stops_the_others(workers):
    """Wherever it is raised; what has begun ends, the rest is left."""
    done, failed = [], threading.Event()

    def job(a):
        def do():
            if a == 2:
                failed.set()
                raise OSError("broken")
            if a > 2:
                assert failed.wait(10.0)
                time.sleep(1e-3)
            done.append(a)

        return do

    with pytest.raises(OSError, match="broken"):
        work([*range(1000)], job, workers)
    assert len(done) < 100
