"""The engine is compiled once, by all test workers together, before the first test here."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from imm_tdoa import IMM, Bank
from imm_tdoa.models import ConstantVelocity, Position

KINDS = (  # the longest first; robust filters of 3 to 8 targets are not tried, to save as much
    ("robust", 16),
    ("robust", 1),
    ("plain", 16),
    ("step", 1),
    ("plain", 1),
    ("plain", 4),
)
PATIENCE = 600.0  # s that a worker waits for what another compiles


def _use(kind: str, targets: int) -> None:
    """Compile one specialisation of the kernel, or load it from disk."""
    imm = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(1.0, dims=1), robust=None)
    if kind == "step":
        imm.compile()
        return
    if kind == "robust":
        imm = IMM(imm.bank, imm.measurement, robust="gate")
    start = imm.start(0.0, np.zeros((targets, 1)), np.eye(1))
    imm.run([1.0], np.zeros((targets, 1, 1)), start=start, engine="compiled")


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Share the specialisations out among the workers; then load what the others compiled."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    mine = []
    for kind, targets in KINDS:
        try:
            (folder / f"kernel-{kind}-{targets}.claimed").touch(exist_ok=False)
        except FileExistsError:
            continue
        try:
            _use(kind, targets)
        finally:
            (folder / f"kernel-{kind}-{targets}.done").touch()
        mine.append((kind, targets))
    for kind, targets in KINDS:
        if (kind, targets) not in mine:
            _wait_for(folder / f"kernel-{kind}-{targets}.done")
            _use(kind, targets)


def _wait_for(path: Path) -> None:
    begun = time.monotonic()
    while not path.exists() and time.monotonic() - begun < PATIENCE:
        time.sleep(0.05)
