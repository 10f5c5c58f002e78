"""Targets shared out to threads: each is taken once, and what goes wrong is said."""

from __future__ import annotations

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imm_tdoa.kernel import sharing
from imm_tdoa.kernel.sharing import share, work


@given(
    targets=st.integers(1, 100_000),
    scans=st.integers(1, 100_000),
    workers=st.integers(1, 9),
    lanes=st.sampled_from([1, 4, 16]),
)
def test_shares_are_whole_blocks_and_bounded(targets, scans, workers, lanes):
    size = share(targets, scans, workers, lanes)
    assert size % lanes == 0
    assert 0 < size < sharing.CHUNK + lanes
    if workers > 1:
        assert size * scans < sharing.PIECE + lanes * scans


@given(rounds=st.integers(1, 20), workers=st.integers(1, 9), scans=st.integers(1, 500))
def test_equal_shares_are_as_many_for_each_worker(rounds, workers, scans):
    targets = 1024 * workers * rounds
    size = share(targets, scans, workers, 1)
    most = sharing.CHUNK if workers == 1 else min(sharing.CHUNK, max(sharing.PIECE // scans, 1))
    shares = -(-targets // size)
    assert shares <= workers * -(-targets // (workers * most))


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
