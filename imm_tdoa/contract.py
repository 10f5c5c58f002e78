"""What a motion model and a measurement model must offer.

Anything with these methods is a model; nothing needs to inherit from anything. The two base
classes are conveniences: `LinearMotion` turns a transition matrix into `propagate` and
`jacobian`, `Measurement` supplies the properties that most measurement models leave at their
defaults. ``imm-tdoa models --check`` and `imm_tdoa.testing` tell the author of a model which law
it breaks.
"""

from __future__ import annotations

from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

AXES = ("x", "y", "z")
PREFIX = ("", "v", "a")
KINDS = ("position", "velocity", "acceleration")


def component_names(dims: int, order: int) -> tuple[str, ...]:
    """Names of a state blocked by derivative order, e.g. ``x y vx vy`` for dims 2, order 1.

    Parameters
    ----------
    dims : int
        Number of space dimensions: 1, 2 or 3.
    order : int
        Highest derivative: 0 position, 1 velocity, 2 acceleration.
    """
    return tuple(PREFIX[k] + axis for k in range(order + 1) for axis in AXES[:dims])


@runtime_checkable
class MotionModel(Protocol):
    """How an emitter moves between two times.

    The state is blocked by derivative order, positions first (`components` names it).
    Every method takes batches: leading axes of `x` and `dt` broadcast.
    """

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the names of the n state components.

        Parameters
        ----------
        dims : int
            Number of space dimensions: 1, 2 or 3.

        Returns
        -------
        tuple of str
            Positions first, as ``x y vx vy``; different models are matched by these names.
        """
        ...

    def propagate(self, x: Array, dt: float | Array) -> Array:
        """Return the state some time later, noise left out.

        Parameters
        ----------
        x : (..., n)
            State, SI units.
        dt : float or (...)
            Time step, s, 0 or more.

        Returns
        -------
        (..., n)
            State `dt` later; `x` itself for a step of 0.
        """
        ...

    def jacobian(self, x: Array, dt: float | Array) -> Array:
        """Return d propagate(x, dt) / d x, shape (..., n, n)."""
        ...

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return the covariance of what a time step adds to the state at random.

        Parameters
        ----------
        dt : float or (...)
            Time step, s.
        dims : int
            Number of space dimensions.

        Returns
        -------
        (..., n, n)
            Q, symmetric and positive semi-definite; zero for a step of 0.
        """
        ...


