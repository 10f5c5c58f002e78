"""A manoeuvring emitter whose acceleration dies away by itself."""

from __future__ import annotations

from math import factorial

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, LinearMotion, component_names
from imm_tdoa.models.motion._noise import blocked, exactly_one


@attrs.frozen
class Singer(LinearMotion):
    """Singer model: acceleration is exponentially correlated, a' = e^(-dt/tau) a + w.

    Parameters
    ----------
    psd : float, optional
        Density of the white jerk that drives the acceleration, m²/s⁵.
    std : float, optional
        Stationary standard deviation of the acceleration, m/s²; psd = 2 std² / tau.
    time_constant : float
        Correlation time tau of the acceleration, s (about 60 for a lazy turn, 10 to 20 for an
        evasive manoeuvre).

    Notes
    -----
    Exactly one of `psd` and `std`. Both are continuous noise: Q composes over any time steps.
    Components: ``x y [z] vx vy [vz] ax ay [az]``. As tau grows the model becomes
    ConstantAcceleration(psd).

    References
    ----------
    R. A. Singer, "Estimating optimal tracking filter performance for manned maneuvering
    targets", IEEE Trans. Aerospace and Electronic Systems 6(4), 473-483, 1970.
    """

    psd: float | None = None
    std: float | None = None
    time_constant: float = attrs.field(default=20.0, kw_only=True)

    def __attrs_post_init__(self) -> None:
        exactly_one("Singer", self.psd, self.std)
        _validate.positive("time_constant", self.time_constant)

    def components(self, dims: int) -> tuple[str, ...]:
        """Return the components of position, velocity and acceleration."""
        return component_names(_validate.dimensions(dims), order=2)

    def transition(self, dt: float | Array, dims: int) -> Array:
        """Return F (..., 3d, 3d)."""
        dt = _validate.time_step(dt)
        g = _impulse_response(dt, self.time_constant)
        f = np.zeros((*dt.shape, 3, 3))
        f[..., 0, 0] = f[..., 1, 1] = 1.0
        f[..., 0, 1] = dt
        f[..., :, 2] = g
        return blocked(f, dims)

    def process_noise(self, dt: float | Array, dims: int) -> Array:
        """Return Q (..., 3d, 3d): psd times the integral of g(s) g(s)' over the step."""
        dt = _validate.time_step(dt)
        psd = self.psd
        if psd is None:
            assert self.std is not None
            psd = 2.0 * self.std**2 / self.time_constant
        short = dt < self.time_constant
        q = np.where(
            short[..., None, None],
            _integral_by_quadrature(np.where(short, dt, 0.0), self.time_constant),
            _integral_closed(np.where(short, self.time_constant, dt), self.time_constant),
        )
        return blocked(psd * q, dims)


def _impulse_response(t: Array, tau: float) -> Array:
    """Position, velocity and acceleration (..., 3) a time t after a unit jerk impulse."""
    x = t / tau
    series = sum((-x) ** k / factorial(k + 2) for k in range(12))  # (x - 1 + e^-x) / x²
    safe = np.where(x < 0.5, 1.0, x)
    ratio = np.where(x < 0.5, series, (safe + np.expm1(-safe)) / safe**2)
    return np.stack([t**2 * ratio, -tau * np.expm1(-x), np.exp(-x)], axis=-1)


def _integral_by_quadrature(t: Array, tau: float) -> Array:
    """Integral of g g' over [0, t] for t <= tau, where the closed form cancels."""
    node, weight = np.polynomial.legendre.leggauss(12)
    g = _impulse_response(0.5 * t[..., None] * (1.0 + node), tau)
    result: Array = np.einsum("q,...qa,...qb->...ab", weight, g, g) * (0.5 * t)[..., None, None]
    return result


def _integral_closed(t: Array, tau: float) -> Array:
    """Integral of g g' over [0, t] in closed form (Singer 1970), accurate for t >= tau."""
    x = t / tau
    e1, e2 = np.exp(-x), np.exp(-2.0 * x)
    q = np.empty((*t.shape, 3, 3))
    q[..., 0, 0] = tau**5 / 2 * (1 - e2 + 2 * x + 2 * x**3 / 3 - 2 * x**2 - 4 * x * e1)
    q[..., 0, 1] = q[..., 1, 0] = tau**4 / 2 * (1 + e2 - 2 * e1 + 2 * x * e1 - 2 * x + x**2)
    q[..., 0, 2] = q[..., 2, 0] = tau**3 / 2 * (1 - e2 - 2 * x * e1)
    q[..., 1, 1] = tau**3 / 2 * (4 * e1 - 3 - e2 + 2 * x)
    q[..., 1, 2] = q[..., 2, 1] = tau**2 / 2 * (1 + e2 - 2 * e1)
    q[..., 2, 2] = tau / 2 * (1 - e2)
    return q
