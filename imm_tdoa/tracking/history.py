"""From the records of a scene to the track of every target, and one of them now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import attrs
import numpy as np

from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Index
from imm_tdoa.statespace import StateSpace
from imm_tdoa.track import Track
from imm_tdoa.tracking.scene import Record, Scene


def build(scene: Scene, bank: Bank, update: str) -> dict[str, Track]:
    """Return the history of every confirmed track by name."""
    if not scene.confirmations:
        return {}
    pieces = Pieces.of(scene.records)
    order = np.argsort(pieces.identity, kind="stable")
    pieces = pieces.part(order)
    result = {}
    for c in scene.confirmations:
        first, last = np.searchsorted(pieces.identity, [c.identity, c.identity + 1])
        own = pieces.part(slice(int(first), int(last)))
        result[str(c.number)] = as_track(own, bank, scene.state.space, update)
    return result


@attrs.frozen(eq=False)
class Pieces:
    """Rows of many tracks, one after the other (R, ...)."""

    time: Array
    identity: Index
    means: tuple[Array, ...]
    covariances: tuple[Array, ...]
    fields: dict[str, Any]

    FIELDS: ClassVar[tuple[str, ...]] = (
        "log_mode_probability",
        "log_likelihood",
        "nis",
        "nis_dof",
        "mode_log_likelihood",
        "mode_nis",
        "share",
        "lost",
        "reopened",
    )

    @classmethod
    def of(cls, records: Sequence[Any]) -> Pieces:
        """Join the rows of records."""
        r = len(records[0].means)
        return cls(
            np.concatenate([np.full(len(k.identity), k.time) for k in records]),
            np.concatenate([k.identity for k in records]),
            tuple(np.concatenate([k.means[j] for k in records]) for j in range(r)),
            tuple(np.concatenate([k.covariances[j] for k in records]) for j in range(r)),
            {n: np.concatenate([getattr(k, n) for k in records]) for n in cls.FIELDS},
        )

    @classmethod
    def none(cls, scene: Scene) -> Pieces:
        """No rows at all."""
        state = scene.state
        m = state.taken.row_weight.shape[-1]
        empty = np.zeros((0, m))
        record = Record.of(0.0, 0, scene.identity[:0], state, empty.astype(np.int64), empty)
        return cls.of([record]).each()

    def part(self, which: Any) -> Pieces:
        """Return some of the rows."""
        return Pieces(
            self.time[which],
            self.identity[which],
            tuple(x[which] for x in self.means),
            tuple(P[which] for P in self.covariances),
            {n: a[which] for n, a in self.fields.items()},
        )

    def each(self) -> Pieces:
        """Return every row as a track of its own: (R, 1, ...)."""
        return self.part((slice(None), None))


def as_track(pieces: Pieces, bank: Bank, space: StateSpace, update: str) -> Track:
    """Return rows of one target as its track."""
    f = pieces.fields
    return Track(
        times=pieces.time,
        log_mode_probability=f["log_mode_probability"],
        log_likelihood=f["log_likelihood"],
        nis=f["nis"],
        nis_dof=f["nis_dof"],
        mode_log_likelihood=f["mode_log_likelihood"],
        mode_nis=f["mode_nis"],
        mode_means=pieces.means,
        mode_covariances=pieces.covariances,
        row_weight=f["share"],
        lost=f["lost"],
        reopened=f["reopened"],
        bank=bank,
        space=space,
        modes=bank.names,
        update=update,
    )
