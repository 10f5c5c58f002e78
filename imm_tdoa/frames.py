"""Local frames on the Earth: east-north-up axes tangent to WGS84 at an origin (pymap3d)."""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np
import pymap3d

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Mask

A = 6378137.0  # WGS84 semi-major axis, m
B = 6356752.314245179  # semi-minor axis, m
E2 = 1.0 - (B / A) ** 2
DEEP = 3e6  # distance from the Earth's centre within which Bowring's iteration need not converge, m
ROUNDS = 2  # of the iteration: to rounding from the deep ground to beyond navigation satellites


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
    _axes: Array = attrs.field(init=False, repr=False, eq=False)  # rows east, north, up
    _origin: Array = attrs.field(init=False, repr=False, eq=False)

    def __attrs_post_init__(self) -> None:
        for name, bound in (("lat_deg", 90.0), ("lon_deg", 360.0), ("height_m", np.inf)):
            value = getattr(self, name)
            if isinstance(value, bool) or np.ndim(value) != 0:
                raise ValueError(f"{name}: expected one number, got {value!r}")
            number = float(_validate.array(name, value))
            if abs(number) > bound:
                raise ValueError(f"{name}: expected a number within ±{bound:g}, got {value!r}")
            object.__setattr__(self, name, number)
        phi, lam = np.radians(self.lat_deg), np.radians(self.lon_deg)
        s, c, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
        axes = np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])
        origin = np.array(pymap3d.geodetic2ecef(self.lat_deg, self.lon_deg, self.height_m))
        object.__setattr__(self, "_axes", axes)
        object.__setattr__(self, "_origin", origin)

    def axes_and_origin(self) -> Array:
        """Return (12,): east, north and up in Earth-fixed axes, and the origin, m."""
        return np.concatenate([self._axes.ravel(), self._origin])

    def to_geodetic(self, position: Array) -> tuple[Array, Array, Array]:
        """Return latitude and longitude, degrees, and height above the ellipsoid, m.

        Parameters
        ----------
        position : (..., 3)
            Points of this frame, m.
        """
        foot = _foot(self._earth_fixed(position))
        lat = np.degrees(np.arctan2(foot.sin_lat, foot.cos_lat))
        return lat, np.degrees(np.arctan2(foot.sin_lon, foot.cos_lon)), foot.height

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
        foot = _foot(self._earth_fixed(position))
        normal = np.empty((*foot.height.shape, 3))
        normal[..., 0] = foot.cos_lat * foot.cos_lon
        normal[..., 1] = foot.cos_lat * foot.sin_lon
        normal[..., 2] = foot.sin_lat
        return foot.height, normal @ self._axes.T

    def _earth_fixed(self, position: Array) -> Array:
        """Earth-fixed coordinates (..., 3) of points of this frame."""
        p = _validate.array("position", position, (None, 3), finite=False)
        result: Array = p @ self._axes + self._origin
        return result


class _Foot(NamedTuple):
    """Where the ellipsoid's normal through a point stands, and how high the point is above it.

    The cosine of the longitude is 0 on the Earth's axis, as is its sine.
    """

    cos_lat: Array
    sin_lat: Array
    cos_lon: Array
    sin_lon: Array
    height: Array


def _foot(point: Array) -> _Foot:
    """Feet of Earth-fixed points (..., 3), to rounding: Bowring's iteration (1976, 1985).

    Angles are kept as the sides of right triangles, so that a round costs one square root.
    pymap3d's closed form is exact at the ellipsoid only: 8 mm off at a height of 1000 km, tens of
    metres at that of a navigation satellite; it serves near the Earth's centre.
    """
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    rho = np.sqrt(x * x + y * y)
    r = np.sqrt(rho * rho + z * z)
    deep = r < DEEP
    if np.any(deep):
        return _deep_foot(point, deep)
    axis = np.maximum(rho, 1e-9)
    c, s = A * rho, z * (B + E2 * A**2 / r)  # reduced latitude, Bowring 1985
    for _ in range(ROUNDS):
        size = np.sqrt(c * c + s * s)
        c, s = c / size, s / size
        out, up = rho - E2 * A * (c * c * c), z + E2 * A**2 / B * (s * s * s)
        c, s = A * out, B * up
    size = np.sqrt(out * out + up * up)
    c, s = out / size, up / size
    h = rho * c + z * s - A * np.sqrt(1.0 - E2 * (s * s))
    return _Foot(c, s, x / axis, y / axis, h)


def _deep_foot(point: Array, deep: Mask) -> _Foot:
    """Feet of points of which some (...) are `deep`."""
    foot = _foot(np.where(deep[..., None], A, point))
    lat, lon, h = (np.asarray(v) for v in pymap3d.ecef2geodetic(*np.moveaxis(point, -1, 0)))
    lat, lon = np.radians(lat), np.radians(lon)
    low = np.cos(lat), np.sin(lat), np.cos(lon), np.sin(lon), h
    return _Foot(*(np.where(deep, a, b) for a, b in zip(low, foot, strict=True)))
