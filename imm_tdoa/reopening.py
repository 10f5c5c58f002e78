"""A track that has rejected scans for too long opens again, instead of drifting confidently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs
import numpy as np

from imm_tdoa._brief import brief
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
    means, covariances, log_mode_probability
        The modes as they were then.
    """

    rejected: Index
    used: Index
    lost: Mask
    since: Array
    means: tuple[Array, ...]
    covariances: tuple[Array, ...]
    log_mode_probability: Array

    __repr__ = brief

    @classmethod
    def full(
        cls,
        time: Array,
        means: tuple[Array, ...],
        covariances: tuple[Array, ...],
        log_mode_probability: Array,
    ) -> Trust:
        """Trust in a track that begins."""
        batch = log_mode_probability.shape[:-1]
        none = np.zeros(batch, dtype=np.int64)
        lost = np.zeros(batch, dtype=bool)
        since = np.broadcast_to(time, batch)
        return cls(none, none, lost, since, means, covariances, log_mode_probability)

    @property
    def opens(self) -> Mask:
        """Where (...) the next scan is compared with what the last trusted state allows."""
        return self.lost & (self.rejected > 0)

    def after(
        self,
        heard: Mask,
        rejected: Mask,
        patience: int,
        time: Array,
        means: tuple[Array, ...],
        covariances: tuple[Array, ...],
        log_mode_probability: Array,
    ) -> Trust:
        """Trust after a scan, `heard` where it said anything, and the modes that it left."""
        rejections = np.where(heard, np.where(rejected, self.rejected + 1, 0), self.rejected)
        used = np.where(heard, np.where(rejected, 0, self.used + 1), self.used)
        lost = (self.lost & (used < patience)) | (rejections >= patience)
        good = heard & ~rejected & ~lost
        return Trust(
            rejections,
            used,
            lost,
            np.where(good, time, self.since),
            tuple(choose(good, a, b, 1) for a, b in zip(means, self.means, strict=True)),
            tuple(
                choose(good, a, b, 2) for a, b in zip(covariances, self.covariances, strict=True)
            ),
            choose(good, log_mode_probability, self.log_mode_probability, 1),
        )


def choose(where: Mask, new: Array, old: Array, trailing: int) -> Array:
    """Return `new` where (...) it holds, else `old`; neither is copied where it holds for all."""
    if np.all(where):
        return new
    if not np.any(where) and old.shape == new.shape:
        return old
    result: Array = np.where(where.reshape(where.shape + (1,) * trailing), new, old)
    return result


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
