"""Many targets shared out to threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from imm_tdoa._processors import processors

CHUNK = 4096  # targets whose arrays are made at a time, at most
PIECE = 4096  # steps of a target that a worker takes at a time, at least: about a millisecond
WORTH = 8 * PIECE  # steps of a target that are worth another worker

Failure = TypeVar("Failure")


def workers(targets: int, scans: int) -> int:
    """Return how many workers so much is worth."""
    return min(processors(), 1 + targets * scans // WORTH)


def shares(targets: int, scans: int, workers: int, lanes: int) -> list[slice]:
    """Return the targets of each share, in whole blocks, as workers take one after the other.

    Guided self-scheduling (Polychronopoulos & Kuck 1987): each is half of what a worker would get
    of the rest, so that they become smaller and all workers end together, also where one is slowed
    down meanwhile.
    """
    parts, begin = [], 0
    while begin < targets:
        size = CHUNK if workers == 1 else max((targets - begin) // (2 * workers), PIECE // scans, 1)
        end = min(begin + -(-min(size, CHUNK) // lanes) * lanes, targets)
        parts.append(slice(begin, end))
        begin = end
    return parts


def work(
    parts: list[slice], job: Callable[[slice], Callable[[], Failure | None]], workers: int
) -> list[Failure]:
    """Do the job of each share; return what went wrong.

    Each worker, this thread among them, takes the next when it has done one.
    """
    todo = deque(parts)
    failures: list[Failure] = []

    def one_by_one() -> None:
        try:
            while (part := _next(todo)) is not None:
                failure = job(part)()
                if failure is not None:
                    failures.append(failure)
        except BaseException:
            todo.clear()
            raise

    helpers = min(workers, len(parts)) - 1
    if helpers == 0:
        one_by_one()
    else:
        with ThreadPoolExecutor(helpers) as pool:
            others = [pool.submit(one_by_one) for _ in range(helpers)]
            one_by_one()
        for other in others:
            other.result()
    return failures


def _next(todo: deque[slice]) -> slice | None:
    """Take the next, unless another worker has just taken the last."""
    try:
        return todo.popleft()
    except IndexError:
        return None
