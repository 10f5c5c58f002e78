"""How the states of different motion models fit together, component by component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs
import numpy as np

from imm_tdoa._brief import brief
from imm_tdoa.contract import AXES, KINDS, Array, Index, MotionModel, component_names

KIND_OF: dict[str, str] = {
    **{
        name: kind
        for kind, order in zip(KINDS, range(3), strict=True)
        for name in component_names(3, order)[-3:]
    },
    "omega": "turn_rate",
}


@attrs.frozen(eq=False)
class Lift:
    """The map from one mode's state into another's, by component name (ALGORITHMS §9.3).

    Attributes
    ----------
    source, target : (c,) int
        Indices of the components both have, in the source and in the target.
    missing : (e,) int
        Indices in the target of components the source does not have.
    birth_variance : (e,)
        Variance of each missing component under the birth law.
    identity : bool
        Whether both states are the same, component by component.
    """

    source: Index
    target: Index
    missing: Index
    birth_variance: Array
    identity: bool


@attrs.frozen(eq=False)
class StateSpace:
    """Components of a bank's modes in a given number of space dimensions.

    Attributes
    ----------
    dims : int
        Space dimensions d.
    components : tuple of str
        The union of all modes' components: positions, velocities, accelerations, others.
    modes : tuple of tuple of str
        Each mode's own components.
    position, velocity : tuple of (d,) or (0,) int
        Where each mode keeps its position and velocity; empty where it has no velocity.
    lifts : tuple of tuple of Lift
        ``lifts[i][j]`` takes mode i's state to mode j's.
    to_union : tuple of Lift
        Takes each mode's state to the union.
    """

    dims: int
    components: tuple[str, ...]
    modes: tuple[tuple[str, ...], ...]
    position: tuple[Index, ...] = attrs.field(repr=False)
    velocity: tuple[Index, ...] = attrs.field(repr=False)
    lifts: tuple[tuple[Lift, ...], ...] = attrs.field(repr=False)
    to_union: tuple[Lift, ...] = attrs.field(repr=False)

    __repr__ = brief


def state_space(
    models: Sequence[MotionModel],
    names: Sequence[str],
    dims: int,
    birth_std: Mapping[str, float],
) -> StateSpace:
    """Match the models' components by name.

    Parameters
    ----------
    models : sequence of MotionModel
        One per mode.
    names : sequence of str
        What messages call the modes.
    dims : int
        Space dimensions d.
    birth_std : mapping of str to float
        Standard deviations of components that a mode lacks, by name or by kind.

    Raises
    ------
    ValueError
        A model lacks a position component, has only part of a velocity, repeats a name, or has
        a component that another lacks and that no birth standard deviation covers.
    """
    modes = tuple(tuple(model.components(dims)) for model in models)
    for name, components in zip(names, modes, strict=True):
        _check_components(name, components, dims)
    every = dict.fromkeys(c for components in modes for c in components)
    order = {c: i for i, c in enumerate(component_names(3, 2))}
    union = tuple(sorted(every, key=lambda c: order.get(c, len(order))))
    velocity = component_names(dims, 1)[dims:]
    return StateSpace(
        dims=dims,
        components=union,
        modes=modes,
        position=tuple(_indices(m, AXES[:dims]) for m in modes),
        velocity=tuple(_indices(m, velocity if velocity[0] in m else ()) for m in modes),
        lifts=tuple(tuple(lift(i, j, birth_std) for j in modes) for i in modes),
        to_union=tuple(lift(i, union, birth_std) for i in modes),
    )


def lift(source: Sequence[str], target: Sequence[str], birth_std: Mapping[str, float]) -> Lift:
    """Return the map from a state with components `source` to one with `target`.

    Parameters
    ----------
    source, target : sequence of str
        Names of the components.
    birth_std : mapping of str to float
        As of `state_space`.

    Raises
    ------
    ValueError
        No birth standard deviation covers a component that `source` lacks.
    """
    common = [c for c in target if c in source]
    missing = [c for c in target if c not in source]
    return Lift(
        source=_indices(source, common),
        target=_indices(target, common),
        missing=_indices(target, missing),
        birth_variance=np.array([_birth_std(c, birth_std) ** 2 for c in missing]),
        identity=tuple(source) == tuple(target),
    )


def apply_lift(
    lift: Lift, x: Array, P: Array, fill: tuple[Array, Array] | None
) -> tuple[Array, Array]:
    """Return a mode's mean (..., n) and covariance (..., n, n) in another mode's components.

    Components that the target lacks are marginalised; those it has in addition are independent
    of the rest, with mean and covariance from `fill` (..., n), (..., n, n), or under the birth
    law (mean zero) where `fill` is None.

    Parameters
    ----------
    lift : Lift
        From the one mode to the other.
    x, P : (..., n), (..., n, n)
        The mode's own Gaussian.
    fill : (..., k), (..., k, k) or None
        Mean and covariance of all k components of the target, of which those that the source
        lacks are taken.
    """
    if lift.identity:
        return x, P
    n = len(lift.target) + len(lift.missing)
    batch = x.shape[:-1]
    X, C = np.zeros((*batch, n)), np.zeros((*batch, n, n))
    X[..., lift.target] = x[..., lift.source]
    C[..., lift.target[:, None], lift.target] = P[..., lift.source[:, None], lift.source]
    e = lift.missing
    if fill is None:
        C[..., e, e] = lift.birth_variance
    else:
        X[..., e] = fill[0][..., e]
        C[..., e[:, None], e] = fill[1][..., e[:, None], e]
    return X, C


def _indices(components: Sequence[str], wanted: Sequence[str]) -> Index:
    return np.array([components.index(c) for c in wanted], dtype=np.int64)


def _check_components(name: str, components: tuple[str, ...], dims: int) -> None:
    if len(set(components)) != len(components):
        raise ValueError(f"mode {name!r}: a component name appears twice in {components}")
    lacking = [axis for axis in AXES[:dims] if axis not in components]
    if lacking:
        raise ValueError(
            f"mode {name!r}: expected position components {', '.join(AXES[:dims])}, "
            f"got {components}"
        )
    velocity = component_names(dims, 1)[dims:]
    if 0 < sum(v in components for v in velocity) < dims:
        raise ValueError(f"mode {name!r}: expected all of {velocity} or none, got {components}")


def _birth_std(component: str, birth_std: Mapping[str, float]) -> float:
    for key in (component, KIND_OF.get(component, component)):
        if key in birth_std:
            return birth_std[key]
    raise ValueError(
        f"birth_std: the modes differ in the component {component!r}, which needs a birth "
        f"standard deviation; given are {', '.join(birth_std)}"
    )
