"""Local frames on the Earth: east-north-up axes tangent to WGS84 at an origin (pymap3d)."""

from __future__ import annotations

import attrs
import numpy as np
import pymap3d

from imm_tdoa import _validate
from imm_tdoa.contract import Array


@attrs.frozen
class EastNorthUp:
    """East-north-up frame with its origin at a WGS84 latitude, longitude and height.

    z is not height: the Earth falls away below the tangent plane (8 m at 10 km).

    Parameters
    ----------
    lat_deg, lon_deg : float
        Origin, degrees.
    height_m : float
        Origin's height above the ellipsoid, m.
    """

    lat_deg: float
    lon_deg: float
    height_m: float = 0.0

    def __attrs_post_init__(self) -> None:
        for name, bound in (("lat_deg", 90.0), ("lon_deg", 360.0), ("height_m", np.inf)):
            value = getattr(self, name)
            if not np.isfinite(value) or abs(value) > bound:
                raise ValueError(f"{name}: expected a number within ±{bound:g}, got {value!r}")

    def to_geodetic(self, position: Array) -> tuple[Array, Array, Array]:
        """Return latitude, longitude (degrees) and ellipsoidal height (m) of (..., 3) points."""
        p = _validate.array("position", position, (None, 3), finite=False)
        lat, lon, h = pymap3d.enu2geodetic(
            p[..., 0], p[..., 1], p[..., 2], self.lat_deg, self.lon_deg, self.height_m
        )
        return np.asarray(lat), np.asarray(lon), np.asarray(h)

    def from_geodetic(self, lat_deg: Array, lon_deg: Array, height_m: Array) -> Array:
        """Return points (..., 3) of this frame, m, from latitude, longitude and height."""
        enu = pymap3d.geodetic2enu(
            lat_deg, lon_deg, height_m, self.lat_deg, self.lon_deg, self.height_m
        )
        return np.stack([np.asarray(c, dtype=float) for c in enu], axis=-1)

    def height(self, position: Array) -> tuple[Array, Array]:
        """Return heights (...) above the ellipsoid, m, and their gradients (..., 3).

        The gradient is the ellipsoid's outward normal at the point's foot: exact.
        """
        lat, lon, h = self.to_geodetic(position)
        phi, lam = np.radians(lat), np.radians(lon)
        normal = np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)
        up = pymap3d.ecef2enuv(*normal, self.lat_deg, self.lon_deg)
        return h, np.stack([np.asarray(c, dtype=float) for c in up], axis=-1)
