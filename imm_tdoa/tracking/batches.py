"""States of several targets as one batch: some of them, more of them, none of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.state import State
from imm_tdoa.statespace import StateSpace

T = TypeVar("T")


def _each(change: Callable[..., Any], trees: Sequence[T]) -> T:
    """Apply `change` to the arrays at each place of objects that are alike."""
    first: Any = trees[0]
    if isinstance(first, np.ndarray | np.generic):
        return change(*trees)  # type: ignore[no-any-return]
    if isinstance(first, tuple):
        return tuple(_each(change, parts) for parts in zip(*trees, strict=True))  # type: ignore
    if attrs.has(type(first)) and not isinstance(first, StateSpace):
        parts = {
            field.name: _each(change, [getattr(tree, field.name) for tree in trees])
            for field in attrs.fields(type(first))
        }
        changed: Any = attrs.evolve(first, **parts)
        return changed  # type: ignore[no-any-return]
    return first  # type: ignore[no-any-return]


def select(state: State, index: Index | Mask | slice) -> State:
    """Return the state of some of the targets (N,)."""
    return _each(lambda a: a[index], [state])


def join(states: Sequence[State]) -> State:
    """Return the states of several batches of targets (N_i,) as one batch, in that order."""
    if len(states) == 1:
        return states[0]
    return _each(lambda *a: np.concatenate(a), states)


def put(state: State, index: Index, some: State) -> State:
    """Return the state with the targets at `index` replaced."""

    def change(a: Array, b: Array) -> Array:
        a = a.copy()
        a[index] = b
        return a

    return _each(change, [state, some])


def whole(state: State) -> State:
    """Return the state with the batch axis (N,) on every array, also where it was broadcast."""
    shape = state.log_likelihood.shape
    full = attrs.evolve(state, time=np.array(np.broadcast_to(state.time, shape)))
    since = np.array(np.broadcast_to(full.trust.since, shape))
    return attrs.evolve(full, trust=attrs.evolve(full.trust, since=since))
