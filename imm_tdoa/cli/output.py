"""Where commands write to, and how they tell what they did."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from imm_tdoa.recording import _atomic

if TYPE_CHECKING:
    from imm_tdoa.recording.table import Table as Columns

WIDTH = 120  # of tables where there is no terminal


def folder(given: Path | None, recording: Path, suffix: str = "") -> Path:
    """Return the folder to write to; it need not exist yet.

    Parameters
    ----------
    given : Path or None
        What ``--out`` says; without it ``imm-tdoa-out/<recording's name><suffix>``.
    recording : Path
        Folder that is read and must stay as it is.
    suffix : str
        Keeps what different commands make of one recording apart.

    Raises
    ------
    ValueError
        A folder inside the recording, or a file of that name.
    """
    recording = recording.resolve()
    out = Path("imm-tdoa-out") / f"{recording.name}{suffix}" if given is None else given
    place = out.resolve()
    if place == recording or recording in place.parents:
        raise ValueError(f"--out: {str(out)!r} lies inside the recording; give a folder elsewhere")
    refuse_taken(out)
    return out


def refuse_taken(out: Path) -> None:
    """Refuse to write into what is no folder, or into a recording.

    Parameters
    ----------
    out : Path
        What ``--out`` says.

    Raises
    ------
    ValueError
        It is a file, or holds a recording.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out: expected a folder, {str(out)!r} is a file")
    if (out / "recording.toml").exists():
        raise ValueError(f"--out: {str(out)!r} is a recording; give a folder elsewhere")


def file_name(target: str) -> str:
    """Return a target's name as part of a file's name."""
    return re.sub(r"[^\w.+-]", "_", target).lstrip(".") or "_"


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON, whole or not at all; numbers that are not finite become null."""
    with _atomic.file(path) as draft:
        text = json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False)
        draft.write_text(text + "\n", encoding="utf-8", newline="\n")


def write_table(path: Path, content: Columns) -> None:
    """Write a table as CSV, whole or not at all."""
    from imm_tdoa.recording import _csv

    with _atomic.file(path) as draft:
        _csv.write(draft, content)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def console() -> Console:
    """Return what prints to the user."""
    out = Console(highlight=False, soft_wrap=False)
    return out if out.is_terminal else Console(highlight=False, width=WIDTH)


def table(columns: Sequence[tuple[str, bool]], *, header: bool = True) -> Table:
    """Return an empty table; columns are (heading, is a number)."""
    result = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0), show_header=header)
    for heading, number in columns:
        result.add_column(Text(heading), justify="right" if number else "left", overflow="fold")
    return result


def heading(out: Console, text: str) -> None:
    """Print what comes next."""
    out.print(Text(text, style="bold"), soft_wrap=True)


def number(value: float | None, digits: int = 3) -> str:
    """Return a number as a table shows it, ``-`` where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    if value != 0.0 and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    places = max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0
    return f"{value:.{places}f}"


def written(out: Console, place: Path, files: Iterable[str]) -> None:
    """Say what was written where."""
    out.print(Text(f"\nwritten to {place}:  {', '.join(files)}"), soft_wrap=True)


@contextmanager
def progress(total: int | None) -> Iterator[Any]:
    """Show a progress bar on a terminal; yield ``advance(what comes next)``.

    Parameters
    ----------
    total : int or None
        Number of steps; None where it is not known.
    """
    err = Console(stderr=True)
    if not err.is_terminal:
        yield lambda _="": None
        return
    known = total if total is not None and total > 1 else None
    count = [MofNCompleteColumn()] if known else []
    columns = [TextColumn("{task.description}"), BarColumn(), *count, TimeElapsedColumn()]
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("", total=known)
        begun = False

        def advance(what: str = "") -> None:
            nonlocal begun
            bar.update(task, advance=1 if begun else 0, description=what)
            begun = True

        yield advance


def escaped(text: str) -> Text:
    """Return text that is printed as it is, brackets included."""
    return Text(text)