class LinearMotion:
    """A motion model given by its transition matrix.

    A subclass supplies `components`, `transition` and `process_noise`; arguments and results are
    those of `MotionModel`. The state may be of any number of space dimensions; it is read off the
    length of `x`.
    """

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the names of the n state components in `dims` space dimensions."""
        raise NotImplementedError

    def transition(self, dt: float | Array, dims: int) -> Array:
        """Return F (..., n, n) with x(t + dt) = F x(t)."""
        raise NotImplementedError

    def propagate(self, x: Array, dt: float | Array) -> Array:
        """Return F(dt) x, shape (..., n)."""
        x = np.asarray(x, dtype=float)
        result: Array = np.einsum("...ij,...j->...i", self.transition(dt, self._dims(x)), x)
        return result

    def jacobian(self, x: Array, dt: float | Array) -> Array:
        """Return F(dt), shape (..., n, n)."""
        return self.transition(dt, self._dims(np.asarray(x)))

    def _dims(self, x: NDArray[Any]) -> int:
        n, per_axis = x.shape[-1] if x.ndim else 0, len(self.components(1))
        if n % per_axis or n // per_axis not in (1, 2, 3):
            raise ValueError(
                f"x: {type(self).__name__} has {per_axis} components per axis in 1, 2 or 3 "
                f"dimensions; a state of length {n} fits none of them"
            )
        return n // per_axis


@runtime_checkable
class MeasurementModel(Protocol):
    """What is measured of an emitter, from its kinematics alone.

    A measurement model sees position and velocity, never a motion model's state vector: one
    measurement model serves every motion model. It works in internal units (metres, metres per
    second, radians): ``internal = scale * given value``. Where its methods take `position`,
    `velocity` and `time`, they are those of `predict`.
    """

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        ...

    @property
    def size(self) -> int:
        """Number of rows m of a scan."""
        ...

    @property
    def scale(self) -> Array:
        """Factor (m,) from the caller's units to internal units."""
        ...

    @property
    def angular(self) -> Mask:
        """Which rows (m,) are angles, whose innovations are wrapped into [-pi, pi)."""
        ...

    @property
    def offset_group(self) -> Index:
        """Rows (m,) with the same number >= 0 share an unknown additive offset; -1: none."""
        ...

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return what would be measured without noise.

        Parameters
        ----------
        position, velocity : (..., d)
            Of the emitter, m and m/s.
        time : float or (...)
            When, s: stations may move.

        Returns
        -------
        (..., m)
            Rows in internal units; NaN where a row cannot be measured then (a station that is
            not heard).
        """
        ...

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return d rows / d position and d rows / d velocity, each (..., m, d)."""
        ...

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the noise covariance R (..., m, m), full where rows share a source of error."""
        ...

    def error_sources(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return what can go grossly wrong by itself, and how it enters the rows.

        An arrival that two differences share is one source. Robust filters judge sources, so
        that no result depends on the choice of reference.

        Returns
        -------
        (..., m, k), (..., k)
            How much each of k independent errors adds to each row, and their variances.
        """
        ...

    def independent(self, present: Mask) -> Mask:
        """Return which rows count once those that only repeat others are left out.

        Parameters
        ----------
        present : (..., m) bool
            Rows that were measured.

        Returns
        -------
        (..., m) bool
            `present` less the redundant rows.
        """
        ...

    def anchors(self, time: float | Array, present: Mask) -> Array:
        """Return where the stations are that tell a search for the emitter where to begin.

        Parameters
        ----------
        time : float or (...)
            When, s.
        present : (..., m) bool
            Rows that were measured.

        Returns
        -------
        (..., k, d)
            Positions of the stations behind those rows, m; NaN where one was not heard.
        """
        ...

    def with_pairs(self, pairs: Any) -> MeasurementModel:
        """Return the same model for other station pairs.

        Parameters
        ----------
        pairs : (..., m, 2) int
            Station and reference of each row.
        """
        ...


class Measurement:
    """Defaults for a measurement model; a subclass supplies what is marked abstract.

    `dims`, `size`, `predict`, `jacobian` and `noise_covariance` are the subclass's. The rest
    says: SI units, no angles, no shared offset, no redundant rows, no station pairs. Arguments
    and results are those of `MeasurementModel`.
    """

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        raise NotImplementedError

    @property
    def size(self) -> int:
        """Number of rows m of a scan."""
        raise NotImplementedError

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return the noise covariance R (..., m, m)."""
        raise NotImplementedError

    @property
    def scale(self) -> Array:
        """Factor (m,) from the caller's units to internal units."""
        return np.ones(self.size)

    @property
    def angular(self) -> Mask:
        """Which rows (m,) are angles."""
        return np.zeros(self.size, dtype=bool)

    @property
    def offset_group(self) -> Index:
        """Rows (m,) with the same number >= 0 share an unknown additive offset; -1: none."""
        return np.full(self.size, -1, dtype=np.int64)

    def error_sources(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return how independent errors enter the rows: here each row has its own."""
        R = self.noise_covariance(position, velocity, time)
        return np.eye(self.size), np.einsum("...ii->...i", R)

    def independent(self, present: Mask) -> Mask:
        """Return `present` (..., m) less the rows that only repeat what other rows say."""
        return present

    def anchors(self, time: float | Array, present: Mask) -> Array:
        """Return positions (..., k, d) of the stations behind the `present` rows; here none."""
        return np.zeros((*present.shape[:-1], 0, self.dims))

    def with_pairs(self, pairs: Any) -> Self:
        """Refuse: there are no station pairs here.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(f"pairs: {type(self).__name__} does not measure station pairs")
