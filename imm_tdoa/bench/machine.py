"""Which machine and which versions figures come from."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from imm_tdoa._processors import processors

PACKAGES = ("imm-tdoa", "numpy", "scipy", "numba", "llvmlite", "filterpy", "stonesoup")
TICK = 0.01  # s, to which Linux tells how long processors did what


def memory() -> int | None:
    """Return how much memory the machine has, bytes; None where it does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None


def processor() -> str:
    """Return the processor's name."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def load() -> float | None:
    """Return how many processes are waiting or computing, over the last minute."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return None


def stolen() -> float:
    """Return how long processors were wanted here while they computed for others, s, so far.

    A virtual machine's host tells it (steal time); elsewhere it is zero.
    """
    try:
        whole = Path("/proc/stat").read_text(encoding="utf-8").split(maxsplit=9)
        return int(whole[8]) * TICK
    except (OSError, IndexError):
        return 0.0


def describe() -> dict[str, Any]:
    """Return the machine, the versions and the date."""
    found: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    whole = memory()
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": processor(),
        "cpu": _cpu(),
        "processors": processors(),
        "memory_gib": None if whole is None else round(whole / 2**30, 1),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": found,
        "load_before": load(),
    }


def _cpu() -> str:
    """Return what the compiler takes the processor for."""
    from llvmlite.binding import get_host_cpu_name

    return str(get_host_cpu_name())


def in_words(about: dict[str, Any]) -> str:
    """Return the description as one line."""
    versions = ", ".join(
        f"{name} {number}" for name, number in about["versions"].items() if number is not None
    )
    room = "" if about["memory_gib"] is None else f", {about['memory_gib']:g} GiB"
    return (
        f"{about['processor']} ({about['cpu']}), {about['processors']} processors{room}; "
        f"Python {about['python']}, {versions}; {about['date'][:10]}"
    )
