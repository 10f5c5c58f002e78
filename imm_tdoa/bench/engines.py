"""The two engines on the same job, and what gross errors' treatment costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import attrs
import numpy as np
from threadpoolctl import threadpool_limits

from imm_tdoa.bench import jobs
from imm_tdoa.bench.clock import side_by_side
from imm_tdoa.bench.jobs import Job
from imm_tdoa.bench.measured import Figure, Goal, Measured
from imm_tdoa.cycle import RobustRule
from imm_tdoa.engine import Engine
from imm_tdoa.track import Track

RULES: tuple[RobustRule | None, ...] = (None, "gate", "student-t")
SAME = Goal(1e-9)


@attrs.frozen
class Size:
    """How much is computed: so many targets and scans, so often."""

    targets: int = 1000
    scans: int = 20
    repetitions: int = 5


FULL, QUICK = Size(), Size(targets=200, scans=10)


def measure(size: Size, tell: Callable[[str], None], engine: Engine = "compiled") -> Measured:
    """Measure; `tell` is told what comes next."""
    figures: list[Figure] = []
    plain = None
    for rule in RULES:
        name = "plain" if rule is None else rule
        tell(f"both engines: {name}")
        job = jobs.job(size.targets, size.scans, robust=rule)
        tasks = {
            "compiled": partial(job.run, engine=engine, threads=1),
            "numpy": partial(job.run, engine="numpy"),
        }
        with threadpool_limits(1):
            spent = side_by_side(tasks, size.repetitions, {"compiled": 5})
        ours, theirs = (spent[which] / job.steps for which in tasks)
        unit = "µs per target-step"
        figures += [
            Figure.of(f"{name}: compiled, one thread", ours, unit, 1e6),
            Figure.of(f"{name}: NumPy", theirs, unit, 1e6),
            Figure.of(f"{name}: NumPy over compiled", theirs / ours),
        ]
        if plain is None:
            plain = ours
        else:
            cost = ours.median / plain.median
            ends = ours.low / plain.high, ours.high / plain.low
            figures.append(
                Figure(f"{name} over plain, compiled", cost, "", *ends, size.repetitions)
            )
        apart = difference(job, engine)
        figures.append(Figure(f"{name}: largest difference", apart, "", apart, apart, 1, SAME))
    title = f"NumPy and compiled: {size.targets} targets, {size.scans} scans, keep='all'"
    note = "Differences: of means, covariances and probabilities, relative to the largest of each."
    return Measured("engines", title, tuple(figures), notes=(note,))


def difference(job: Job, engine: Engine) -> float:
    """Return the largest difference between the engines, relative to the largest of each."""
    ours, theirs = (_said(job.run(engine=which)) for which in (engine, "numpy"))
    return max(
        float(np.max(np.abs(a - theirs[name]) / np.max(np.abs(theirs[name]))))
        for name, a in ours.items()
    )


def _said(track: Track) -> Mapping[str, np.ndarray]:
    return {
        "mean": track.mean,
        "covariance": track.covariance,
        "mode probability": track.mode_probability,
        "log-likelihood": track.log_likelihood,
    }
