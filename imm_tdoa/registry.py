"""Where models come from: the entry-point group ``imm_tdoa.models``, ours and strangers' alike."""

from __future__ import annotations

import difflib
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "imm_tdoa.models"


@cache
def _entries() -> dict[str, EntryPoint]:
    from importlib.metadata import entry_points

    entries: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        known = entries.setdefault(entry.name, entry)
        if known.value != entry.value:
            raise ValueError(
                f"two plug-ins provide the model {entry.name!r}: {known.value} and {entry.value}"
            )
    return entries


def names(kind: Literal["motion", "measurement"] | None = None) -> tuple[str, ...]:
    """Names of the registered models, sorted.

    Parameters
    ----------
    kind : "motion" or "measurement", optional
        Only models of this kind; default all.
    """
    found = sorted(_entries())
    return tuple(found if kind is None else [n for n in found if kind_of(load(n)) == kind])


def load(name: str) -> Any:
    """Return the model class registered under a name.

    Parameters
    ----------
    name : str
        As ``constant-velocity``; `names` lists them.

    Raises
    ------
    ValueError
        No plug-in provides it; the message lists what there is.
    """
    entries = _entries()
    if name not in entries:
        near = difflib.get_close_matches(name, entries, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ValueError(
            f"model: no plug-in provides {name!r}{hint}; there are: {', '.join(sorted(entries))}"
        )
    return entries[name].load()


def origin(name: str) -> str:
    """Return the distribution that provides a model.

    Parameters
    ----------
    name : str
        A registered name.
    """
    entry = _entries()[name]
    return entry.dist.name if entry.dist is not None else "?"


def kind_of(model: Any) -> Literal["motion", "measurement"]:
    """Tell a motion model (it has process noise) from a measurement model.

    Parameters
    ----------
    model : object
        A model or its class.

    Raises
    ------
    ValueError
        It is neither.
    """
    if hasattr(model, "process_noise"):
        return "motion"
    if hasattr(model, "noise_covariance"):
        return "measurement"
    raise ValueError(f"model: {model!r} has neither process_noise nor noise_covariance")


def name_of(model: object) -> str:
    """Return the registered name of a model's class, or its class name where it has none.

    Parameters
    ----------
    model : object
        A model.
    """
    cls = type(model)
    for name, entry in _entries().items():
        if entry.attr == cls.__name__ and entry.load() is cls:
            return name
    return cls.__name__
