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
    """Give the recording's folder, or that of the shipped sample.

    Parameters
    ----------
    recording : Path or None
        What the command line says.

    Raises
    ------
    ValueError
        It is a scenario's name, of which no recording has been made.
    """
    if recording is not None:
        if not recording.exists():
            _refuse_scenario(str(recording))
        yield recording
        return
    with resources.as_file(resources.files("imm_tdoa").joinpath("sample")) as place:
        yield place


def _refuse_scenario(name: str) -> None:
    from imm_tdoa.simulate import scenarios

    if name in scenarios():
        raise ValueError(
            f"folder: there is none called {name!r}, but a scenario; "
            f"imm-tdoa simulate {name} --out {name} makes a recording of it"
        )


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
