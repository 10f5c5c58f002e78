"""The recursion as machine code: made when first needed, kept on disk for later processes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding

from imm_tdoa.kernel import recursion
from imm_tdoa.kernel.compiling import SWITCHED_OFF, undisturbed, whole
from imm_tdoa.kernel.vectors import Lanes

SOURCES = (
    "bits", "compiling", "earth", "elementary", "gathering", "gating", "layout", "linking",
    "looking", "memory", "mixing", "offsets", "reading", "recursion", "sources", "tails",
    "updating", "vectors", "weighing",
)  # fmt: skip


def _digest() -> str:
    """Fingerprint of the kernel's sources; Numba itself looks at the file of `run` only."""
    folder = Path(__file__).parent
    whole = hashlib.sha256()
    for name in SOURCES:
        whole.update((folder / f"{name}.py").read_bytes())
    for name in ("makeup", "robust"):
        whole.update((folder.parent / f"{name}.py").read_bytes())
    return whole.hexdigest()[:16]


DIGEST = _digest()


def _entry(digest: str, cache: bool) -> Callable[..., Any]:
    def run(
        lanes: Any,
        spec: Any,
        feed: Any,
        robust: Any,
        records: Any,
        out: Any,
        kept: Any,
        stride: Any,
        first: Any,
        last: Any,
        start: Any,
        begin: Any,
    ) -> Any:
        digest  # noqa: B018 - a variable of the closure is part of the key compiled code is kept by
        return recursion.run(
            lanes, spec, feed, robust, records, out, kept, stride, first, last, start, begin
        )

    jit: Callable[..., Any] = whole(run, cache)
    return jit


def _step_entry(digest: str, cache: bool) -> Callable[..., Any]:
    def step(
        lanes: Any,
        ints: Any,
        floats: Any,
        table: Any,
        values: Any,
        record: Any,
        estimate: Any,
    ) -> Any:
        digest  # noqa: B018
        return recursion.step(lanes, ints, floats, table, values, record, estimate)

    jit: Callable[..., Any] = whole(step, cache)
    return jit


class Machine:
    """The compiled recursion, and what is known of when it can be had without waiting."""

    def __init__(self) -> None:
        self.keeps = not SWITCHED_OFF
        self.stepped = False  # whether `step` is compiled
        self._ready: set[tuple[int, bool]] = set()
        try:
            self._run = _entry(DIGEST, self.keeps)
            self.step = _step_entry(DIGEST, self.keeps)
        except RuntimeError:  # Numba finds no folder that it may write to
            self._without_disk()

    def _without_disk(self) -> None:
        self.keeps = False
        self._run = _entry(DIGEST, False)
        self.step = _step_entry(DIGEST, False)

    def ready(self, lanes: Lanes, robust: bool) -> bool:
        """Whether this process has it compiled or loaded; never where that is switched off."""
        return not SWITCHED_OFF and (len(lanes), robust) in self._ready

    def on_disk(self, lanes: Lanes, robust: bool) -> bool:
        """Whether an earlier process left it compiled, to be loaded within a second."""
        return self.keeps and self._mark(lanes, robust).exists()

    def _mark(self, lanes: Lanes, robust: bool) -> Path:
        kind = "robust" if robust else "plain"
        cpu = binding.get_host_cpu_name()
        name = f"imm_tdoa-{DIGEST}-{numba.__version__}-{cpu}-{len(lanes)}-{kind}.compiled"
        return Path(self._run.stats.cache_path) / name  # type: ignore[attr-defined]

    def first_step(self, *given: Any) -> Any:
        """Call `step` for the first time."""
        with undisturbed():
            return self.step(*given)

    def __call__(self, lanes: Lanes, spec: Any, feed: Any, robust: Any, *rest: Any) -> Any:
        """Call `recursion.run`."""
        kind = (len(lanes), robust is not None)
        if kind in self._ready:
            return self._call(lanes, spec, feed, robust, *rest)
        with undisturbed():
            result = self._call(lanes, spec, feed, robust, *rest)
        self._ready.add(kind)
        if self.keeps:
            try:
                self._mark(lanes, robust is not None).touch()
            except OSError:
                self.keeps = False
        return result

    def _call(self, *given: Any) -> Any:
        try:
            return self._run(*given)
        except OSError:  # it is compiled, but the folder for it has become unwritable
            self.keeps = False
            try:
                return self._run(*given)
            except OSError:  # or can no longer be read
                self._without_disk()
                return self._run(*given)


machine = Machine()
