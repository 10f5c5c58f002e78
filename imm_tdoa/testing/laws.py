"""What a law is, and how its breach is told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs


class ViolationError(Exception):
    """A law does not hold for the values drawn; the message says by how much."""


@attrs.frozen
class Law:
    """One thing that every model of a kind must obey.

    Attributes
    ----------
    name : str
        Short name, as reports and the argument `without` use it.
    statement : str
        The law in one line, with its equation.
    holds : callable
        ``holds(subject, draw)`` draws values, and raises `ViolationError` where the law is broken.
    exempt : callable
        ``exempt(subject)`` returns why the law does not apply to a model, or an empty string.
    gate : bool
        Whether the laws after this one make no sense for a model that breaks it.
    """

    name: str
    statement: str
    holds: Callable[[Any, Any], None]
    exempt: Callable[[Any], str]
    gate: bool = False


@attrs.frozen
class BrokenLaw:
    """A law that a model breaks.

    Attributes
    ----------
    law : str
        Its name.
    statement : str
        What it demands.
    message : str
        What was found instead, and for which values.
    """

    law: str
    statement: str
    message: str

    def __str__(self) -> str:
        found = self.message.replace("\n", "\n      ")
        return f"  {self.law}: {self.statement}\n      {found}"


@attrs.frozen
class Verdict:
    """What became of one law for one model.

    Attributes
    ----------
    law, statement : str
        The law.
    outcome : str
        ``"holds"``, ``"broken"``, ``"exempt"`` (the law does not apply to this model) or
        ``"not tried"`` (an earlier law, without which it makes no sense, is broken).
    message : str
        What was found, or why the law was not tried; empty where it holds.
    """

    law: str
    statement: str
    outcome: str
    message: str = ""


def always(subject: Any) -> str:
    """Exempt nobody."""
    return ""


def law(
    name: str,
    statement: str,
    *,
    exempt: Callable[[Any], str] = always,
    gate: bool = False,
) -> Callable[[Callable[[Any, Any], None]], Law]:
    """Turn a function ``holds(subject, draw)`` into a `Law`."""

    def decorate(holds: Callable[[Any, Any], None]) -> Law:
        return Law(name, statement, holds, exempt, gate)

    return decorate
