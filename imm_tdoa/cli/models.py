"""``imm-tdoa models``: what there is, and whether it obeys the laws."""

from __future__ import annotations

import inspect
import re
from typing import Annotated, Any

import attrs
import typer
from rich.text import Text

from imm_tdoa.cli import output

OUTCOME = {"holds": "holds", "broken": "BROKEN", "exempt": "exempt", "not tried": "not tried"}


@attrs.frozen
class Entry:
    """A registered model: its class, or why it cannot be loaded."""

    name: str
    package: str
    model: Any = None
    error: str = ""

    @property
    def kind(self) -> str:
        """Whether it is a motion or a measurement model."""
        from imm_tdoa import registry

        try:
            return "-" if self.model is None else registry.kind_of(self.model)
        except ValueError:
            return "neither"


def models(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]...", help="These models alone; default all.", show_default=False
        ),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Try every model on the laws filters rely on.")
    ] = False,
) -> None:
    """List all motion and measurement models, those of other packages too.

    A model becomes one of them by an entry point of the group `imm_tdoa.models`. Its author asks
    what is wrong with it by

        imm-tdoa models my-model --check

    which prints every law in words, for a broken one the simplest values that break it, and
    returns 1 if a law is broken. Without a name every model is tried, and the laws of those that
    break one are printed.
    """
    entries = _chosen(_entries(), names or [])
    out = output.console()
    table = output.table(
        [("name", False), ("kind", False), ("package", False), ("parameters", False), ("", False)],
    )
    for entry in entries:
        about = entry.error or _first_line(entry.model)
        cells = (entry.name, entry.kind, entry.package, _parameters(entry.model), about)
        table.add_row(*(Text(cell) for cell in cells))
    out.print(table)
    if check and not _check(entries, out, in_full=bool(names)):
        raise typer.Exit(1)


def _entries() -> list[Entry]:
    from imm_tdoa import registry

    entries = []
    for name in registry.names():
        package = registry.origin(name)
        try:
            entries.append(Entry(name, package, registry.load(name)))
        except Exception as error:  # a stranger's plug-in may fail in any way; the others go on
            reason = f"cannot be loaded: {type(error).__name__}: {error}"
            entries.append(Entry(name, package, error=reason))
    return sorted(entries, key=lambda e: ({"motion": 0, "measurement": 1}.get(e.kind, 2), e.name))


def _chosen(entries: list[Entry], names: list[str]) -> list[Entry]:
    from imm_tdoa import _structure

    known = [entry.name for entry in entries]
    for name in names:
        if name not in known:
            hint = _structure.near(name, known)
            raise ValueError(f"there is no model {name!r}{hint}; there are: {', '.join(known)}")
    return [entry for entry in entries if not names or entry.name in names]


def _parameters(model: Any) -> str:
    if model is None:
        return "-"
    parameters = inspect.signature(model).parameters.values()
    return ", ".join(f"*{p.name}" if p.kind is p.VAR_POSITIONAL else p.name for p in parameters)


def _first_line(model: Any) -> str:
    """What the model says of itself, without the section of the specification it cites."""
    line = next(iter((inspect.getdoc(model) or "").splitlines()), "")
    return re.sub(r" \((ALGORITHMS )?§[^)]*\)", "", line)


def _check(entries: list[Entry], out: Any, in_full: bool) -> bool:
    """Print each model's laws, or in a line that all hold; return whether they do for all."""
    from imm_tdoa import testing

    faulty: list[str] = []
    found: list[tuple[Entry, list[testing.Verdict], str]] = []
    with output.progress(len(entries)) as advance:
        for entry in entries:
            advance(f"checking {entry.name}")
            if entry.model is None:
                found.append((entry, [], entry.error))
                continue
            try:
                found.append((entry, testing.verdicts(testing.specimen(entry.model)), ""))
            except Exception as error:  # likewise: told as this model's fault
                found.append((entry, [], f"cannot be tried: {type(error).__name__}: {error}"))
    out.print()
    for entry, verdicts, reason in found:
        broken = sum(v.outcome == "broken" for v in verdicts)
        if broken or reason:
            faulty.append(entry.name)
        held = sum(v.outcome == "holds" for v in verdicts)
        summary = reason or (f"{broken} laws BROKEN" if broken else f"all {held} laws hold")
        output.heading(out, f"{entry.name}: {summary}")
        if not (in_full or broken):
            continue
        table = output.table([("law", False)] * 3, header=False)
        for v in verdicts:
            told = v.statement if v.outcome == "holds" else f"{v.statement}\n{v.message}"
            style = "bold red" if v.outcome == "broken" else None
            outcome = Text(OUTCOME.get(v.outcome, v.outcome), style=style or "")
            table.add_row(Text(v.law), outcome, Text(told), style=style)
        out.print(table)
        out.print()
    sound = len(entries) - len(faulty)
    whose = f"; not {', '.join(faulty)}" if faulty else ""
    output.heading(out, f"\n{sound} of {len(entries)} models keep every law{whose}")
    return not faulty
