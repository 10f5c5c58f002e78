"""What computes an IMM: NumPy, or the compiled kernel where it can and where it is worth it.

Both give the same numbers. The kernel is some hundred times faster, but the first process that
needs it waits several seconds for its compilation, and each later one half a second for loading
it from disk. So ``"auto"`` takes it where it is loaded already, or where a job is long enough.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Literal, get_args

from imm_tdoa import _validate

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM

Engine = Literal["auto", "numpy", "compiled"]
ENGINES: tuple[str, ...] = get_args(Engine)
WORTH_LOADING = 1.0  # s of NumPy's time from which the kernel is loaded from disk
WORTH_COMPILING = 10.0  # s of NumPy's time from which it is compiled
A_MODE = 0.4e-3  # s that NumPy takes per mode and scan, whatever the number of targets
A_TARGET = 5e-6  # s that it takes for each target in addition
SLOWER = {None: 1.0, "gate": 2.0, "student-t": 8.0}


def choose(imm: IMM, targets: int, scans: int, engine: Engine) -> Literal["numpy", "compiled"]:
    """Return what is to compute so many scans of so many targets.

    Raises
    ------
    ValueError
        An unknown engine, or ``"compiled"`` for an IMM that cannot be compiled.
    """
    _validate.one_of("engine", engine, ENGINES)
    if engine == "numpy":
        return "numpy"
    reason = imm.cannot_compile
    if engine == "compiled":
        if reason is not None:
            raise ValueError(
                f"engine: the compiled engine does not support {reason}; use 'auto' or 'numpy'"
            )
        return "compiled"
    seconds = scans * len(imm.bank) * (A_MODE + A_TARGET * targets) * SLOWER[imm.robust]
    if reason is not None or (not loaded() and seconds < WORTH_LOADING) or _switched_off():
        return "numpy"
    from imm_tdoa.kernel.machine import machine
    from imm_tdoa.kernel.running import lanes_for

    kind = lanes_for(targets), imm.robust is not None
    soon = seconds >= WORTH_LOADING and machine.on_disk(*kind)
    return "compiled" if machine.ready(*kind) or soon or seconds >= WORTH_COMPILING else "numpy"


def _switched_off() -> bool:
    """Whether Numba is told not to compile: then the kernel would be slower than NumPy."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")


def loaded() -> bool:
    """Whether this process has loaded what the compiled engine is compiled by."""
    return "imm_tdoa.kernel.machine" in sys.modules


def ready_to_step() -> bool:
    """Whether this process has the compiled step of a single target."""
    kernel = sys.modules.get("imm_tdoa.kernel.machine")
    return kernel is not None and bool(kernel.machine.stepped)
