"""How long things take: several times each, in turns, so that a slow moment hits all alike."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

import attrs

Task = Callable[[], Any]


@attrs.frozen
class Timing:
    """Repeated measurements of one thing, in the order they were made."""

    values: tuple[float, ...]

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
            return Timing(tuple(a / b for a, b in pairs))
        return Timing(tuple(a / other for a in self.values))


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
    found: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(repetitions):
        for name, task in tasks.items():
            found[name].append(seconds(task, 1 if times is None else times.get(name, 1)))
    return {name: Timing(tuple(values)) for name, values in found.items()}
