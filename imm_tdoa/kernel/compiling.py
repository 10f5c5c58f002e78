"""How the functions of the kernel are compiled: as parts of the one that Python calls.

Where Numba is of a version that is known to bear it, parts are linked before they are optimised
(`linking`), which halves the time it takes. Any other version compiles them its own way.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba.core import config

KNOWN = (0, 61), (0, 69)  # Numba's versions from the first on, before the second
LINKS = KNOWN[0] <= numba.version_info.short < KNOWN[1]
SWITCHED_OFF = bool(getattr(config, "DISABLE_JIT"))  # noqa: B009 - set at run time


def compiled(function: Any) -> Any:
    """Compile a function that makes no arrays: it may leave the counting of references out.

    Counting takes an atomic instruction for each array argument of each call.
    """
    return _part(function, _nrt=False)


def allocating(function: Any) -> Any:
    """Compile a function that makes arrays."""
    return _part(function)


def _part(function: Any, **options: Any) -> Any:
    """Compile `function` when it is first called (`machine` keeps the machine code on disk)."""
    if LINKS:
        from imm_tdoa.kernel.linking import PartCompiler

        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        options["pipeline_class"] = PartCompiler
    return numba.njit(
        error_model="numpy",  # a division may give inf, without a branch
        fastmath={"contract"},  # a * b + c may be one instruction
        **options,
    )(function)


def whole(function: Any, cache: bool) -> Any:
    """Compile a function for Python to call, with all its parts; `cache`: keep it on disk."""
    options: dict[str, Any] = {}
    if LINKS:
        from imm_tdoa.kernel.linking import WholeCompiler

        options["pipeline_class"] = WholeCompiler
    return numba.njit(cache=cache, nogil=True, error_model="numpy", **options)(function)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let the compiler work without collecting garbage.

    It makes millions of objects that stay; looking through them takes a tenth of its time.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
