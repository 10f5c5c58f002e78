"""Python that has just started: what a measurement needs that this process has done already."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

LINE = "imm-tdoa-bench:"  # before what the process reports


def python(
    arguments: Sequence[str], environment: Mapping[str, str] | None = None, cwd: str | None = None
) -> tuple[float, dict[str, Any]]:
    """Run Python with `arguments`; return the seconds from start to end, and what it reports.

    Parameters
    ----------
    arguments : sequence of str
        Of the interpreter.
    environment : mapping, optional
        Variables in addition to, or instead of, this process's.
    cwd : str, optional
        Where it runs.

    Raises
    ------
    ValueError
        It failed; with the last line of its error.
    """
    begun = perf_counter()
    done = subprocess.run(
        [sys.executable, "-P", *arguments],  # not a package that happens to lie in the folder
        env={**os.environ, **(environment or {})},
        cwd=cwd,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )
    spent = perf_counter() - begun
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ValueError(f"a fresh process failed (exit code {done.returncode}): {last}")
    said = [line for line in done.stdout.splitlines() if line.startswith(LINE)]
    return spent, json.loads(said[-1].removeprefix(LINE)) if said else {}


def report(**found: Any) -> None:
    """Say what was found, for the process that waits."""
    print(LINE + json.dumps(found), flush=True)
