"""One time difference of two stations as a Gaussian sum: places along the hyperbola's branch."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.gaussian_sum.hypotheses import Hypotheses


def hyperbola(
    measurement: MeasurementModel,
    time: float,
    values: Any,
    reach: float,
    *,
    count: int = 40,
) -> Hypotheses:
    """Return hypotheses along the branch on which one range difference puts an emitter.

    A range difference alone leaves a branch of a hyperbola with the two stations as foci. It is
    cut into `count` pieces that the line between the stations sees at about equal angles, short
    ones near it and long ones far out; each becomes a Gaussian as long as its piece and as wide
    as the noise and the piece's bending make it. The weights are those of an emitter that may be
    anywhere within `reach` with equal density (Okello, Fletcher, Mušicki & Ristic 2011 start
    two-station trackers this way).

    Parameters
    ----------
    measurement : MeasurementModel
        A `TDOA` of one pair of stations in two dimensions.
    time : float
        Time of the scan, s.
    values : (..., 1)
        The time difference, s.
    reach : float
        Largest distance of the emitter from the middle between the stations, m.
    count : int
        Number of pieces.

    Raises
    ------
    ValueError
        More than one pair, other than two dimensions, stations that are not heard at this time,
        a difference at least as large as the stations are apart, a reach no larger than that.
    """
    s = _foci(measurement, time)
    z = _validate.array("values", values, (None, 1))[..., 0] * measurement.scale[0]
    if isinstance(count, bool) or not isinstance(count, int) or count < 2:
        raise ValueError(f"count: expected a whole number of at least 2, got {count!r}")
    reach = _validate.positive("reach", reach)
    middle, along = 0.5 * (s[0] + s[1]), s[0] - s[1]
    half = 0.5 * float(np.linalg.norm(along))
    if np.any(np.abs(z) >= 2.0 * half):
        worst = float(z.flat[int(np.argmax(np.abs(z)))])
        raise ValueError(
            f"values: the range difference {worst:g} m is at least as large as the stations are "
            f"apart, {2.0 * half:g} m; no hyperbola has it"
        )
    if reach <= half:
        raise ValueError(
            f"reach: expected more than half the distance of the stations, {half:g} m, "
            f"got {reach!r}"
        )
    e = along / (2.0 * half)  # from the reference to the station
    a = -0.5 * z[..., None]  # signed: towards the station where the difference is negative
    b = np.sqrt(half**2 - a**2)
    end = np.arcsinh(np.sqrt(reach**2 - a**2) / half)  # |point|² = half² sinh² u + a²
    edges = end * np.linspace(-1.0, 1.0, count + 1)
    u = 0.5 * (edges[..., 1:] + edges[..., :-1])
    x, y = a * np.cosh(u), b * np.sinh(u)
    across = np.array([-e[1], e[0]])
    place = middle + x[..., None] * e + y[..., None] * across
    dx, dy = a * np.sinh(u), b * np.cosh(u)  # derivative in u
    speed = np.hypot(dx, dy)
    t = (dx[..., None] * e + dy[..., None] * across) / speed[..., None]
    piece = speed * np.diff(edges, axis=-1)
    bend = np.abs(a * b) / speed**3  # curvature
    if not np.allclose(_predicted(measurement, place, time), z[..., None], atol=1e-6 * reach):
        raise ValueError("measurement: expected time differences of stations, a TDOA")
    return _gaussians(measurement, time, place, t, piece, bend)


def _predicted(measurement: MeasurementModel, place: Array, time: float) -> Array:
    """Return the range differences (..., N) at places; NaN for what does not depend on them."""
    still = np.zeros_like(place)
    flat = np.all(measurement.jacobian(place, still, time)[0][..., 0, :] == 0.0, axis=-1)
    return np.where(flat, np.nan, measurement.predict(place, still, time)[..., 0])


def _gaussians(
    measurement: MeasurementModel, time: float, place: Array, t: Array, piece: Array, bend: Array
) -> Hypotheses:
    """Gaussians at places (..., N, 2) on pieces of a curve with tangents t (..., N, 2)."""
    still = np.zeros_like(place)
    H = measurement.jacobian(place, still, time)[0][..., 0, :]
    slope = np.linalg.norm(H, axis=-1)
    noise = measurement.noise_covariance(place, still, time)[..., 0, 0]
    length = piece**2 / 12.0  # variance of a place anywhere on the piece
    # A line that bends by k leaves its tangent by k s²/2: E[(k s²/2)²] = 3 k² var(s)² / 4.
    width = noise / slope**2 + 0.75 * (bend * length) ** 2
    n = np.stack([-t[..., 1], t[..., 0]], axis=-1)
    P = length[..., None, None] * t[..., :, None] * t[..., None, :]
    P = P + width[..., None, None] * n[..., :, None] * n[..., None, :]
    density = piece * np.sqrt(noise) / slope  # area of the strip that the noise leaves open
    return Hypotheses(place, P, density / np.sum(density, axis=-1, keepdims=True))


def _foci(measurement: Any, time: float) -> Array:
    """Return the pair's station and reference (2, 2) at `time`."""
    if getattr(measurement, "pairs", None) is None or not hasattr(measurement, "stations"):
        raise ValueError("measurement: expected time differences of stations, a TDOA")
    if measurement.dims != 2 or np.shape(measurement.pairs) != (1, 2):
        raise ValueError(
            f"measurement: expected one pair of stations in 2 dimensions, got "
            f"{measurement.size} in {measurement.dims}"
        )
    time = float(_validate.array("time", time, ()))
    s = measurement.stations.at(time)[0][measurement.pairs[0]]
    if not np.all(np.isfinite(s)):
        raise ValueError(f"time: not both stations are heard at {time:g} s")
    return np.asarray(s)
