"""Measurements that are linear in position and velocity."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Measurement, MeasurementModel

PROBES = np.random.default_rng(0).uniform(-1e3, 1e3, (4, 2, 3))  # where linearity is tried


@attrs.frozen(eq=False)
class LinearMeasurement(Measurement):
    """Rows z = H [p; v] + e, e ~ N(0, R), of position p and velocity v.

    Parameters
    ----------
    H : (m, d) or (m, 2d)
        What is measured of the position, or of position and velocity.
    R : (m, m)
        Noise covariance, positive definite.
    dims : int
        Number of space dimensions d, 1 to 3.

    Raises
    ------
    ValueError
        Matrices that do not fit together, a covariance that is not positive definite.

    Notes
    -----
    Of the laws of measurement models (`imm_tdoa.testing`) translation, rotation and units do not
    apply: there are no stations to be moved along.
    """

    H: Any
    R: Any
    dims: int = 2

    def __attrs_post_init__(self) -> None:
        d = _validate.dimensions(self.dims)
        H = _validate.array("H", self.H, ("m", "d or 2d"))
        m = len(H)
        if H.shape[-1] not in (d, 2 * d) or m == 0:
            raise ValueError(f"H: expected shape (m, {d}) or (m, {2 * d}), got {H.shape}")
        R = _validate.covariance("R", _validate.array("R", self.R, (m, m)), m)
        scale = np.sqrt(np.diag(R))
        if np.any(scale == 0.0) or np.linalg.eigvalsh(R / np.outer(scale, scale))[0] <= 1e-12:
            raise ValueError("R: expected a positive definite matrix")
        object.__setattr__(self, "H", H)
        object.__setattr__(self, "R", R)

    @property
    def size(self) -> int:
        """Number of rows m."""
        return len(self.H)

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return H [p; v] (..., m)."""
        Hp, Hv = self._blocks()
        return np.asarray(position) @ Hp.T + np.asarray(velocity) @ Hv.T

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Return the two blocks of H, each (..., m, d)."""
        batch = np.shape(position)[:-1]
        Hp, Hv = (np.broadcast_to(B, (*batch, *B.shape)) for B in self._blocks())
        return Hp, Hv

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Return R (m, m)."""
        R: Array = self.R
        return R

    def _blocks(self) -> tuple[Array, Array]:
        d = self.dims
        Hp = self.H[:, :d]
        return Hp, self.H[:, d:] if self.H.shape[-1] > d else np.zeros_like(Hp)


def linear_rows(measurement: MeasurementModel, time: float) -> tuple[Array, Array]:
    """Return H (m, 2d) and R (m, m) of a measurement model that is linear, in its caller's units.

    Raises
    ------
    ValueError
        It is not linear in position and velocity, its noise depends on them, or its rows are
        angles, have an offset (an unknown shared one, or a constant), or repeat each other.
    """
    d, m, scale = measurement.dims, measurement.size, measurement.scale
    name = type(measurement).__name__

    def refuse(why: str) -> ValueError:
        return ValueError(
            f"measurement: a Kalman filter takes rows linear in position and velocity; "
            f"of {name} {why}"
        )

    if np.any(measurement.angular):
        raise refuse("rows are angles")
    if np.any(measurement.offset_group >= 0):
        raise refuse("rows share an unknown offset")
    if not np.all(measurement.independent(np.ones(m, dtype=bool))):
        raise refuse("rows repeat each other")
    p, v = PROBES[:, 0, :d], PROBES[:, 1, :d]
    rows = np.broadcast_to(measurement.predict(p, v, time), (len(PROBES), m))
    blocks = measurement.jacobian(p, v, time)
    H = np.concatenate([np.broadcast_to(B, (len(PROBES), m, d)) for B in blocks], axis=-1)
    R = np.broadcast_to(measurement.noise_covariance(p, v, time), (len(PROBES), m, m))
    if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(R))):
        raise refuse("some cannot be measured everywhere")
    if np.ptp(H, axis=0).max() > 1e-9 * np.abs(H).max():
        raise refuse("the rows are not")
    straight = np.einsum("mi,ki->km", H[0], np.concatenate([p, v], axis=-1))
    if np.abs(rows - straight).max() > 1e-9 * max(np.abs(rows).max(), np.abs(straight).max()):
        raise refuse("the rows are not: they have a constant part")
    if np.ptp(R, axis=0).max() > 1e-9 * np.abs(R).max():
        raise refuse("the noise depends on where the emitter is")
    return H[0] / scale[:, None], R[0] / np.outer(scale, scale)
