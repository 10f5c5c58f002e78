"""All that a tracker knows between two scans: one frozen value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.clutter import Clutter
from imm_tdoa.tracking.memory import Memory
from imm_tdoa.tracking.standing import Standing


@attrs.frozen(eq=False)
class Record:
    """The tracks after one scan, as their history needs them.

    Attributes
    ----------
    time : float
        Time of the scan, s.
    scan : int
        Its number.
    identity : (N,)
        Which tracks there were.
    means, covariances : tuple of (N, n_j), (N, n_j, n_j)
        Each mode.
    log_mode_probability, mode_log_likelihood, mode_nis : (N, r)
        As in `State` and `Taken`.
    log_likelihood, nis : (N,)
        As in `State`; of rows that were weighed, `nis` is that of what they are believed to be.
    nis_dof : (N,)
        Its degrees of freedom.
    members : (N, m)
        Which value of the scan each row took, or took most of; -1 none.
    share : (N, m)
        How much of its rows it took: 1, or less where values were weighed; NaN is nothing.
    lost, reopened : (N,)
        As in `Trust` and `Taken`.
    """

    time: float
    scan: int
    identity: Index
    means: tuple[Array, ...]
    covariances: tuple[Array, ...]
    log_mode_probability: Array
    log_likelihood: Array
    nis: Array
    nis_dof: Index
    mode_log_likelihood: Array
    mode_nis: Array
    members: Index
    share: Array
    lost: Mask
    reopened: Mask

    @classmethod
    def of(
        cls, time: float, scan: int, identity: Index, state: State, members: Index, share: Array
    ) -> Record:
        """Return the record of `state`."""
        taken = state.taken
        N, r = state.log_mode_probability.shape
        return cls(
            time=float(time),
            scan=scan,
            identity=identity,
            means=state.means,
            covariances=state.covariances,
            log_mode_probability=state.log_mode_probability,
            log_likelihood=state.log_likelihood,
            nis=np.broadcast_to(taken.nis, (N,)),
            nis_dof=np.broadcast_to(taken.nis_dof, (N,)),
            mode_log_likelihood=np.broadcast_to(taken.mode_log_likelihood, (N, r)),
            mode_nis=np.broadcast_to(taken.mode_nis, (N, r)),
            members=members,
            share=share,
            lost=np.broadcast_to(state.trust.lost, (N,)),
            reopened=np.broadcast_to(taken.reopened, (N,)),
        )

    def part(self, which: Mask) -> Record:
        """Return it for some of the tracks."""

        def some(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(v[which] for v in value)
            return value[which] if isinstance(value, np.ndarray) else value

        names = (field.name for field in attrs.fields(Record))
        return Record(**{name: some(getattr(self, name)) for name in names})


@attrs.frozen
class Ended:
    """A confirmed track that has ended.

    Attributes
    ----------
    identity, number : int
        Which; its place among all that began, and among the confirmed.
    time : float
        When, s.
    heard : float
        When it last took any row, s.
    reason : str
        Why.
    """

    identity: int
    number: int
    time: float
    heard: float
    reason: str


@attrs.frozen
class Confirmed:
    """A track that was confirmed.

    Attributes
    ----------
    identity, number : int
        Its place among all tracks that began, and among the confirmed: its name.
    born, time : float
        When it began, and when it was confirmed, s.
    scan : int
        The scan that confirmed it.
    """

    identity: int
    number: int
    born: float
    time: float
    scan: int


@attrs.frozen(eq=False)
class Scene:
    """The whole state of a tracker.

    Attributes
    ----------
    time : float
        Time of the last scan, s; -inf before the first.
    scans : int
        Scans seen.
    begun : int
        Tracks begun so far; no identity is ever used again.
    state : State
        Their states, a batch (N,).
    identity, confirmed, settled : (N,)
        Which tracks they are, which are confirmed, and which of these are beyond doubt.
    standing : Standing
        How they have done.
    memory : Memory
        Candidate fixes that no track has come from yet.
    clutter : Clutter
        How dense false values are.
    usual : float
        How many rows a scan usually has.
    records : tuple of Record
        One per scan.
    confirmations, endings : tuple
        Every track that was confirmed, and those of them that have ended.
    rejected : mapping of str to int
        Tracks on trial that were given up, by reason.
    ignored : mapping of str to int
        What was ignored, by reason.
    given, refused : int
        Values of all scans so far, and those of them that could not be used.
    """

    time: float
    scans: int
    begun: int
    state: State
    identity: Index
    confirmed: Mask
    settled: Mask
    standing: Standing
    memory: Memory
    clutter: Clutter
    usual: float
    records: tuple[Record, ...] = ()
    confirmations: tuple[Confirmed, ...] = ()
    endings: tuple[Ended, ...] = ()
    rejected: Mapping[str, int] = attrs.field(factory=dict)
    ignored: Mapping[str, int] = attrs.field(factory=dict)
    given: int = 0
    refused: int = 0

    @classmethod
    def empty(cls, imm: IMM) -> Scene:
        """Nothing has been seen yet."""
        d, m = imm.measurement.dims, imm.measurement.size
        one = imm.start(np.zeros(1), np.zeros((1, d)), np.eye(d)[None])
        return cls(
            time=-np.inf,
            scans=0,
            begun=0,
            state=batches.select(batches.whole(one), slice(0, 0)),
            identity=np.zeros(0, dtype=np.int64),
            confirmed=np.zeros(0, dtype=bool),
            settled=np.zeros(0, dtype=bool),
            standing=Standing.none(m),
            memory=Memory.none(d, m),
            clutter=Clutter.none(m),
            usual=0.0,
        )

    def refusing(self, rows: Mapping[str, int], given: int) -> Scene:
        """Return it with `given` more values, of which some could not be used, by reason."""
        return attrs.evolve(
            self,
            ignored=counted(self.ignored, rows),
            given=self.given + given,
            refused=self.refused + sum(rows.values()),
        )

    @property
    def taken(self) -> int:
        """Values that confirmed tracks took, each counted once."""
        known = np.array([c.identity for c in self.confirmations], dtype=np.int64)
        count = 0
        for record in self.records:
            own = record.members[np.isin(record.identity, known)]
            count += len(np.unique(own[own >= 0]))
        return count

    @property
    def numbers(self) -> dict[int, int]:
        """The number of every confirmed track by its identity."""
        return {c.identity: c.number for c in self.confirmations}


def counted(counts: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    """Return counts by reason with some more."""
    result = dict(counts)
    for reason, count in more.items():
        if count:
            result[reason] = result.get(reason, 0) + int(count)
    return result
