"""How tracks begin: what anything that begins them is given, and what it returns."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.tracking.memory import Heard, Memory
from imm_tdoa.tracking.standing import TOLD, UNKNOWN, WINDOW


class Births(NamedTuple):
    """Tracks that begin.

    Attributes
    ----------
    state : State or None
        Their states (B,) after the scan; None for none.
    members : (B, m)
        Which value of the scan each row was begun from; -1 none.
    log_ratio : (B,)
        Log of how much likelier the values of its fixes are from a target than false.
    gains, merits : (B, W)
        Log-ratio and merit of each of the last scans, newest first; NaN where not known.
    past : (B, TOLD, m)
        Which values they had, as in `Standing.own`.
    memory : Memory
        What to remember for the next scans.
    ignored : mapping of str to int
        What was left out, by reason.
    """

    state: State | None
    members: Index
    log_ratio: Array
    gains: Array
    merits: Array
    past: Index
    memory: Memory
    ignored: dict[str, int]

    @classmethod
    def none(cls, size: int, memory: Memory, ignored: dict[str, int]) -> Births:
        """Nobody begins, of a measurement of `size` rows."""
        nobody = np.zeros((0, size), dtype=np.int64)
        gains, past = unknown(0, size)
        return cls(None, nobody, np.zeros(0), gains, gains, past, memory, ignored)


@runtime_checkable
class Initiation(Protocol):
    """Anything that begins tracks from rows that no confirmed target took."""

    def __call__(self, imm: IMM, now: Heard, memory: Memory, known: Index) -> Births:
        """Return the tracks that begin at a scan.

        `now` holds the rows (K,) of the scan that no confirmed target took, the others being
        NaN; `known` (N, m) says which of its values the tracks on trial took: a fix of just
        these begins no other.
        """
        ...


def unknown(count: int, size: int) -> tuple[Array, Index]:
    """Gains (B, W) of tracks of which nothing is known yet, and values (B, TOLD, m) they had."""
    return np.full((count, WINDOW), np.nan), np.full((count, TOLD, size), UNKNOWN, dtype=np.int64)


def no_others(members: Index, known: Index) -> Index:
    """Which candidates (F,) do not hold just values that one track on trial took."""
    if not len(members) or not len(known):
        return np.arange(len(members))
    same = (members[:, None] == known[None]) | (members < 0)[:, None]
    return np.flatnonzero(~same.all(axis=-1).any(axis=-1))
