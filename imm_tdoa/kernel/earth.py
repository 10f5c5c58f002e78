"""Height above the WGS84 ellipsoid, one point at a time; what `EastNorthUp.height` computes."""

from __future__ import annotations

import math

from imm_tdoa.contract import Array
from imm_tdoa.kernel.compiling import compiled

A = 6378137.0  # WGS84 semi-major axis, m
B = 6356752.31424517929  # semi-minor axis, m
E2 = 1.0 - (B / A) ** 2


@compiled
def height(frame: Array, e: float, n: float, u: float) -> tuple[float, float, float, float]:
    """Height of the point (e, n, u) and its gradient in the local axes.

    `frame`, (12,): the axes' east, north and up in Earth-fixed axes, and the origin; up is z
    where the first number is NaN.
    """
    if math.isnan(frame[0]):
        return u, 0.0, 0.0, 1.0
    X = frame[9] + frame[0] * e + frame[3] * n + frame[6] * u
    Y = frame[10] + frame[1] * e + frame[4] * n + frame[7] * u
    Z = frame[11] + frame[2] * e + frame[5] * n + frame[8] * u
    rho = math.hypot(X, Y)
    phi = math.atan2(Z, rho * (1.0 - E2))
    for _ in range(4):  # Bowring 1976, to rounding from anywhere near the ellipsoid
        beta = math.atan2(B * math.sin(phi), A * math.cos(phi))
        s, c = math.sin(beta), math.cos(beta)
        phi = math.atan2(Z + E2 * A / B * A * (s * s * s), rho - E2 * A * (c * c * c))
    s, c = math.sin(phi), math.cos(phi)
    h = rho * c + Z * s - A * math.sqrt(1.0 - E2 * s * s)
    cos_lon = X / rho if rho > 0.0 else 1.0
    sin_lon = Y / rho if rho > 0.0 else 0.0
    nx, ny = c * cos_lon, c * sin_lon
    return (
        h,
        frame[0] * nx + frame[1] * ny + frame[2] * s,
        frame[3] * nx + frame[4] * ny + frame[5] * s,
        frame[6] * nx + frame[7] * ny + frame[8] * s,
    )
