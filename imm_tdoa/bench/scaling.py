"""What one target and step costs as targets, scans, modes, stations and threads grow."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import attrs
import numpy as np

from imm_tdoa._processors import processors
from imm_tdoa.bench import jobs
from imm_tdoa.bench.clock import Timing, side_by_side
from imm_tdoa.bench.jobs import Job
from imm_tdoa.bench.machine import memory
from imm_tdoa.bench.measured import Figure, Goal, Measured, Point
from imm_tdoa.engine import Engine

FLAT = Goal(1.15)
STRAIGHT = Goal(0.15)
WHOLE = 150_000  # target-steps that are timed at least: smaller jobs are run several times on end
LONG = 2_000_000  # the same beside a million targets, so that all see the machine's ups and downs
BYTES = 1000  # of memory per target, besides its values
SPARE = 0.5  # share of the machine's memory that may be used


@attrs.frozen
class Size:
    """How much is computed.

    Attributes
    ----------
    targets : tuple of int
        Batches that are compared, each through `target_scans` scans.
    scans : tuple of int
        Lengths that are compared, of `scan_targets` targets.
    modes, stations : tuple of int
        Banks and networks that are compared, on `shape` (targets, scans).
    repetitions : int
        How often each is timed.
    """

    targets: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000)
    target_scans: int = 50
    scans: tuple[int, ...] = (10, 20, 50, 100, 200, 400)
    scan_targets: int = 2048
    modes: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    stations: tuple[int, ...] = (3, 4, 6, 8, 12, 16)
    shape: tuple[int, int] = (4096, 25)
    repetitions: int = 7


FULL = Size()
QUICK = Size(
    targets=(1_000, 10_000, 100_000),
    target_scans=10,
    scans=(10, 50, 100),
    scan_targets=512,
    modes=(1, 2, 3, 4),
    stations=(3, 4, 8),
    shape=(1024, 20),
    repetitions=5,
)


def measure(size: Size, tell: Callable[[str], None], engine: Engine = "compiled") -> Measured:
    """Measure; `tell` is told what comes next."""
    tell("cost against the number of targets: data")
    sizes = _fitting(size)
    whole = jobs.job(max(sizes), size.target_scans)
    tell("cost against the number of targets")
    batches = {n: whole.first(n) for n in sizes}
    points, by_targets = _curve("targets", batches, size, engine, min(LONG, whole.steps))
    del whole
    tell("cost against the number of scans")
    long = jobs.job(size.scan_targets, max(size.scans))
    lengths = {T: long.first(size.scan_targets, T) for T in size.scans}
    more, by_scans = _curve("scans", lengths, size, engine)
    points += more
    N, T = size.shape
    tell("cost against the number of modes")
    points += _curve("modes", {r: jobs.job(N, T, modes=r) for r in size.modes}, size, engine)[0]
    tell("cost against the number of stations")
    networks = {S: jobs.job(N, T, stations=S) for S in size.stations}
    points += _curve("stations", networks, size, engine)[0]
    tell("cost against the number of threads")
    points += _threads(size, engine)
    named = " to ".join(f"{n:,}".replace(",", " ") for n in (min(sizes), max(sizes)))
    lengths_named = f"{min(size.scans)} to {max(size.scans)}"
    figures = [
        _spread(f"dearest over cheapest, {named} targets", by_targets, FLAT),
        _departure(f"departure from a straight line, {lengths_named} scans", size.scans, by_scans),
        _spread(f"dearest over cheapest, {lengths_named} scans", by_scans),
    ]
    notes = [
        f"Targets: {size.target_scans} scans each, keep='final', one thread; scans: "
        f"{size.scan_targets} targets.",
        f"Modes and stations: {N} targets, {T} scans; banks: the first of "
        + ", ".join(name for name, _ in jobs.MODES)
        + " (one mode: constant-velocity).",
    ]
    if len(sizes) < len(size.targets):
        notes.append(f"{size.targets[-1]} targets: left out, they need more memory than there is.")
    return Measured(
        "scaling",
        "one target and step, as the job grows",
        tuple(figures),
        tuple(points),
        tuple(notes),
    )


def _fitting(size: Size) -> list[int]:
    """Return the batches that fit in memory."""
    whole = memory()
    each = BYTES + 8 * 3 * size.target_scans
    return [n for n in size.targets if whole is None or n * each < SPARE * whole]


def _curve(
    against: str, by: dict[int, Job], size: Size, engine: Engine, least: int | None = None
) -> tuple[list[Point], list[Timing]]:
    """Time the jobs in turns; return points, and seconds per target-step."""
    tasks = {
        str(x): lambda job=job: job.run(engine=engine, keep="final", threads=1)
        for x, job in by.items()
    }
    least = WHOLE if least is None else least
    often = {str(x): max(round(least / job.steps), 1) for x, job in by.items()}
    spent = side_by_side(tasks, size.repetitions, often)
    points = [Point.of(against, x, spent[str(x)], job.steps, "one thread") for x, job in by.items()]
    return points, [spent[str(x)] / job.steps for x, job in by.items()]


def _threads(size: Size, engine: Engine) -> list[Point]:
    """Return the points of every power of two of threads, and all processors."""
    most = processors()
    counts = sorted({*(2**k for k in range(most.bit_length()) if 2**k <= most), most})
    job = jobs.job(*(4 * size.shape[0], size.shape[1]))
    points = []
    for keep in ("final", "all"):
        tasks = {
            str(n): lambda n=n, keep=keep: job.run(engine=engine, keep=keep, threads=n)
            for n in counts
        }
        spent = side_by_side(tasks, size.repetitions)
        points += [
            Point.of("threads", n, spent[str(n)], job.steps, f"keep={keep!r}") for n in counts
        ]
    return points


def _spread(what: str, costs: Sequence[Timing], goal: Goal | None = None) -> Figure:
    """Return the dearest over the cheapest, by their medians."""
    ordered = sorted(costs, key=lambda cost: cost.median)
    return Figure.of(what, ordered[-1] / ordered[0], goal=goal)


def _departure(what: str, scans: Sequence[int], costs: Sequence[Timing]) -> Figure:
    """Return how far the time is from a + b T at most, relative to it."""
    T = np.array(scans, dtype=float)
    each = np.array([cost.values for cost in costs]).T
    found = []
    for cost in (np.median(each, axis=0), *each):
        design = np.stack([np.ones_like(T), 1.0 / T], axis=-1) / cost[:, None]
        fit = np.linalg.lstsq(design, np.ones_like(T), rcond=None)[0]
        found.append(float(np.max(np.abs(design @ fit - 1.0))))
    low, high = min(found), max(found)
    return Figure(what, found[0], "", low, high, len(each), STRAIGHT)
