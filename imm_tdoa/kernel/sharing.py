"""Many targets shared out to threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from imm_tdoa._processors import processors

CHUNK = 4096  # targets whose arrays are made at a time, at most
PIECE = 32_768  # steps of a target that a worker takes at a time: a few milliseconds

Failure = TypeVar("Failure")


def workers(targets: int, scans: int) -> int:
    """Return how many workers so much is worth."""
    return min(processors(), 1 + targets * scans // PIECE)


def share(targets: int, scans: int, workers: int, lanes: int) -> int:
    """Return how many targets a worker takes at a time, in whole blocks.

    Several shares for each, equally many and equally large, so that all end together.
    """
    most = CHUNK if workers == 1 else min(CHUNK, max(PIECE // scans, 1))
    rounds = -(-targets // (workers * most))
    size = -(-targets // (workers * rounds))
    return -(-size // lanes) * lanes


def work(
    begins: list[int], job: Callable[[int], Callable[[], Failure | None]], workers: int
) -> list[Failure]:
    """Do the jobs that begin there; return what went wrong.

    Each worker, this thread among them, takes the next when it has done one.
    """
    todo: deque[int] = deque(begins)
    failures: list[Failure] = []

    def one_by_one() -> None:
        try:
            while (a := _next(todo)) is not None:
                failure = job(a)()
                if failure is not None:
                    failures.append(failure)
        except BaseException:
            todo.clear()
            raise

    helpers = min(workers, len(begins)) - 1
    if helpers == 0:
        one_by_one()
    else:
        with ThreadPoolExecutor(helpers) as pool:
            others = [pool.submit(one_by_one) for _ in range(helpers)]
            one_by_one()
        for other in others:
            other.result()
    return failures


def _next(todo: deque[int]) -> int | None:
    """Take the next, unless another worker has just taken the last."""
    try:
        return todo.popleft()
    except IndexError:
        return None
