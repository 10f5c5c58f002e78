"""A track that has rejected scans for too long opens again, instead of drifting confidently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.statespace import KIND_OF, StateSpace


def widen(
    covariances: Sequence[Array],
    mode: Sequence[int],
    space: StateSpace,
    birth_std: Mapping[str, float],
    elapsed: Array,
) -> list[Array]:
    """Return the predictions' covariances with what may have happened unseen.

    Since the last scan that was taken in, `elapsed` (...) s ago, the emitter may have begun any
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
