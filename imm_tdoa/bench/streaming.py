"""One target, scan by scan, as an operator's station receives it."""

from __future__ import annotations

from collections.abc import Callable

import attrs
from threadpoolctl import threadpool_limits

from imm_tdoa.bench import jobs, peers
from imm_tdoa.bench.clock import Task, side_by_side
from imm_tdoa.bench.jobs import Job
from imm_tdoa.bench.measured import Figure, Goal, Measured
from imm_tdoa.engine import Engine

OF_FILTERPY = Goal(40.0, "at least")


@attrs.frozen
class Size:
    """How much is computed: so many scans, so often."""

    scans: int = 200
    repetitions: int = 15


FULL, QUICK = Size(), Size(repetitions=7)


def measure(size: Size, tell: Callable[[str], None], engine: Engine = "compiled") -> Measured:
    """Measure; `tell` is told what comes next."""
    tell("streaming: compiling")
    job = jobs.job(1, size.scans)
    if engine == "compiled":
        job.imm.compile()
    tell("streaming: filterpy's step and ours")
    member = peers.fastest(job)
    tasks: dict[str, Task] = {
        "filterpy": lambda: _theirs(job, member),
        "ours": lambda: stream(job, engine),
        "NumPy": lambda: stream(job.first(1, 20), "numpy"),
    }
    with threadpool_limits(1):
        spent = side_by_side(tasks, size.repetitions, {"ours": 5})
    theirs, ours = spent["filterpy"] / size.scans, spent["ours"] / size.scans
    figures = (
        Figure.of("filterpy: predict, update, read x and P", theirs, "µs per step", 1e6),
        Figure.of("IMM.step, read mean and covariance", ours, "µs per step", 1e6),
        Figure.of("times filterpy", theirs / ours, "", goal=OF_FILTERPY),
        Figure.of("the NumPy engine", spent["NumPy"] / 20, "µs per step", 1e6),
    )
    note = f"filterpy's members: {member.__name__}; the same data and models as in the batch."
    return Measured(
        "streaming",
        "one target through IMM.step, 3 modes, 3 differences in 2-D",
        figures,
        notes=(note,),
    )


def stream(job: Job, engine: Engine) -> float:
    """Step through the first target's scans, reading the estimate after each; a sum of it."""
    state, step, total = job.start, job.imm.step, 0.0
    for time, values in zip(job.times.tolist(), job.values[0], strict=True):
        state = step(state, time, values, engine=engine)
        total += state.mean[0] + state.covariance[0, 0]
    return float(total)


def _theirs(job: Job, member: type[object]) -> float:
    imm, total = peers.filterpy_imm(job, member), 0.0
    for z in peers.columns(job, 0):
        imm.predict(0)
        imm.update(z)
        total += imm.x[0, 0] + imm.P[0, 0]
    return float(total)
