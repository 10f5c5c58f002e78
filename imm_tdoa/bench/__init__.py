"""How fast it is: figures with their goals, beside filterpy on the same data (`imm-tdoa bench`).

What bounds the compiled recursion, by sampled time (``perf record -e cpu-clock``, addresses of
the machine code named from the kept object file; rocketlake, 16 lanes, three modes, three
differences in 2-D, one thread; shares of the time inside the kernel, about):

========================================  =============  ==========  =====
what                                      keep="final"   keep="all"  gate
========================================  =============  ==========  =====
innovations: ranges, S, its factor        31 %           19 %        20 %
gain and covariance update                24 %           10 %        14 %
prediction                                14 %           9 %         10 %
mixing                                    13 %           7 %         9 %
gathering and storing scans and records   11 %           21 %        7 %
exponentials and logarithms               6 %            4 %         4 %
fresh memory handed out by the system     1 %            30 %        -
robust: judging sources                   -              -           30 %
robust: trust in the track                -              -           4 %
========================================  =============  ==========  =====

So it is bound by arithmetic, not by memory: short loops over few rows and components, whose sums
wait for each other, and the roots and divisions of the geometry. With ``keep="all"`` the records
dominate what is left: 85 numbers a target and scan, written once to memory that the system must
clear first. Gross errors are judged in all lanes at once (that column is of ``keep="final"``, and
the judging has exponentials and logarithms of its own); only what is left out is taken out lane by
lane. For Student's t two thirds of the time are the rounds in which the weights are found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module

from imm_tdoa.bench import clock
from imm_tdoa.bench.measured import Figure, Goal, Measured, Point

PATIENCE = 1.0  # s for which a repetition that the host disturbed is made again
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
        Smaller jobs, fewer repetitions, and what the host disturbs stays.
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
        with clock.patient(0.0 if quick else PATIENCE):
            found = getattr(part, function)(size, lambda what, done=done: tell(done, what))
        yield found
