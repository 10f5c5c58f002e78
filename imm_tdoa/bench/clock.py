"""How long things take: several times each, in turns, so that a slow moment hits all alike."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from time import perf_counter
from typing import Any

import attrs

from imm_tdoa.bench.machine import TICK, stolen

Task = Callable[[], Any]
DISTURBED = 0.02  # share of a repetition's time for which processors were taken away from it
PATIENCE = ContextVar("PATIENCE", default=0.0)  # s for which a repetition is made again


@attrs.frozen
class Timing:
    """Repeated measurements of one thing, in the order they were made.

    Attributes
    ----------
    values : tuple of float
        What was measured.
    again : int
        How many more were made and set aside, as the machine was taken away meanwhile.
    """

    values: tuple[float, ...]
    again: int = 0

    @property
    def median(self) -> float:
        """The middle one."""
        return statistics.median(self.values)

    @property
    def low(self) -> float:
        """The smallest."""
        return min(self.values)

    @property
    def high(self) -> float:
        """The largest."""
        return max(self.values)

    def __truediv__(self, other: Timing | float) -> Timing:
        """Divide by a number, or repetition by repetition by what was measured in turns with it."""
        if isinstance(other, Timing):
            pairs = zip(self.values, other.values, strict=True)
            return Timing(tuple(a / b for a, b in pairs), self.again + other.again)
        return Timing(tuple(a / other for a in self.values), self.again)


def seconds(task: Task, times: int = 1) -> float:
    """Return how long one call takes, s, the mean over so many on end.

    Python's garbage is collected before, not meanwhile, as `timeit` does: how long that takes
    depends on what else is in the process.
    """
    gc.collect()
    was_on = gc.isenabled()
    gc.disable()
    try:
        begun = perf_counter()
        for _ in range(times):
            task()
        return (perf_counter() - begun) / times
    finally:
        if was_on:
            gc.enable()


def undisturbed(task: Task, times: int = 1) -> tuple[float, int]:
    """Return how long one call takes, s, and how many measurements were set aside.

    A virtual machine's host may lend the processors to others meanwhile, which says nothing of
    the task. Such a measurement is made again while there is patience (`patient`); where all are
    disturbed, the least disturbed counts.
    """
    tries: list[tuple[float, float]] = []
    patience = PATIENCE.get()
    while not tries or patience > 0.0:
        before = stolen()
        each = seconds(task, times)
        lost = stolen() - before
        tries.append((lost / (each * times), each))
        if lost <= max(DISTURBED * each * times, 0.5 * TICK):
            break
        patience -= each * times
    return min(tries)[1], len(tries) - 1


@contextmanager
def patient(seconds: float) -> Iterator[None]:
    """Make what the host disturbs again for so long, s; 0: never."""
    token = PATIENCE.set(seconds)
    try:
        yield
    finally:
        PATIENCE.reset(token)


def side_by_side(
    tasks: Mapping[str, Task], repetitions: int, times: Mapping[str, int] | None = None
) -> dict[str, Timing]:
    """Time tasks in turns.

    Parameters
    ----------
    tasks : mapping of str to callable
        What is timed; each is called once beforehand, so that nothing is done for the first time.
    repetitions : int
        How often each is timed.
    times : mapping of str to int, optional
        How often a task is called on end each time; default once. For tasks much shorter than a
        millisecond.

    Returns
    -------
    dict of str to Timing
        Seconds per call.
    """
    for task in tasks.values():
        task()
    found: dict[str, list[tuple[float, int]]] = {name: [] for name in tasks}
    for _ in range(repetitions):
        for name, task in tasks.items():
            found[name].append(undisturbed(task, 1 if times is None else times.get(name, 1)))
    return {
        name: Timing(tuple(each for each, _ in made), sum(again for _, again in made))
        for name, made in found.items()
    }
