"""What a tracker remembers of the last scans: their rows, and fixes that no track came from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.tracking.rows import Unlabelled

if TYPE_CHECKING:
    from imm_tdoa.tracking.candidates import Candidates

STRANGERS = 30  # fixes of messages that are remembered to tell how dense emitters are


@attrs.frozen(eq=False)
class Heard:
    """The rows of one scan that no settled track took, internal units.

    Attributes
    ----------
    time : float
        Time, s.
    scan : int
        Its number.
    values, row : (K,)
        As in `Unlabelled`.
    density : (m,)
        Density of false values then.
    emission : (K,), optional
        As in `Unlabelled`.
    """

    time: float
    scan: int
    values: Array
    row: Index
    density: Array
    emission: Any = None

    @property
    def rows(self) -> Unlabelled:
        """The rows."""
        return Unlabelled(self.values, self.row, emission=self.emission)


@attrs.frozen(eq=False)
class Memory:
    """Candidate fixes of the last scans, to which no track has led yet.

    Attributes
    ----------
    time, scan : (F,)
        When each was made, s, and in which scan.
    position, covariance : (F, d), (F, d, d)
        The fixes.
    members : (F, m)
        Which value of its scan each row had; -1 none.
    log_odds : (F,)
        How much likelier its values were from one emitter than false.
    merit : (F,)
        How well it explained them.
    heard : tuple of Heard
        The rows of those scans, where tracks that begin are to be led back through them.
    thin : tuple of Heard
        The rows of scans too thin for a fix that no track took.
    strangers : (S, d)
        The last fixes of messages that no track took, however old.
    """

    time: Array
    scan: Index
    position: Array
    covariance: Array
    members: Index
    log_odds: Array
    merit: Array
    heard: tuple[Heard, ...] = ()
    thin: tuple[Heard, ...] = ()
    strangers: Array = attrs.field()

    @strangers.default
    def _none_yet(self) -> Array:
        return np.zeros((0, self.dims))

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return int(self.position.shape[1])

    @classmethod
    def none(cls, dims: int, size: int) -> Memory:
        """No fixes."""
        empty = np.zeros(0)
        place, covariance = np.zeros((0, dims)), np.zeros((0, dims, dims))
        nobody = np.zeros((0, size), dtype=np.int64)
        return cls(empty, empty.astype(np.int64), place, covariance, nobody, empty, empty)

    def with_fixes(self, found: Candidates, time: float, scan: int) -> Memory:
        """Return it with the candidates of a scan."""
        F = len(found.position)
        return Memory(
            np.concatenate([self.time, np.full(F, time)]),
            np.concatenate([self.scan, np.full(F, scan)]),
            np.concatenate([self.position, found.position]),
            np.concatenate([self.covariance, found.covariance]),
            np.concatenate([self.members, found.members]),
            np.concatenate([self.log_odds, found.log_odds]),
            np.concatenate([self.merit, found.merit]),
            self.heard,
            self.thin,
            self.strangers,
        )

    def with_strangers(self, found: Candidates) -> Memory:
        """Return it with the fixes of messages of a scan."""
        places = np.concatenate([self.strangers, found.position])
        return attrs.evolve(self, strangers=places[-STRANGERS:])

    def part(self, which: Any) -> Memory:
        """Return some of the fixes."""
        names = ("time", "scan", "position", "covariance", "members", "log_odds", "merit")
        return attrs.evolve(self, **{name: getattr(self, name)[which] for name in names})
