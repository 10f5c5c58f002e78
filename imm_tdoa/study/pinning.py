"""One thread of BLAS for each chunk: chunks side by side already fill the cores."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_guard = threading.Lock()
_pins: list[threadpool_limits] = []
_inside = [0]


@contextmanager
def one_thread() -> Iterator[None]:
    """Pin BLAS to one thread while it lasts.

    The limit is the whole process's: of several threads the first sets it, and the last one
    that leaves lifts it.
    """
    with _guard:
        _inside[0] += 1
        if _inside[0] == 1:
            _pins.append(threadpool_limits(1))
    try:
        yield
    finally:
        with _guard:
            _inside[0] -= 1
            if _inside[0] == 0:
                _pins.pop().restore_original_limits()
