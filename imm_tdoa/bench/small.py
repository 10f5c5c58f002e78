"""Small jobs: Source A's own run, and one long recording of single differences."""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np

from imm_tdoa.bench import jobs
from imm_tdoa.bench.clock import side_by_side
from imm_tdoa.bench.jobs import Job
from imm_tdoa.bench.measured import Figure, Goal, Measured
from imm_tdoa.engine import Engine
from imm_tdoa.imm import IMM
from imm_tdoa.reproduce.motion_form import scenario, tracking
from imm_tdoa.reproduce.motion_form.interacting import SOJOURN_S
from imm_tdoa.reproduce.motion_form.switches import Switches

SOURCE_A = Goal(0.15)  # ms; the paper: 0.45 for a single model
EACH = Goal(8.0)  # µs


@attrs.frozen
class Size:
    """How much is computed.

    Attributes
    ----------
    differences : int
        That come one at a time.
    times : int
        How often Source A's run is run on end in each repetition.
    repetitions : int
        How often each is timed.
    """

    differences: int = 30_000
    times: int = 100
    repetitions: int = 9


FULL, QUICK = Size(), Size(repetitions=5, times=50)


def source_a() -> Job:
    """Return Source A's three targets that accelerate, from their first fixes on."""
    motion, switches = scenario.CONSTANT_ACCELERATION, Switches()
    values = scenario.draw(1, 2, motion, switches)[0]
    imm = IMM(scenario.all_models(mean_sojourn=SOJOURN_S), scenario.measurement(switches))
    first = tracking.fixes(values[:, 0], switches)
    start = imm.start(motion.times[0], first.position, first.covariance)
    return Job(imm, motion.times[1:], values[:, 1:], start)


def measure_source_a(
    size: Size, tell: Callable[[str], None], engine: Engine = "compiled"
) -> Measured:
    """Measure Source A's own run."""
    tell("Source A's own run")
    job = source_a()
    job.run(engine=engine)  # from now on "auto" has it ready
    how: Engine = "auto" if engine == "compiled" else engine
    tasks = {
        "ours": lambda: job.run(engine=how, threads=1),
        "NumPy": lambda: job.run(engine="numpy"),
    }
    spent = side_by_side(tasks, size.repetitions, {"ours": size.times})
    ran = job.run(engine=how).engine
    figures = (
        Figure.of("IMM.run", spent["ours"], "ms", 1e3, SOURCE_A),
        Figure.of("the NumPy engine", spent["NumPy"], "ms", 1e3),
    )
    note = f"engine='auto' took the {ran} one. The paper has 0.45 ms for a single model."
    targets, scans = job.values.shape[:2]
    return Measured(
        "source-a",
        f"Source A's run: {targets} targets, {scans} scans, 3 modes",
        figures,
        notes=(note,),
    )


def measure_single_rows(
    size: Size, tell: Callable[[str], None], engine: Engine = "compiled"
) -> Measured:
    """Measure one target whose scans are one difference each."""
    tell("one difference at a time")
    count = size.differences
    uneven = jobs.one_pair_at_a_time(count)
    even = attrs.evolve(uneven, times=0.01 * np.arange(1.0, count + 1.0))
    tasks = {
        "uneven": lambda: uneven.run(engine=engine),
        "even": lambda: even.run(engine=engine),
        "final": lambda: uneven.run(engine=engine, keep="final"),
    }
    spent = side_by_side(tasks, size.repetitions)
    unit = "µs per difference"
    figures = (
        Figure.of("irregular times", spent["uneven"] / count, unit, 1e6, EACH),
        Figure.of("regular times", spent["even"] / count, unit, 1e6, EACH),
        Figure.of("irregular times, keep='final'", spent["final"] / count, unit, 1e6),
    )
    title = f"one target in 3-D, {count} differences one pair at a time, 8 stations, 3 modes"
    return Measured("single-rows", title, figures)
