"""An emitter that turns at a rate to be estimated."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, component_names
from imm_tdoa.models.motion._noise import continuous, exactly_one, piecewise_constant


@attrs.frozen
class CoordinatedTurn:
    """Coordinated turn, CT: constant speed and turn rate omega, which is estimated (§2).

    Parameters
    ----------
    psd : float, optional
        Density of continuous white acceleration, m²/s³ per axis.
    std : float, optional
        Standard deviation of an acceleration held constant over each step, m/s².
    turn_rate_psd : float
        Density of the turn rate's random walk, rad²/s³.

    Notes
    -----
    Exactly one of `psd` and `std`. Components: ``x y vx vy omega`` in two dimensions; in three
    the turn is horizontal and z moves at constant velocity: ``x y z vx vy vz omega``. omega
    (rad/s) is positive counter-clockwise. With s = sin(omega dt)/omega and
    k = (1 - cos(omega dt))/omega:

        x' = x + s vx - k vy,  y' = y + k vx + s vy,  velocity rotated by omega dt.

    The Jacobian is exact, including the derivatives by omega, down to omega = 0.
    """

    psd: float | None = None
    std: float | None = None
    turn_rate_psd: float = attrs.field(default=1e-4, kw_only=True)

    def __attrs_post_init__(self) -> None:
        exactly_one("CoordinatedTurn", self.psd, self.std)
        _validate.non_negative("turn_rate_psd", self.turn_rate_psd)

    @property
    def composes(self) -> bool:
        """Whether noise over two steps on end is that over one long step: only with `psd`."""
        return self.std is None

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the components of position, velocity and turn rate.

        Raises
        ------
        ValueError
            One dimension: nothing turns on a line.
        """
        if _validate.dimensions(dims) == 1:
            raise ValueError("dims: CoordinatedTurn needs 2 or 3 dimensions, got 1")
        return (*component_names(dims, order=1), "omega")

    def propagate(self, x: Array, dt: float | Array) -> Array:
        """Return the state (..., 2d + 1) a time `dt` (...) s later."""
        x, dt, d = self._arguments(x, dt)
        vx, vy, omega = x[..., d], x[..., d + 1], x[..., -1]
        angle = omega * dt
        S, C, _, _ = _turn_functions(angle)
        y = np.array(x)
        y[..., 0] += dt * (S * vx - C * vy)
        y[..., 1] += dt * (C * vx + S * vy)
        y[..., 2:d] += dt[..., None] * x[..., d + 2 : 2 * d]
        y[..., d] = np.cos(angle) * vx - np.sin(angle) * vy
        y[..., d + 1] = np.sin(angle) * vx + np.cos(angle) * vy
        return y

    def jacobian(self, x: Array, dt: float | Array) -> Array:
        """Return d propagate / d x, shape (..., 2d + 1, 2d + 1)."""
        x, dt, d = self._arguments(x, dt)
        vx, vy, omega = x[..., d], x[..., d + 1], x[..., -1]
        angle = omega * dt
        S, C, dS, dC = _turn_functions(angle)
        cos, sin = np.cos(angle), np.sin(angle)
        n = 2 * d + 1
        F = np.array(np.broadcast_to(np.eye(n), (*x.shape[:-1], n, n)))
        F[..., 0, d], F[..., 0, d + 1] = dt * S, -dt * C
        F[..., 1, d], F[..., 1, d + 1] = dt * C, dt * S
        F[..., d, d], F[..., d, d + 1] = cos, -sin
        F[..., d + 1, d], F[..., d + 1, d + 1] = sin, cos
        F[..., 0, -1] = dt**2 * (dS * vx - dC * vy)
        F[..., 1, -1] = dt**2 * (dC * vx + dS * vy)
        F[..., d, -1] = dt * (-sin * vx - cos * vy)
        F[..., d + 1, -1] = dt * (cos * vx - sin * vy)
        if d == 3:
            F[..., 2, 5] = dt
        return F

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return Q (..., 2d + 1, 2d + 1): that of CV, and turn_rate_psd dt for omega."""
        n = len(self.components(dims))
        dt = _validate.time_step(dt)
        Q = np.zeros((*dt.shape, n, n))
        if self.psd is not None:
            Q[..., :-1, :-1] = continuous(dt, dims, 1, self.psd)
        else:
            assert self.std is not None
            g = np.stack([dt**2 / 2, dt], axis=-1)
            Q[..., :-1, :-1] = piecewise_constant(dt, dims, g, self.std)
        Q[..., -1, -1] = self.turn_rate_psd * dt
        return Q

    def _arguments(self, x: Array, dt: float | Array) -> tuple[Array, Array, int]:
        x, step = np.asarray(x, dtype=float), _validate.time_step(dt)
        n = x.shape[-1] if x.ndim else 0
        if n not in (5, 7):
            raise ValueError(f"x: CoordinatedTurn has 5 components (2-D) or 7 (3-D), got {n}")
        batch = np.broadcast_shapes(x.shape[:-1], step.shape)
        return np.broadcast_to(x, (*batch, n)), np.broadcast_to(step, batch), n // 2


def _turn_functions(a: Array) -> tuple[Array, Array, Array, Array]:
    """Return sin(a)/a, (1 - cos a)/a and their derivatives, by series where a is small."""
    small = np.abs(a) < 0.05
    b = np.where(small, 1.0, a)
    S = np.sin(b) / b
    C = 2.0 * np.sin(0.5 * b) ** 2 / b
    a2 = a * a
    return (
        np.where(small, 1 - a2 / 6 + a2**2 / 120 - a2**3 / 5040, S),
        np.where(small, a * (1 / 2 - a2 / 24 + a2**2 / 720 - a2**3 / 40320), C),
        np.where(small, a * (-1 / 3 + a2 / 30 - a2**2 / 840 + a2**3 / 45360), (np.cos(b) - S) / b),
        np.where(small, 1 / 2 - a2 / 8 + a2**2 / 144 - a2**3 / 5760, (np.sin(b) - C) / b),
    )
