"""Ranges, directions and range rates between stations and an emitter (ALGORITHMS §0, §1).

Pure functions on arrays. Positions `p` and velocities `v` are (..., d), station positions `s`
and velocities `vs` are (..., S, d); leading axes broadcast. Units: m, m/s.
"""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index


def ranges(p: Array, s: Array) -> tuple[Array, Array]:
    """Return ranges r (..., S) and unit vectors u (..., S, d) from each station to `p`.

    At a station the direction is undefined; it is returned as zero there, so that the derivative
    of the range is the middle of its subgradient instead of NaN.

    Parameters
    ----------
    p : (..., d)
        Emitter, m.
    s : (..., S, d)
        Stations, m.
    """
    delta = p[..., None, :] - s
    r = np.sqrt(np.einsum("...i,...i->...", delta, delta))
    u = delta / np.where(r > 0.0, r, 1.0)[..., None]
    return r, u


def range_rates(p: Array, v: Array, s: Array, vs: Array) -> tuple[Array, Array, Array]:
    """Return range rates (..., S), their gradients b (..., S, d) in `p`, and u (..., S, d).

    The derivative of a range rate with respect to velocity is u (§1.2).

    Parameters
    ----------
    p, v : (..., d)
        Position and velocity of the emitter, m and m/s.
    s, vs : (..., S, d)
        Positions and velocities of the stations.
    """
    r, u = ranges(p, s)
    w = v[..., None, :] - vs
    rate = np.einsum("...i,...i->...", u, w)
    b = (w - rate[..., None] * u) / np.where(r > 0.0, r, 1.0)[..., None]
    return rate, b, u


def difference(rows: Array, pairs: Index, axis: int = -1) -> Array:
    """Return rows[station] - rows[reference] along `axis` for pairs (..., m, 2).

    `axis` counts from the end: -1 for rows (..., S), -2 for rows (..., S, d).

    Parameters
    ----------
    rows : (..., S) or (..., S, d)
        One value, or vector, per station.
    pairs : (..., m, 2)
        Station and reference of each difference.
    axis : int
        That of the stations, from the end: -1 or -2.
    """
    if pairs.ndim == 2:
        return np.take(rows, pairs[:, 0], axis=axis) - np.take(rows, pairs[:, 1], axis=axis)
    station, reference = pairs[..., 0], pairs[..., 1]
    for _ in range(-axis - 1):
        station, reference = station[..., None], reference[..., None]
    batch = np.broadcast_shapes(rows.shape[:axis], pairs.shape[:-2])
    rows = np.broadcast_to(rows, batch + rows.shape[axis:])

    def take(index: Index) -> Array:
        shape = batch + index.shape[pairs.ndim - 2 :]
        taken: Array = np.take_along_axis(rows, np.broadcast_to(index, shape), axis=axis)
        return taken

    return take(station) - take(reference)


def difference_covariance(variance: Array, pairs: Index) -> Array:
    """Covariance (..., m, m) of differences of independent errors (§1.1).

    Differences that share a station are correlated: the full matrix D diag(variance) D'.

    Parameters
    ----------
    variance : (..., S)
        Variance per station.
    pairs : (..., m, 2)
        Station and reference of each difference.
    """
    D = incidence(pairs, variance.shape[-1])
    result: Array = np.einsum("...is,...s,...js->...ij", D, variance, D)
    return result


def incidence(pairs: Index, stations: int) -> Array:
    """Matrix D (..., m, S) that takes one value per station to differences.

    Parameters
    ----------
    pairs : (..., m, 2)
        Station and reference of each difference.
    stations : int
        Number of stations S.
    """
    one = np.eye(stations)
    result: Array = one[pairs[..., 0]] - one[pairs[..., 1]]
    return result
