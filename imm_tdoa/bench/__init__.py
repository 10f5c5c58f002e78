"""How fast it is: figures with their goals, beside filterpy on the same data (`imm-tdoa bench`).

What bounds the compiled recursion, by sampled time (``perf record -e cpu-clock``, addresses of
the machine code named from the kept object file; rocketlake, 16 lanes, three modes, three
differences in 2-D, one thread; shares of the time inside the kernel, about):

========================================  =============  ==========  =====
what                                      keep="final"   keep="all"  gate
========================================  =============  ==========  =====
innovations: ranges, S, its factor        31 %           19 %        6 %
gain and covariance update                24 %           10 %        2 %
prediction                                14 %           9 %         1 %
mixing                                    13 %           7 %         1 %
gathering and storing scans and records   11 %           21 %        3 %
exponentials and logarithms               6 %            4 %         16 %
fresh memory handed out by the system     1 %            30 %        -
robust: judging sources, lane by lane     -              -           45 %
allocating, counting references           -              -           26 %
========================================  =============  ==========  =====

So it is bound by arithmetic, not by memory: short loops over few rows and components, whose sums
wait for each other, and the roots and divisions of the geometry. With ``keep="all"`` the records
dominate what is left: 85 numbers a target and scan, written once to memory that the system must
clear first, which is why a second thread gains little there. What is judged against gross errors
goes lane by lane, in small arrays that are made anew for each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module

from imm_tdoa.bench.measured import Figure, Goal, Measured, Point

MEASUREMENTS: dict[str, tuple[str, str]] = {  # name: module and function
    "batch": ("batch", "measure"),
    "streaming": ("streaming", "measure"),
    "source-a": ("small", "measure_source_a"),
    "single-rows": ("small", "measure_single_rows"),
    "engines": ("engines", "measure"),
    "scaling": ("scaling", "measure"),
    "emitters": ("emitters", "measure"),
    "study": ("studies", "measure"),
    "memory": ("memory", "measure"),
    "cold-start": ("cold", "measure"),
}

__all__ = ["MEASUREMENTS", "Figure", "Goal", "Measured", "Point", "run"]


def run(
    only: Sequence[str] = (),
    quick: bool = False,
    tell: Callable[[int, str], None] = lambda done, what: None,
) -> Iterator[Measured]:
    """Measure one thing after the other.

    Parameters
    ----------
    only : sequence of str
        Which of `MEASUREMENTS`; default all.
    quick : bool
        Smaller jobs, fewer repetitions.
    tell : callable
        Is told how many measurements are done and what comes next.

    Raises
    ------
    ValueError
        An unknown name.
    """
    unknown = [name for name in only if name not in MEASUREMENTS]
    if unknown:
        raise ValueError(f"only: expected any of {', '.join(MEASUREMENTS)}, got {unknown[0]!r}")
    chosen = [name for name in MEASUREMENTS if not only or name in only]
    for done, name in enumerate(chosen):
        module, function = MEASUREMENTS[name]
        part = import_module(f"imm_tdoa.bench.{module}")
        size = part.QUICK if quick else part.FULL
        yield getattr(part, function)(size, lambda what, done=done: tell(done, what))
