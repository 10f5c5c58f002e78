"""BLAS is pinned while chunks are computed, by however many threads, and let go afterwards."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from threadpoolctl import threadpool_info, threadpool_limits

from imm_tdoa.study.pinning import one_thread


def threads() -> set[int]:
    """How many threads each pool may use."""
    return {pool["num_threads"] for pool in threadpool_info()}


def test_one_thread_while_a_chunk_is_computed() -> None:
    with threadpool_limits(2):
        with one_thread():
            assert threads() == {1}
        assert threads() == {2}


def test_a_chunk_that_ends_does_not_unpin_the_others() -> None:
    def chunk() -> set[int]:
        with one_thread():
            return threads()

    before = threads()
    with ThreadPoolExecutor(2) as pool, one_thread():
        assert [pool.submit(chunk).result() for _ in range(4)] == [{1}] * 4
        assert threads() == {1}
    assert threads() == before
