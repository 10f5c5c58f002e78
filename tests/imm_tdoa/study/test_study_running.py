"""Whoever computes a study, and however many they are: the same to the last bit."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from study_cases import contents, tiny

from imm_tdoa._processors import processors
from imm_tdoa.study import Progress, Store, engines, run, running
from imm_tdoa.study import executors as who


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The small study, computed by this process."""
    folder = tmp_path_factory.mktemp("alone")
    run(tiny(), folder, workers=1)
    return contents(folder)


@pytest.mark.parametrize("workers", [2, 3])
def test_any_number_of_workers(tmp_path: Path, workers: int, alone: dict[str, bytes]) -> None:
    run(tiny(), tmp_path, workers=workers)
    assert contents(tmp_path) == alone


def test_threads_where_the_work_is_brief(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, alone: dict[str, bytes]
) -> None:
    before = set(children())
    monkeypatch.setattr(running, "_brief", lambda study, store: True)
    run(tiny(), tmp_path, workers=3)
    assert contents(tmp_path) == alone
    assert set(children()) <= before


def test_what_brief_work_is(tmp_path: Path) -> None:
    """What is compiled and short: neither a long study nor one that NumPy computes."""
    plan = tiny(("runs = 20", "runs = 100"))
    store = Store(tmp_path)
    store.open(plan)
    store.save_engines(("compiled", "compiled"))
    assert running._brief(plan, store)
    many = tiny(("runs = 20", f"runs = {who.BRIEF // 10}"))
    assert not running._brief(many, store)
    store.save_engines(("compiled", "numpy"))
    assert not running._brief(plan, store)
    assert isinstance(who.executor(2, brief=True), who.Threads)
    assert isinstance(who.executor(2), who.Processes)
    assert isinstance(who.executor(1, brief=True), who.Here)


def children() -> list[int]:
    """Processes that this one started."""
    tasks = Path(f"/proc/{os.getpid()}/task")
    return [int(pid) for task in tasks.iterdir() for pid in (task / "children").read_text().split()]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to find a worker")
def test_a_killed_worker_costs_its_chunk_and_no_more(
    tmp_path: Path, alone: dict[str, bytes]
) -> None:
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown(wait=True)
    before, killed = set(children()), []

    def tell(step: Progress) -> None:
        if step.done >= 12 and not killed:
            workers = [pid for pid in children() if pid not in before and _works(pid)]
            killed.append(workers[0])
            os.kill(workers[0], signal.SIGKILL)

    run(tiny(), tmp_path, workers=2, tell=tell)
    assert killed
    assert contents(tmp_path) == alone


def _works(pid: int) -> bool:
    return b"popen_loky" in Path(f"/proc/{pid}/cmdline").read_bytes()


def test_workers_that_always_die_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    tried = []

    def dies(tasks: list[who.Task]) -> None:
        tried.append(len(tasks))
        raise TerminatedWorkerError("killed")

    monkeypatch.setattr(who, "_parallel", dies)
    task = who.Task("", 0, 0, 1, ())
    with pytest.raises(who.WorkersLostError, match="workers died 4 times on end, 1 chunks are"):
        list(who.Processes(2)([task]))
    assert tried == [1, 1, 1, 1]


@pytest.mark.parametrize(
    ("workers", "cluster", "message"),
    [
        (0, None, "--workers: expected a whole number of at least 1, got 0"),
        (2, "dask://a:1", "--workers: a cluster has its own; give --workers or --cluster"),
        (None, "tcp://a:1", "--cluster: expected dask://host:port, got 'tcp://a:1'"),
        (None, "dask://", "--cluster: expected dask://host:port, got 'dask://'"),
    ],
)
def test_who_cannot_compute(workers: int | None, cluster: str | None, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        who.executor(workers, cluster)
    assert message in str(caught.value)


def test_without_dask_the_message_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install 'imm-tdoa\[dask\]'"):
        who.executor(None, "dask://localhost:1")


def test_one_worker_per_core_is_the_default() -> None:
    one = who.executor()
    count = one.count if isinstance(one, who.Processes) else 1
    assert count == processors() >= 1


def test_progress_counts_runs_on_the_disk(tmp_path: Path) -> None:
    told: list[Progress] = []

    def tell(step: Progress) -> None:
        told.append(step)
        there = len(list(tmp_path.glob("chunks/*.npz")))
        assert step.done <= 6 * there

    run(tiny(), tmp_path, workers=1, tell=tell)
    assert [step.done for step in told] == [0, 6, 12, 18, 20, 26, 32, 38, 40, 40, 40]
    assert {step.total for step in told} == {40}
    again: list[Progress] = []
    run(tiny(), tmp_path, workers=1, tell=again.append)
    assert again == [Progress(40, 40, "all there")]


def test_large_studies_are_compiled_where_that_is_possible() -> None:
    many = ("runs = 20", "runs = 10000")
    assert engines.choose(tiny()) == ("numpy", "numpy")
    assert engines.choose(tiny(many)) == ("compiled", "compiled")
    turning = '"constant-velocity", psd = 1.0'
    plan = tiny(many, (turning, '"coordinated-turn", psd = 1.0'))
    assert engines.choose(plan) == ("numpy", "compiled")


def test_a_study_goes_on_with_the_engine_it_began_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = run(tiny(runs=6), tmp_path, workers=1)
    monkeypatch.setattr(engines, "choose", lambda _: ("compiled", "compiled"))
    assert run(tiny(), tmp_path, workers=1).engines == ("numpy", "numpy")
    store.save_engines(("compiled", "compiled"))
    monkeypatch.setattr(engines, "choose", lambda _: ("numpy", "numpy"))
    with pytest.raises(ValueError, match="was begun with the compiled engine"):
        run(tiny(), tmp_path, workers=1)
