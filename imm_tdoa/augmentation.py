"""Models with constants behind every state: errors that stay, estimated along with the emitter."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa.contract import Array, LinearMotion, MotionModel
from imm_tdoa.stations import Stations


class Augmented:
    """A motion model with constants behind its state; arguments as of `MotionModel`.

    Parameters
    ----------
    model : MotionModel
        The model.
    names : tuple of str
        What the constants are called.
    """

    def __init__(self, model: MotionModel, names: tuple[str, ...]) -> None:
        self.model, self.names = model, names
        self.name = registry.name_of(model)

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the model's components and the constants."""
        return (*self.model.components(dims), *self.names)

    def propagate(self, x: Array, dt: float | Array) -> Array:
        """Return the model's state later, the constants as they are."""
        n = x.shape[-1] - len(self.names)
        moved = self.model.propagate(x[..., :n], dt)
        constant = np.broadcast_to(x[..., n:], (*moved.shape[:-1], len(self.names)))
        return np.concatenate([moved, constant], axis=-1)

    def jacobian(self, x: Array, dt: float | Array) -> Array:
        """Return the model's Jacobian, and ones for the constants."""
        return self._padded(self.model.jacobian(x[..., : x.shape[-1] - len(self.names)], dt), 1.0)

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return the model's process noise, and none for the constants."""
        return self._padded(self.model.process_noise(dt, dims), 0.0)

    def _padded(self, M: Array, diagonal: float) -> Array:
        n, k = M.shape[-1], len(self.names)
        result = np.zeros((*M.shape[:-2], n + k, n + k))
        result[..., :n, :n] = M
        result[..., n:, n:] = diagonal * np.eye(k)
        return result


class LinearAugmented(Augmented, LinearMotion):
    """The same of a linear model, whose prediction needs no sigma points."""


@attrs.frozen(eq=False)
class ConstantErrors:
    """A measurement by stations whose errors are the last components of the state.

    Parameters
    ----------
    exact : MeasurementModel
        The measurement, by stations without errors.
    declared : Stations
        The same stations with the errors that they declare.
    """

    exact: Any
    declared: Stations

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.exact, name)

    def constant_errors(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return d rows / d errors (..., m, k)."""
        return receiver_jacobian(self.exact, self.declared, position, velocity, time)

    def with_pairs(self, pairs: Any) -> ConstantErrors:
        """Return the same for other pairs."""
        return attrs.evolve(self, exact=self.exact.with_pairs(pairs))


def parts(measurement: Any) -> tuple[Any, ...]:
    """Return the measurement models that one is made of, or itself."""
    return tuple(getattr(measurement, "models", (measurement,)))


def receiver_jacobian(
    measurement: Any, declared: Stations, position: Array, velocity: Array, time: float | Array
) -> Array:
    """Return d rows / d errors of the receivers (..., m, k); zero for stations not heard.

    Parameters
    ----------
    measurement : MeasurementModel
        Made by stations, or several such together.
    declared : Stations
        Says which errors there are: of positions, of velocities too.
    position, velocity : (..., d)
        Of the emitter, m and m/s.
    time : float or (...)
        When, s.
    """
    rows = []
    for part in parts(measurement):
        Jp, Jv = part.station_jacobian(position, velocity, time)
        J = [Jp] if declared.velocity_covariance is None else [Jp, Jv]
        flat = [j.reshape(*j.shape[:-2], -1) for j in J]
        rows.append(np.concatenate(flat, axis=-1))
    every = np.concatenate(rows, axis=-2)
    return np.where(np.isfinite(every), every, 0.0)
