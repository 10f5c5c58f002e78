"""From filterpy's Kalman filters to a bank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import attrs
import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from imm_tdoa import _validate
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, component_names
from imm_tdoa.imm import IMM
from imm_tdoa.interop.fixed_step import FixedStep, dimensions
from imm_tdoa.interop.linear import LinearMeasurement
from imm_tdoa.state import State


def from_filterpy(
    filters: Sequence[Any],
    *,
    components: Sequence[str] | Sequence[Sequence[str]],
    dt: float,
    transition: Any = None,
    mode_probability: Any = None,
    time: float = 0.0,
    names: Sequence[str] = (),
    mixing: Literal["birth", "unbiased", "zero"] = "birth",
    birth_std: Mapping[str, float] | None = None,
) -> tuple[Bank, LinearMeasurement, State]:
    """Return the bank, measurement and state that a list of filterpy's Kalman filters stands for.

    >>> bank, measurement, state = from_filterpy(
    ...     [slow, fast], components=("x", "vx", "y", "vy"), dt=0.5
    ... )
    >>> track = IMM(bank, measurement).run(times, values, start=state)

    The filters stay as they are. They may be of different dimensions, which filterpy's own
    `IMMEstimator` refuses; of one, ``imm``, take ``from_filterpy(imm.filters,
    transition=imm.M, mode_probability=imm.mu, ...)``, between an update and a prediction.

    Parameters
    ----------
    filters : sequence of filterpy.kalman.KalmanFilter
        With F, Q, H, R, x and P set; H and R the same in all.
    components : sequence of str, or one such sequence per filter
        What the components of x are called, in the filters' order, which may be any:
        ``("x", "vx", "y", "vy")``. Positions ``x``, ``y``, ``z``, velocities ``vx`` … and
        accelerations ``ax`` … are known by these names. The bank's models have them blocked:
        positions, velocities, accelerations, others.
    dt : float
        The time step that F and Q are for, s.
    transition : (r, r), optional
        Transition matrix per scan, **rows** summing to one: filterpy's ``M`` as it is used.
        Default: that of a mean sojourn of 60 s.
    mode_probability : (r,), optional
        Mode probabilities now; default equal.
    time : float
        When the filters stand where they are, s.
    names : sequence of str
        Mode names; default numbered.
    mixing, birth_std
        See `Bank`: for filters of different dimensions.

    Returns
    -------
    bank : Bank
        Of `FixedStep` models.
    measurement : LinearMeasurement
        What H and R say.
    state : State
        What x and P say; for `IMM.step` and ``IMM.run(start=...)``.

    Raises
    ------
    ValueError
        No Kalman filters; names that do not fit; H or R that differ, or that act on more than
        position and velocity; control input, fading memory (alpha), correlated noise (M).
    """
    if isinstance(filters, IMMEstimator):
        raise ValueError(
            "filters: expected a list of KalmanFilter, got an IMMEstimator imm; give imm.filters, "
            "transition=imm.M, mode_probability=imm.mu"
        )
    if not isinstance(filters, Sequence) or not len(filters):
        raise ValueError(f"filters: expected a list of KalmanFilter, got {filters!r}")
    for i, kf in enumerate(filters):
        _refuse_other(i, kf)
    every = _component_lists(components, len(filters))
    orders, models, rows = [], [], []
    for i, (kf, own) in enumerate(zip(filters, every, strict=True)):
        there = _blocked(own)
        order = [own.index(name) for name in there]
        F, Q = _square(i, kf, "F", order), _square(i, kf, "Q", order)
        models.append(FixedStep(F, Q, there, dt))
        orders.append(order)
        rows.append(_rows(i, kf, own))
    measurement = _common(rows, dimensions(every[0]))
    bank = Bank(
        models,
        transition=transition,
        prior=mode_probability,
        mixing=mixing,
        birth_std={} if birth_std is None else birth_std,
        names=tuple(names),
    )
    x, P = [], []
    for i, (kf, order) in enumerate(zip(filters, orders, strict=True)):
        x.append(_validate.array(f"filters[{i}].x", np.ravel(kf.x), (len(order),))[order])
        P.append(_square(i, kf, "P", order))
    imm = IMM(bank, measurement)
    union = len(imm.space.components)
    blank = imm.start(_validate.array("time", time, ()), np.zeros(union), np.eye(union))
    return bank, measurement, attrs.evolve(blank, means=tuple(x), covariances=tuple(P))


def _refuse_other(i: int, kf: Any) -> None:
    """Raise unless `kf` is a Kalman filter of which F, Q, H, R, x and P say everything."""
    plain = isinstance(kf, KalmanFilter) and all(
        getattr(type(kf), step) is getattr(KalmanFilter, step) for step in ("predict", "update")
    )
    if not plain:
        raise ValueError(f"filters: filters[{i}] is no filterpy KalmanFilter but {type(kf)}")
    if kf.B is not None and np.any(np.asarray(kf.B, dtype=float)):
        raise ValueError(f"filters: filters[{i}] has a control matrix B; a bank has no control")
    if kf.alpha != 1.0:
        raise ValueError(
            f"filters: filters[{i}] has a fading memory, alpha = {kf.alpha:g}; a bank has process "
            f"noise instead"
        )
    if np.any(kf.M):
        raise ValueError(
            f"filters: filters[{i}] has process noise correlated with the measurement's (M)"
        )


def _component_lists(components: Any, r: int) -> list[tuple[str, ...]]:
    """Return the component names of each of r filters."""
    if isinstance(components, str) or not isinstance(components, Sequence) or not len(components):
        raise ValueError(f"components: expected names of the components of x, got {components!r}")
    if all(isinstance(name, str) for name in components):
        every = [tuple(components)] * r
    else:
        every = [tuple(own) for own in components]
    if len(every) != r:
        raise ValueError(f"components: expected names for each of {r} filters, got {len(every)}")
    for own in every:
        if len(set(own)) != len(own) or not all(isinstance(name, str) for name in own):
            raise ValueError(f"components: expected different names, got {own!r}")
        try:
            d = dimensions(own)
        except ValueError as error:
            raise ValueError(f"components: {error}") from None
        if d != dimensions(every[0]):
            raise ValueError(
                f"components: expected the same space dimensions in all filters, got {every[0]!r} "
                f"and {own!r}"
            )
    return every


def _blocked(own: tuple[str, ...]) -> tuple[str, ...]:
    """Return the same names, positions first, then velocities, accelerations and others."""
    known = [name for name in component_names(3, 2) if name in own]
    return (*known, *(name for name in own if name not in known))


def _square(i: int, kf: KalmanFilter, name: str, order: list[int]) -> Array:
    """Return F, Q or P of a filter with its components in `order`."""
    n, where = len(order), f"filters[{i}].{name}"
    matrix = _validate.array(where, getattr(kf, name), (n, n))
    if name != "F":
        matrix = _validate.covariance(where, matrix, n)
    return matrix[np.ix_(order, order)]


def _rows(i: int, kf: KalmanFilter, own: tuple[str, ...]) -> tuple[Array, Array | None, Array]:
    """Return what a filter measures of the position (m, d) and of the velocity, and R (m, m)."""
    H = _validate.array(f"filters[{i}].H", kf.H, ("m", len(own)))
    R = np.asarray(kf.R, dtype=float)
    R = R.reshape(1, 1) if R.size == 1 else R
    R = _validate.array(f"filters[{i}].R", R, (len(H), len(H)))
    kinematic = component_names(dimensions(own), 1)
    for k, name in enumerate(own):
        if name not in kinematic and np.any(H[:, k]):
            raise ValueError(
                f"filters[{i}].H: acts on {name!r}; a measurement here sees position and velocity "
                f"alone, so that it is the same for every motion model"
            )
    d = len(kinematic) // 2
    Hp = H[:, [own.index(name) for name in kinematic[:d]]]
    if not set(kinematic) <= set(own):
        return Hp, None, R
    return Hp, H[:, [own.index(name) for name in kinematic[d:]]], R


def _common(rows: list[tuple[Array, Array | None, Array]], d: int) -> LinearMeasurement:
    """Return the one measurement of all filters; one without velocity says nothing of it."""
    first = rows[0]
    moving = next((i for i, (_, Hv, _) in enumerate(rows) if Hv is not None), None)
    shared = np.zeros_like(first[0]) if moving is None else rows[moving][1]
    for i, (Hp, Hv, R) in enumerate(rows):
        if not _same(Hp, first[0]) or (Hv is not None and not _same(Hv, shared)):
            raise ValueError(
                f"filters[{i}].H: differs from that of filters[{0 if moving is None else moving}]; "
                f"a bank has one measurement for all its models"
            )
        if not _same(R, first[2]):
            raise ValueError(
                f"filters[{i}].R: differs from that of filters[0]; a bank has one measurement "
                f"for all its models"
            )
    H = np.concatenate([first[0], shared], axis=-1) if np.any(shared) else first[0]
    return LinearMeasurement(H, first[2], d)


def _same(a: Any, b: Any) -> bool:
    return np.shape(a) == np.shape(b) and bool(np.allclose(a, b, rtol=1e-12, atol=0.0))
