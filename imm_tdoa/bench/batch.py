"""Many targets at once: against filterpy, against Stone Soup, and in two threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Thread

import attrs
import numpy as np
from threadpoolctl import threadpool_limits

from imm_tdoa._processors import processors
from imm_tdoa.bench import jobs, peers
from imm_tdoa.bench.clock import Task, side_by_side
from imm_tdoa.bench.jobs import Job
from imm_tdoa.bench.measured import Figure, Goal, Measured
from imm_tdoa.engine import Engine

TIMES_FILTERPY = Goal(1000.0, "at least")
TWO_THREADS = Goal(1.8, "at least")
SAME = Goal(1e-6)  # of a standard deviation: that both compute the same


@attrs.frozen
class Size:
    """How much is computed.

    Attributes
    ----------
    targets, scans : int
        Of the batch.
    peer_targets : int
        How many of the targets the other libraries track in each repetition.
    repetitions : int
        How often each is timed.
    turns : int
        How often one thread and two take turns: their ratio is told to a few hundredths, more
        finely than the moments of a machine are alike.
    """

    targets: int = 16384
    scans: int = 50
    peer_targets: int = 4
    repetitions: int = 15
    turns: int = 75


FULL, QUICK = Size(), Size(targets=4096, peer_targets=2, repetitions=5, turns=15)


def measure(size: Size, tell: Callable[[str], None], engine: Engine = "compiled") -> Measured:
    """Measure; `tell` is told what comes next."""
    tell("data of the batch")
    job = jobs.job(size.targets, size.scans)
    tell("filterpy's answers")
    with threadpool_limits(1):
        member = peers.fastest(job)
        apart = peers.disagreement(job, size.peer_targets, member, engine=engine)
    tell("batch and filterpy")
    tasks: dict[str, Task] = {
        "filterpy": lambda: peers.follow(job, size.peer_targets, member),
        "final": lambda: job.run(engine=engine, keep="final", threads=1),
        "all": lambda: job.run(engine=engine, keep="all", threads=1),
    }
    with threadpool_limits(1):
        spent = side_by_side(tasks, size.repetitions)
    peer = spent["filterpy"] / (size.peer_targets * size.scans)
    figures = [
        Figure.of("filterpy", peer, "µs per target-step", 1e6),
        Figure("largest difference between the answers", apart, "σ", apart, apart, 1, SAME),
    ]
    for keep in ("final", "all"):
        one = spent[keep] / job.steps
        figures += [
            Figure.of(f"one thread, keep={keep!r}", one, "µs per target-step", 1e6),
            Figure.of(f"times filterpy, keep={keep!r}", peer / one, "", goal=TIMES_FILTERPY),
        ]
    notes = [
        f"filterpy's members: {member.__name__} ({member.__mro__[1].__name__}), the quicker way "
        f"of {len(peers.MEMBERS)}; modes embedded in {len(job.imm.space.components)} components."
    ]
    if processors() > 1:
        tell("batch, two threads")
        figures += _two_threads(job, size, engine)
        notes.append(
            "Two runs of half the targets each, at the same time, in a thread each: what this "
            "machine gives where nothing is shared."
        )
    else:
        notes.append("Two threads: left out, this process may use one processor only.")
    tell("batch, Stone Soup")
    found, note = _stone_soup(size, engine)
    title = f"{size.targets} targets, {size.scans} scans, 3 modes, 3 differences in 2-D"
    return Measured("batch", title, (*figures, *found), notes=(*notes, note))


def _two_threads(job: Job, size: Size, engine: Engine) -> list[Figure]:
    """Compare two threads with one, and with what the machine gives."""
    figures = []
    for keep, turns in (("final", size.turns), ("all", size.repetitions)):
        tasks: dict[str, Task] = {
            "one": partial(job.run, engine=engine, keep=keep, threads=1),
            "two": partial(job.run, engine=engine, keep=keep, threads=2),
            "halves": _halves(job, keep, engine),
        }
        with threadpool_limits(1):
            spent = side_by_side(tasks, turns)
        two, ratio = spent["two"] / job.steps, spent["one"] / spent["two"]
        figures += [
            Figure.of(f"two threads, keep={keep!r}", two, "µs per target-step", 1e6),
            Figure.of(f"two threads over one, keep={keep!r}", ratio, "", goal=TWO_THREADS),
            Figure.of(f"two runs of half each, keep={keep!r}", spent["one"] / spent["halves"]),
        ]
    return figures


def _halves(job: Job, keep: str, engine: Engine) -> Task:
    """Return what runs each half of the targets in a thread of its own."""
    middle = len(job.values) // 2
    parts = [attrs.evolve(job, values=v) for v in (job.values[:middle], job.values[middle:])]

    def task() -> None:
        threads = [
            Thread(target=part.run, kwargs={"engine": engine, "keep": keep, "threads": 1})
            for part in parts
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    return task


def _stone_soup(size: Size, engine: Engine) -> tuple[list[Figure], str]:
    """Compare one filter of constant velocity with Stone Soup's."""
    if not peers.has_stone_soup():
        return [], "Stone Soup: left out, it is not installed (pip install 'imm-tdoa[bench]')."
    job = jobs.job(size.targets, size.scans, modes=1)
    peer = peers.StoneSoup(job, jobs.MODES[1][1]["psd"])
    apart = _apart(job, peer, size.peer_targets, engine)
    tasks: dict[str, Task] = {
        "theirs": lambda: peer.follow(size.peer_targets),
        "ours": lambda: job.run(engine=engine, keep="final", threads=1),
    }
    with threadpool_limits(1):
        spent = side_by_side(tasks, size.repetitions)
    theirs = spent["theirs"] / (size.peer_targets * size.scans)
    ours = spent["ours"] / job.steps
    figures = [
        Figure.of("Stone Soup's EKF, one model", theirs, "µs per target-step", 1e6),
        Figure.of("one model, one thread", ours, "µs per target-step", 1e6),
        Figure.of("times Stone Soup, one model", theirs / ours),
        Figure("difference from Stone Soup's answers", apart, "σ", apart, apart, 1, SAME),
    ]
    return figures, "Stone Soup: one extended Kalman filter, constant velocity, no IMM."


def _apart(job: Job, peer: peers.StoneSoup, targets: int, engine: Engine) -> float:
    """Return the largest difference of the last means, in standard deviations."""
    track = job.first(targets).run(engine=engine, keep="final")
    std = np.sqrt(np.diagonal(track.covariance[:, -1], axis1=-2, axis2=-1))
    return float(np.max(np.abs(track.mean[:, -1] - peer.follow(targets)) / std))
