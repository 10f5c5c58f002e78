"""Parts linked before they are optimised, or compiled Numba's own way: the same numbers."""

from __future__ import annotations

from pathlib import Path

import numba
import numpy as np
import pytest

from imm_tdoa.kernel import compiling, machine


def half(x):
    """Take half of each number in place."""
    for i in range(len(x)):
        x[i] *= 0.5


def twice_half(part):
    """Return a function that takes half twice, by a part."""

    def run(x):
        part(x)
        part(x)
        return x.sum()

    return run


@pytest.mark.skipif(compiling.SWITCHED_OFF, reason="Numba's compilation is switched off")
@pytest.mark.parametrize("links", [False, True])
def test_either_way_of_compiling(monkeypatch, links):
    monkeypatch.setattr(compiling, "LINKS", links)
    whole = compiling.whole(twice_half(compiling.compiled(half)), cache=False)
    x = np.arange(8.0)
    assert whole(x) == 7.0
    assert np.array_equal(x, np.arange(8.0) / 4.0)


def test_only_known_versions_are_reached_into():
    low, high = compiling.KNOWN
    assert low <= numba.version_info.short < high  # else: try it, and move the bound
    assert compiling.LINKS


def test_whatever_the_kernel_is_made_of_is_in_its_fingerprint():
    """Code that Python calls around it (feeding, plans, running) is not."""
    folder = Path(machine.__file__).parent
    around = {
        "brief", "feeding", "machine", "plan", "running", "sharing", "stepping", "tracking",
        "__init__",
    }  # fmt: skip
    assert {path.stem for path in folder.glob("*.py")} - around == set(machine.SOURCES)
