"""A dask.distributed cluster computes the same bits, also when one of its workers is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from study_cases import contents, tiny

from imm_tdoa.study import Progress, executors, run

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
pytestmark = pytest.mark.filterwarnings("default")  # dask's own


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two workers on this machine, each a process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as local:
        yield local


@pytest.mark.parametrize("kill", [False, True])
def test_a_cluster(tmp_path: Path, cluster: Any, kill: bool) -> None:
    killed: list[int] = []

    def tell(step: Progress) -> None:
        if kill and step.done >= 12 and not killed:
            killed.append(next(iter(cluster.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    address = cluster.scheduler_address.replace("tcp://", "dask://")
    run(tiny(), tmp_path / "cluster", cluster=address, tell=tell)
    run(tiny(), tmp_path / "alone", workers=1)
    assert contents(tmp_path / "cluster") == contents(tmp_path / "alone")
    assert bool(killed) == kill


def test_no_scheduler_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "PATIENCE", 0.5)
    with pytest.raises(ValueError, match="--cluster: no scheduler answers at localhost:9"):
        run(tiny(), tmp_path, cluster="dask://localhost:9")
