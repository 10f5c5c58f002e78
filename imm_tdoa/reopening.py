"""A track that has rejected scans for too long opens again, instead of drifting confidently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.statespace import KIND_OF, StateSpace


@attrs.frozen(eq=False)
class Trust:
    """Whether a track still knows where it is, by how it could use the last scans.

    After so many rejected scans on end a track is lost; after as many on end that it could use
    it is found again. Until then what it took in may have been as wrong as the rest.

    Attributes
    ----------
    rejected, used : (...)
        Scans rejected, or used, one after the other until now.
    lost : (...)
        Whether the track is lost.
    since : (...)
        Time of the last scan used while it was not, s.
    """

    rejected: Index
    used: Index
    lost: Mask
    since: Array

    @classmethod
    def full(cls, batch: tuple[int, ...], time: Array) -> Trust:
        """Trust in a track that begins."""
        none = np.zeros(batch, dtype=np.int64)
        return cls(none, none, np.zeros(batch, dtype=bool), np.broadcast_to(time, batch))

    def unseen(self, time: Array) -> Array:
        """How long (...) nothing that can be trusted was seen, s; 0 unless the track must widen."""
        return np.where(self.lost & (self.rejected > 0), time - self.since, 0.0)

    def after(self, heard: Mask, rejected: Mask, time: Array, patience: int) -> Trust:
        """Trust after a scan at `time`, `heard` where there was one at all."""
        rejections = np.where(heard, np.where(rejected, self.rejected + 1, 0), self.rejected)
        used = np.where(heard, np.where(rejected, 0, self.used + 1), self.used)
        lost = (self.lost & (used < patience)) | (rejections >= patience)
        since = np.where(heard & ~rejected & ~lost, time, self.since)
        return Trust(rejections, used, lost, since)


def widen(
    covariances: Sequence[Array],
    mode: Sequence[int],
    space: StateSpace,
    birth_std: Mapping[str, float],
    elapsed: Array,
) -> list[Array]:
    """Return the predictions' covariances with what may have happened unseen.

    Since the last scan that can be trusted, `elapsed` (...) s ago, the emitter may have begun any
    motion that the birth law allows: velocity, acceleration and turn rate get its variance, the
    position what the birth velocity reaches in that time. Where `elapsed` is 0 nothing changes.
    """
    if not np.any(elapsed > 0.0):
        return list(covariances)
    reach = birth_std.get("velocity", 0.0)
    result = []
    for P, j in zip(covariances, mode, strict=True):
        variance = np.stack(
            [
                (reach * elapsed) ** 2
                if KIND_OF.get(name) == "position"
                else np.where(elapsed > 0.0, _birth_std(name, birth_std) ** 2, 0.0)
                for name in space.modes[j]
            ],
            axis=-1,
        )
        result.append(P + variance[..., None] * np.eye(len(space.modes[j])))
    return result


def _birth_std(component: str, birth_std: Mapping[str, float]) -> float:
    """The component's birth standard deviation; none for a component of a kind of its own."""
    kind = KIND_OF.get(component, component)
    return birth_std.get(component, birth_std.get(kind, 0.0))
