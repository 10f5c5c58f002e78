"""What the commands about a recording share: which one, and which targets of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imm_tdoa.recording import Recording


@contextmanager
def folder(recording: Path | None) -> Iterator[Path]:
    """The recording's folder, or that of the shipped sample."""
    if recording is not None:
        yield recording
        return
    with resources.as_file(resources.files("imm_tdoa").joinpath("sample")) as place:
        yield place


def targets(data: Recording, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """Return the targets wanted, all without a wish, or say that one does not exist."""
    for name in wanted or ():
        if name not in data.targets:
            shown = ", ".join(data.targets[:10]) + (", …" if len(data.targets) > 10 else "")
            raise ValueError(f"--target: no target {name!r} in the recording; there are: {shown}")
    return tuple(dict.fromkeys(wanted)) if wanted else data.targets


def refuse_without_any(failed: Mapping[str, str], done: str) -> None:
    """Say that no target could be `done` (a participle), and why the first one could not."""
    name, reason = next(iter(failed.items()))
    more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
    raise ValueError(f"no target can be {done}: target {name!r}: {reason}{more}")
