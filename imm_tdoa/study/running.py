"""Running a study: what is missing of it, chunk by chunk, each kept as soon as it is there."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from imm_tdoa.study import bounds, engines
from imm_tdoa.study.chunk import Task, prepare
from imm_tdoa.study.executors import BRIEF, Executor, executor
from imm_tdoa.study.plan import Study
from imm_tdoa.study.store import Store


class Progress(NamedTuple):
    """How far a study is.

    Attributes
    ----------
    done, total : int
        Runs that are on the disk, of all scenarios' together.
    what : str
        What is being done.
    """

    done: int
    total: int
    what: str


class Interrupted(SystemExit):
    """The system asked the process to end (SIGTERM)."""


def run(
    study: Study,
    folder: str | Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    restart: bool = False,
    tell: Callable[[Progress], None] = lambda _: None,
) -> Store:
    """Run what is missing of a study, and return where its results lie.

    Every chunk of runs is on the disk before it is told of. Interrupting at any moment loses the
    chunks in flight at most; running again goes on. The results are the same to the last bit
    whoever computes them and however often they were interrupted.

    Parameters
    ----------
    study : Study
        What to run.
    folder : Path
        Where results are and go to.
    workers : int, optional
        Workers on this machine, threads or processes; default one per core.
    cluster : str, optional
        ``dask://host:port`` in their place.
    restart : bool
        Delete what the folder holds of a study, also of another one.
    tell : callable
        Is told how far the study is.

    Raises
    ------
    ValueError
        The folder holds another study; no such cluster; workers that die again and again.
    OSError
        A file that cannot be written, such as on a full disk; those before it are whole.
    """
    executor(workers, cluster)  # what cannot be is refused before anything is written
    store = Store(folder)
    store.open(study, restart=restart)
    with _leaving_cleanly():
        _engines(study, store)
        who = executor(workers, cluster, brief=_brief(study, store))
        _chunks(study, store, who, tell)
        for case in study.scenarios:
            if not store.has_bound(case.name):
                tell(Progress(_total(study), _total(study), f"bound of {case.name}"))
                store.save_bound(case.name, bounds.bound(study, case))
    return store


def _total(study: Study) -> int:
    return study.runs * len(study.scenarios)


def _brief(study: Study, store: Store) -> bool:
    """Whether what is left is done before processes would have started."""
    steps = sum(
        case.scans * (last - first)
        for case in study.scenarios
        for first, last in store.missing(study, case)
    )
    return "numpy" not in store.engines and steps * len(study.banks) < BRIEF


def _engines(study: Study, store: Store) -> None:
    """Decide what computes each bank's filter, once for the whole study."""
    chosen = engines.choose(study)
    before = store.engines
    if not before:
        store.save_engines(chosen)
    elif len(before) != len(study.banks) or any(
        old == "compiled" != new for old, new in zip(before, chosen, strict=True)
    ):
        raise ValueError(
            f"{store.folder}: was begun with the compiled engine, which is not there now; give "
            f"--restart to begin anew"
        )


def _chunks(study: Study, store: Store, who: Executor, tell: Callable[[Progress], None]) -> None:
    text, chosen = study.text, store.engines
    tasks = [
        Task(text, number, first, last, chosen)
        for number, case in enumerate(study.scenarios)
        for first, last in store.missing(study, case)
    ]
    total = _total(study)
    done = total - sum(task.last - task.first for task in tasks)
    tell(Progress(done, total, "running" if tasks else "all there"))
    if not tasks:
        return
    prepare(study, chosen)
    with closing(who(tasks)) as chunks:  # type: ignore[type-var]
        for chunk in chunks:
            store.save(study, chunk)
            done += chunk.task.last - chunk.task.first
            tell(Progress(done, total, study.scenarios[chunk.task.scenario].name))


@contextmanager
def _leaving_cleanly() -> Iterator[None]:
    """Turn SIGTERM into an exception, so that workers end and drafts are removed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, _: FrameType | None) -> None:
        raise Interrupted(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
