"""One chunk: some runs of one scenario, drawn and filtered by every bank as batches."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from imm_tdoa.study import criteria, score
from imm_tdoa.study.banks import BankCase
from imm_tdoa.study.draw import Drawn, clock, draw
from imm_tdoa.study.engines import Engine
from imm_tdoa.study.filtering import estimate
from imm_tdoa.study.fixes import Begin
from imm_tdoa.study.pinning import one_thread
from imm_tdoa.study.plan import Study
from imm_tdoa.study.planfile import parse
from imm_tdoa.study.scenarios import ScenarioCase, Start


class Task(NamedTuple):
    """A chunk to compute; small, so that it may be sent anywhere.

    Attributes
    ----------
    study : str
        The study, as TOML.
    scenario : int
        Which of its scenarios.
    first, last : int
        Runs, the last not included.
    engines : tuple of str
        What computes each bank's filter.
    """

    study: str
    scenario: int
    first: int
    last: int
    engines: tuple[Engine, ...]


class Chunk(NamedTuple):
    """What a task gave.

    Attributes
    ----------
    task : Task
        The task.
    arrays : dict of str to array
        What its file holds.
    seconds : tuple of float
        Time in each bank's filter; no two computers agree on it.
    steps : int
        Filter steps of each bank.
    """

    task: Task
    arrays: dict[str, Any]
    seconds: tuple[float, ...]
    steps: int


@lru_cache(maxsize=4)
def study_of(text: str) -> Study:
    """Return the study written in `text`, read once per process."""
    return parse(text, "study")


def work(task: Task) -> Chunk:
    """Compute a chunk on one thread; the same bits wherever and whenever it is done."""
    study = study_of(task.study)
    case = study.scenarios[task.scenario]
    with one_thread():
        drawn = draw(case, study.seed, task.first, task.last)
        arrays, seconds = _compute(study, case, drawn, task)
    arrays["runs"] = np.array([task.first, task.last])
    arrays["times"], arrays["dims"] = clock(case.plan), np.array(case.plan.dims)
    return Chunk(task, arrays, tuple(seconds), int(np.prod(drawn.values.shape[:2])))


def _compute(
    study: Study, case: ScenarioCase, drawn: Drawn, task: Task
) -> tuple[dict[str, Any], list[float]]:
    counts = score.scored(drawn.times, case.start is not None, case.score_from_s)
    modes = max(len(bank.bank) for bank in study.banks)
    needed = criteria.wanted(study.criteria)
    figures: dict[str, Any] = {}
    seconds: list[float] = []
    fits: dict[str, criteria.Fits] = {}
    begin = Begin(drawn)
    for bank, engine in zip(study.banks, task.engines, strict=True):
        fit = criteria.Fits(bank, len(drawn.seeds)) if bank.name in needed else None
        also = None if fit is None else fit.add
        _warm(bank, begin, case.start, engine)
        if case.start is None:
            begin.of(bank.imm(drawn.measurement))  # no step of a filter
        begun = time.perf_counter()
        found = estimate(bank, begin, case.start, engine, also)
        seconds.append(time.perf_counter() - begun - (0.0 if fit is None else fit.seconds))
        if fit is not None:
            fits[bank.name] = fit
        series = score.over_time(found, drawn.ways)
        score.put(figures, score.per_run(bank, found, series, drawn.ways, drawn.times, counts))
        score.put(figures, score.sums(found, series, counts, modes))
        score.put(figures, {"reason": found.reason.astype(np.str_)})
    arrays = {name: np.stack(values) for name, values in figures.items()}
    arrays["seeds"] = drawn.seeds
    if study.criteria:
        arrays["selected_model"] = criteria.choose(study.criteria, study.banks, arrays, fits)
    return arrays, seconds


def prepare(study: Study, engines: tuple[Engine, ...]) -> None:
    """Compile what a study needs and what is not on the disk, so that workers only load it."""
    if "compiled" not in engines:
        return
    from imm_tdoa.kernel.machine import machine
    from imm_tdoa.kernel.running import lanes_for

    case = study.scenarios[0]
    first, last = study.chunks(case)[0]
    lanes = lanes_for(last - first)
    for bank, engine in zip(study.banks, engines, strict=True):
        if engine == "compiled" and not machine.on_disk(lanes, "robust" in bank.options):
            _warm(bank, Begin(draw(case, study.seed, first, last)), case.start, engine)


_WARM: set[tuple[bool, int]] = set()


def _warm(bank: BankCase, begin: Begin, start: Start | None, engine: Engine) -> None:
    """Let the compiled engine compile, or load what was, before anything is timed.

    What is compiled depends on how many runs there are, and whether the filter is robust.
    """
    key = "robust" in bank.options, len(begin.drawn.seeds)
    if engine == "compiled" and key not in _WARM:
        _WARM.add(key)
        estimate(bank, begin, start, engine)
