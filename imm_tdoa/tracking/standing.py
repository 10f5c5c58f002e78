"""What a track's past says for and against it, target by target, in arrays (N,)."""

from __future__ import annotations

from typing import Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, Mask

REMEMBERED = 60  # scans whose hits are kept, as bits
WINDOW = 30  # scans over which rivals are compared
RECENT = 5  # scans over which values shared with others are remembered
TOLD = 20  # scans of which it is known which values a track had
UNKNOWN = -2  # in place of a value: nobody knows
MANY = 1 << 32  # more values than any scan has


@attrs.frozen(eq=False)
class Standing:
    """How N tracks have done so far.

    Attributes
    ----------
    log_ratio : (N,)
        Log of how much likelier its rows are from a target than false, since it began.
    hits : (N,) int
        One bit per scan in which it could be heard, newest lowest: whether it was.
    chances : (N,) int
        Number of those scans.
    born, heard : (N,)
        When it began, and when it last took any row, s.
    gains, merits : (N, W)
        Log-ratio and merit of each of the last scans, newest first; NaN where not known.
    values : (N, RECENT m)
        The values it took in the last scans, each with a number of its own; -1 none.
    own : (N, TOLD, m)
        Index in its scan of the value that each row had, newest first; -1 none, -2 not known.
    spare : (N,)
        Rows it took beyond as many as a position takes, summed over its hits.
    time : float
        Now, s.
    """

    log_ratio: Array
    hits: Index
    chances: Index
    born: Array
    heard: Array
    gains: Array
    merits: Array
    values: Index
    own: Index
    spare: Array
    time: float

    @classmethod
    def new(
        cls,
        log_ratio: Array,
        gains: Array,
        merits: Array,
        members: Index,
        scan: int,
        dims: int,
        time: float,
        past: Index | None = None,
    ) -> Standing:
        """Tracks that begin now, heard now, with what led to them; `past` as `own`, if known."""
        spare = np.count_nonzero(members >= 0, axis=1) - float(dims)
        count = len(gains)
        one = np.ones(count, dtype=np.int64)
        now = np.full(count, float(time))
        none = np.full((count, (RECENT - 1) * members.shape[1]), -1, dtype=np.int64)
        values = np.concatenate([_numbered(members, scan), none], axis=1)
        own = np.full((count, TOLD, members.shape[1]), UNKNOWN, dtype=np.int64)
        own = own if past is None else past.copy()
        own[:, 0] = members
        since = one, one.copy(), now, now.copy()
        return cls(log_ratio, *since, gains, merits, values, own, spare, float(time))

    @classmethod
    def none(cls, size: int) -> Standing:
        """No tracks, of a measurement of `size` rows."""
        nothing = np.zeros((0, size), dtype=np.int64)
        return cls.new(
            np.zeros(0), np.zeros((0, WINDOW)), np.zeros((0, WINDOW)), nothing, 0, 1, -np.inf
        )

    def part(self, which: Any) -> Standing:
        """Return some of the tracks."""
        arrays: dict[str, Any] = {name: getattr(self, name)[which] for name in _ARRAYS}
        return Standing(**arrays, time=self.time)

    @classmethod
    def joined(cls, a: Standing, b: Standing) -> Standing:
        """Return the tracks of both."""
        arrays = {n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in _ARRAYS}
        return cls(**arrays, time=b.time)

    def after(
        self,
        time: float,
        scan: int,
        chance: Mask,
        hit: Mask,
        any_row: Mask,
        gain: Array,
        worth: Array,
        members: Index,
        spare: Array,
    ) -> Standing:
        """Return it after a scan at which the tracks had a `chance` (N,) and were hit, or not."""
        kept = self.values[:, : (RECENT - 1) * members.shape[1]]
        keep = np.int64((1 << REMEMBERED) - 1)
        hits = np.where(chance, ((self.hits << 1) | hit) & keep, self.hits)
        return Standing(
            self.log_ratio + gain,
            hits,
            self.chances + chance,
            self.born,
            np.where(any_row, time, self.heard),
            np.concatenate([gain[:, None], self.gains[:, :-1]], axis=1),
            np.concatenate([worth[:, None], self.merits[:, :-1]], axis=1),
            np.concatenate([_numbered(members, scan), kept], axis=1),
            np.concatenate([members[:, None], self.own[:, :-1]], axis=1),
            self.spare + np.where(hit, spare, 0.0),
            float(time),
        )

    @property
    def age(self) -> Index:
        """Scans (N,) since the first that it began from, that one included."""
        there = np.isfinite(self.gains)
        first = self.gains.shape[1] - np.argmax(there[:, ::-1], axis=1)
        return np.where(there.any(axis=1), first, 0).astype(np.int64)

    @property
    def redundant(self) -> Array:
        """Mean number (N,) of rows beyond need in the scans that hit it."""
        result: Array = self.spare / np.maximum(np.bitwise_count(self.hits), 1)
        return result

    def hits_in(self, scans: int) -> Index:
        """Number of hits (N,) in the last `scans` scans in which they could be heard."""
        window = self.hits & np.int64((1 << min(scans, REMEMBERED)) - 1)
        count: Index = np.bitwise_count(window).astype(np.int64)
        return count


_ARRAYS = (
    "log_ratio",
    "hits",
    "chances",
    "born",
    "heard",
    "gains",
    "merits",
    "values",
    "own",
    "spare",
)


def _numbered(members: Index, scan: int) -> Index:
    """Numbers (N, m) that values have in no other scan."""
    return np.where(members >= 0, members + scan * MANY, -1)


class Verdict(NamedTuple):
    """What becomes of N tracks.

    Attributes
    ----------
    confirm : (N,) bool
        Tracks on trial that are real.
    end : (N,) str
        Why a track ends; empty where it does not.
    """

    confirm: Mask
    end: Any

    @classmethod
    def of(cls, confirm: Mask, *ends: tuple[Mask, str]) -> Verdict:
        """Return the verdict; the first reason that holds is given."""
        why = np.full(len(confirm), "", dtype=object)
        for mask, reason in ends:
            why[mask & (why == "")] = reason
        return cls(confirm & (why == ""), why)
