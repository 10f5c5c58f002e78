"""How much memory a large batch takes, in a process of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import attrs

from imm_tdoa.bench import fresh, jobs
from imm_tdoa.bench.machine import memory
from imm_tdoa.bench.measured import Figure, Goal, Measured
from imm_tdoa.engine import Engine

MILLION = 1_000_000
TWO_GIB = Goal(2.0)


@attrs.frozen
class Size:
    """How much is computed: so many targets through so many scans."""

    targets: int = MILLION
    scans: int = 50


FULL, QUICK = Size(), Size(targets=20_000)


def measure(size: Size, tell: Callable[[str], None], engine: Engine = "compiled") -> Measured:
    """Measure; `tell` is told what comes next."""
    title = f"{size.targets} targets, {size.scans} scans, keep='final', values included"
    whole = memory()
    if whole is not None and whole < 3 * 2**30 * size.targets / MILLION:
        note = "Left out: the machine has too little memory to try."
        return Measured("memory", title, (), notes=(note,))
    jobs.job(64, 2).run(engine=engine)  # so that the other process loads it and compiles nothing
    tell(f"memory of {size.targets} targets")
    call = f"memory.child({size.targets}, {size.scans}, {engine!r})"
    _, found = fresh.python(["-c", f"from imm_tdoa.bench import memory; {call}"])
    peak = found["peak"] / 2**30
    before = found["before"] / 2**30
    spent = found["seconds"]
    goal = TWO_GIB if size.targets >= MILLION and size.scans >= 50 else None
    figures = (
        Figure("peak resident memory", peak, "GiB", peak, peak, 1, goal),
        Figure("of it before the run, the values and Python", before, "GiB", before, before, 1),
        Figure("the run, all processors", spent, "s", spent, spent, 1),
    )
    note = "One shared start, as State without batch axes; measured once, in a process of its own."
    return Measured("memory", title, figures, notes=(note,))


def child(targets: int, scans: int, engine: Engine) -> None:
    """Track so many targets and report the peak of this process's memory, bytes."""
    job = jobs.job(targets, scans)
    job.first(64, 2).run(engine=engine, keep="final")
    before = resident("VmRSS")
    begun = perf_counter()
    track = job.run(engine=engine, keep="final")
    spent = perf_counter() - begun
    assert track.keep == "final"
    fresh.report(peak=resident("VmHWM"), before=before, seconds=spent)


def resident(which: str) -> int:
    """Return this process's memory, bytes: ``VmRSS`` now, ``VmHWM`` its peak.

    Where the system does not tell so in /proc, the peak for both. (There `getrusage` is no help:
    it counts from the parent's peak.)
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith(f"{which}:"):
                return 1024 * int(line.split()[1])
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak
