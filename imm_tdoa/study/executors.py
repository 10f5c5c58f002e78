"""Who computes chunks: this process, threads or processes on this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

import attrs

from imm_tdoa._processors import processors
from imm_tdoa.study.chunk import Chunk, Task, work
from imm_tdoa.study.pinning import one_thread

PATIENCE = 10.0  # s to find a scheduler
BRIEF = 10_000_000  # compiled filter steps that are done before processes have started
TRIES = 4  # a chunk whose workers die as often is not tried again
SCHEME = "dask://"


class WorkersLostError(ValueError):
    """Workers died again and again: killed by somebody, or by the system for want of memory."""


class Executor(Protocol):
    """Computes tasks in any order."""

    def __call__(self, tasks: Sequence[Task]) -> Iterator[Chunk]:
        """Yield the chunks of `tasks` as they are ready."""
        ...


def executor(
    workers: int | None = None, cluster: str | None = None, *, brief: bool = False
) -> Executor:
    """Return who computes.

    Parameters
    ----------
    workers : int, optional
        Workers on this machine; default one per core.
    cluster : str, optional
        ``dask://host:port``: the scheduler of a dask.distributed cluster, whose machines have
        this package installed.
    brief : bool
        Whether the work is over before processes would have started: workers are threads then.

    Raises
    ------
    ValueError
        Less than one worker, both a cluster and workers, no address of a cluster, or no
        dask.distributed to reach it with.
    """
    if cluster is not None:
        if workers is not None:
            raise ValueError("--workers: a cluster has its own; give --workers or --cluster")
        if not cluster.startswith(SCHEME) or not cluster.removeprefix(SCHEME):
            raise ValueError(f"--cluster: expected {SCHEME}host:port, got {cluster!r}")
        _distributed()
        return Cluster(cluster.removeprefix(SCHEME))
    count = processors() if workers is None else workers
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"--workers: expected a whole number of at least 1, got {workers!r}")
    if count == 1:
        return Here()
    return Threads(count) if brief else Processes(count)


class Here:
    """This process, one chunk after the other."""

    def __call__(self, tasks: Sequence[Task]) -> Iterator[Chunk]:
        """Yield the chunks of `tasks` as they are ready."""
        with one_thread():
            yield from (work(task) for task in tasks)


@attrs.frozen
class Threads:
    """Threads of this process: they begin at once, but take turns wherever Python is at work.

    Parameters
    ----------
    count : int
        How many.
    """

    count: int

    def __call__(self, tasks: Sequence[Task]) -> Iterator[Chunk]:
        """Yield the chunks of `tasks` as they are ready."""
        from joblib import parallel_config

        with one_thread(), parallel_config("threading", n_jobs=min(self.count, len(tasks))):
            yield from _parallel(list(tasks))


@attrs.frozen
class Processes:
    """Processes on this machine; one that dies is replaced, and only its chunk is lost.

    Parameters
    ----------
    count : int
        How many.
    """

    count: int

    def __call__(self, tasks: Sequence[Task]) -> Iterator[Chunk]:
        """Yield the chunks of `tasks` as they are ready."""
        from joblib import parallel_config
        from joblib.externals.loky.process_executor import BrokenProcessPool

        left = {(task.scenario, task.first): task for task in tasks}
        tries = TRIES
        while left:
            before = len(left)
            try:
                jobs = min(self.count, before)
                with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
                    for chunk in _parallel(list(left.values())):
                        del left[chunk.task.scenario, chunk.task.first]
                        yield chunk
            except BrokenProcessPool as error:
                tries = TRIES if len(left) < before else tries - 1
                if tries == 0:
                    raise WorkersLostError(
                        f"workers died {TRIES} times on end, {len(left)} chunks are missing: were "
                        f"they killed, or is there too little memory for --workers {self.count}?"
                    ) from error


@attrs.frozen
class Cluster:
    """A dask.distributed cluster; its scheduler gives the chunks of a dead worker to another.

    Parameters
    ----------
    address : str
        ``host:port`` of the scheduler.
    """

    address: str

    def __call__(self, tasks: Sequence[Task]) -> Iterator[Chunk]:
        """Yield the chunks of `tasks` as they are ready."""
        from joblib import parallel_config

        with ExitStack() as stack:
            try:
                client = _distributed().Client(self.address, timeout=PATIENCE, set_as_default=False)
            except OSError as error:
                raise ValueError(f"--cluster: no scheduler answers at {self.address}") from error
            stack.callback(client.close)
            stack.enter_context(parallel_config("dask", client=client))
            yield from _parallel(list(tasks))


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ValueError(
            "--cluster: needs dask.distributed: pip install 'imm-tdoa[dask]'"
        ) from error
    return distributed


def _parallel(tasks: list[Task]) -> Iterator[Chunk]:
    from joblib import Parallel, delayed

    parallel = Parallel(return_as="generator_unordered", pre_dispatch="2 * n_jobs", batch_size=1)
    yield from parallel(delayed(work)(task) for task in tasks)
