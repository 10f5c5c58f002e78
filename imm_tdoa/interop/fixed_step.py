"""A motion that is known at one time step only, from its matrices."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa import _validate
from imm_tdoa.contract import AXES, Array, LinearMotion

SAME_STEP = 1e-4  # relative: time stamps are rounded, and a step is the difference of two


@attrs.frozen(eq=False)
class FixedStep(LinearMotion):
    """Motion given by F and Q over steps of one length: x' = F x + w, w ~ N(0, Q).

    Nothing is known of shorter or longer steps, so they are refused; a scan that was missed is a
    scan without values at its own time. A step of length zero changes nothing.

    Parameters
    ----------
    F : (n, n)
        Transition matrix over `dt`.
    Q : (n, n)
        Covariance of what one step adds at random.
    names : sequence of n str
        The state's components, in any order: ``x``, ``y``, ``z`` as many as there are space
        dimensions, ``vx`` …, ``ax`` …, and others.
    dt : float
        The time step, s; steps that differ from it by less than 1e-4 of it pass for it, because
        time stamps are rounded.

    Raises
    ------
    ValueError
        Matrices that do not fit, a Q that is no covariance, positions that are lacking, a step
        that is not positive.

    Notes
    -----
    Of the laws of motion models (`imm_tdoa.testing`) those that compare different steps cannot
    be tried: semigroup, noise composes, kinematics.
    """

    F: Any
    Q: Any
    names: Any
    dt: float
    composes: bool = attrs.field(default=False, init=False)

    def __attrs_post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        if isinstance(self.names, str) or not isinstance(self.names, Iterable):
            raise ValueError(f"names: expected component names, got {self.names!r}")
        names = tuple(self.names)
        n = len(names)
        if len(set(names)) != n or not all(isinstance(name, str) for name in names):
            raise ValueError(f"names: expected different names, got {names!r}")
        dimensions(names)
        put("names", names)
        put("F", _validate.array("F", self.F, (n, n)))
        put("Q", _validate.covariance("Q", _validate.array("Q", self.Q, (n, n)), n))
        put("dt", _validate.positive("dt", self.dt))

    @property
    def dims(self) -> int:
        """Number of space dimensions."""
        return dimensions(self.names)

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the names given; only for the number of dimensions they have.

        Raises
        ------
        ValueError
            Another number of dimensions.
        """
        if _validate.dimensions(dims) != self.dims:
            raise ValueError(f"dims: this model has {self.dims} space dimensions, got {dims}")
        names: tuple[str, ...] = self.names
        return names

    def transition(self, dt: float | Array, dims: int) -> Array:
        """Return F (..., n, n); the identity where `dt` is 0."""
        moves = self._moves(dt, dims)
        return np.where(moves, self.F, np.eye(len(self.names)))

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return Q (..., n, n); zero where `dt` is 0."""
        moves = self._moves(dt, dims)
        return np.where(moves, self.Q, 0.0)

    def _moves(self, dt: float | Array, dims: int) -> NDArray[np.bool_]:
        """Tell (..., 1, 1) which steps are of the one length and not of none, refusing others."""
        self.components(dims)
        step = _validate.time_step(dt)
        moves = np.abs(step - self.dt) <= SAME_STEP * self.dt
        other = ~moves & (step != 0.0)
        if np.any(other):
            raise ValueError(
                f"dt: F and Q of this model hold for steps of {self.dt:g} s (or 0), "
                f"got {float(step[other].flat[0]):.9g} s"
            )
        return np.asarray(moves)[..., None, None]

    def _dims(self, x: NDArray[Any]) -> int:
        n = len(self.names)
        if x.ndim == 0 or x.shape[-1] != n:
            raise ValueError(f"x: expected {n} components {self.names}, got shape {x.shape}")
        return self.dims


def dimensions(names: Iterable[str]) -> int:
    """Return the number of space dimensions of a state with these components."""
    there = [axis in tuple(names) for axis in AXES]
    d = sum(there)
    if d == 0 or not all(there[:d]):
        raise ValueError(
            f"names: expected the position among them (x; x and y; or x, y and z), "
            f"got {tuple(names)!r}"
        )
    return d
