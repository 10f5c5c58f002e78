"""Local frames on the Earth: east-north-up axes tangent to WGS84 at an origin (pymap3d)."""

from __future__ import annotations

import attrs
import numpy as np
import pymap3d

from imm_tdoa import _validate
from imm_tdoa.contract import Array

DEEP = 3e6  # distance from the Earth's centre, m


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
            if isinstance(value, bool) or np.ndim(value) != 0:
                raise ValueError(f"{name}: expected one number, got {value!r}")
            number = float(_validate.array(name, value))
            if abs(number) > bound:
                raise ValueError(f"{name}: expected a number within ±{bound:g}, got {value!r}")
            object.__setattr__(self, name, number)

    def axes_and_origin(self) -> Array:
        """Return (12,): east, north and up in Earth-fixed axes, and the origin, m."""
        phi, lam = np.radians(self.lat_deg), np.radians(self.lon_deg)
        s, c, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
        origin = pymap3d.geodetic2ecef(self.lat_deg, self.lon_deg, self.height_m)
        return np.array([-sl, cl, 0.0, -s * cl, -s * sl, c, c * cl, c * sl, s, *origin])

    def to_geodetic(self, position: Array) -> tuple[Array, Array, Array]:
        """Return latitude and longitude, degrees, and height above the ellipsoid, m.

        Parameters
        ----------
        position : (..., 3)
            Points of this frame, m.
        """
        p = _validate.array("position", position, (None, 3), finite=False)
        ecef = pymap3d.enu2ecef(
            p[..., 0], p[..., 1], p[..., 2], self.lat_deg, self.lon_deg, self.height_m
        )
        return _geodetic(*(np.asarray(c, dtype=float) for c in ecef))

    def from_geodetic(self, lat_deg: Array, lon_deg: Array, height_m: Array) -> Array:
        """Return points (..., 3) of this frame, m.

        Parameters
        ----------
        lat_deg, lon_deg : (...)
            Latitude and longitude, degrees.
        height_m : (...)
            Height above the ellipsoid, m.

        Raises
        ------
        ValueError
            Latitudes beyond the poles, or no numbers.
        """
        given = {"lat_deg": lat_deg, "lon_deg": lon_deg, "height_m": height_m}
        checked = [_validate.array(name, a, finite=False) for name, a in given.items()]
        lat, lon, h = np.broadcast_arrays(*checked)
        if np.any(np.abs(lat) > 90.0):
            bad = float(lat[np.abs(lat) > 90.0][0])
            raise ValueError(f"lat_deg: expected latitudes within ±90, got {bad!r}")
        enu = pymap3d.geodetic2enu(lat, lon, h, self.lat_deg, self.lon_deg, self.height_m)
        return np.stack([np.asarray(c, dtype=float) for c in enu], axis=-1)

    def height(self, position: Array) -> tuple[Array, Array]:
        """Return heights (...) above the ellipsoid, m, and their gradients (..., 3).

        The gradient is the ellipsoid's outward normal at the point's foot: exact.

        Parameters
        ----------
        position : (..., 3)
            Points of this frame, m.
        """
        lat, lon, h = self.to_geodetic(position)
        phi, lam = np.radians(lat), np.radians(lon)
        normal = np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)
        up = pymap3d.ecef2enuv(*normal, self.lat_deg, self.lon_deg)
        return h, np.stack([np.asarray(c, dtype=float) for c in up], axis=-1)


def _geodetic(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude (degrees) and height (m) of Earth-fixed points (...), to rounding.

    pymap3d's closed form is exact at the ellipsoid only: 8 mm off at a height of 1000 km, tens of
    metres at that of a navigation satellite. Bowring's iteration (1976) from there mends it.
    """
    lat, lon, h = (np.asarray(c, dtype=float) for c in pymap3d.ecef2geodetic(x, y, z))
    ell = pymap3d.Ellipsoid.from_name("wgs84")
    a, b = ell.semimajor_axis, ell.semiminor_axis
    e2, rho = 1.0 - (b / a) ** 2, np.hypot(x, y)
    phi = np.radians(lat)
    for _ in range(3):
        beta = np.arctan2(b * np.sin(phi), a * np.cos(phi))
        up = z + e2 * a**2 / b * np.sin(beta) ** 3
        phi = np.arctan2(up, rho - e2 * a * np.cos(beta) ** 3)
    mended = rho * np.cos(phi) + z * np.sin(phi) - a * np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    deep = np.hypot(rho, z) < DEEP  # where the iteration need not converge
    return np.where(deep, lat, np.degrees(phi)), lon, np.where(deep, h, mended)
