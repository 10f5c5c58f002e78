"""Where to begin: starting points around the stations, for any measurement model."""

from __future__ import annotations

from itertools import product

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.locate.least_squares import Problem, system

RADII = (0.15, 0.5, 1.0, 2.0, 5.0, 20.0)  # times the spread of the stations that heard
KEPT = 8


def starting_points(problem: Problem) -> Array:
    """Return starting points theta (..., KEPT, n): the best of a star around the stations.

    The star's centre is the middle of the stations that heard the emission, its arms point to
    every octant and along every axis, its radii follow the spread of those stations. Points are
    ranked by their residuals; neighbours on one arm count once, so that another root of the
    equations (a mirror solution) has its chance.
    """
    centre, spread = _stations_heard(problem)
    arms = _arms(centre.shape[-1])
    radii = np.array(RADII)
    star = centre[..., None, None, :] + (
        spread[..., None, None, None] * radii[:, None] * arms[:, None, :]
    )  # (..., arms, radii, d)
    cost = _cost(problem, star.reshape(*star.shape[:-3], -1, star.shape[-1]))
    cost = cost.reshape(star.shape[:-1])
    best = np.argmin(cost, axis=-1)
    per_arm = np.take_along_axis(star, best[..., None, None], axis=-2)[..., 0, :]
    per_arm_cost = np.take_along_axis(cost, best[..., None], axis=-1)[..., 0]
    middle = centre[..., None, :]
    points = np.concatenate([per_arm, middle], axis=-2)
    costs = np.concatenate([per_arm_cost, _cost(problem, middle)], axis=-1)
    order = np.argsort(costs, axis=-1)[..., :KEPT]
    points = np.take_along_axis(points, order[..., None], axis=-2)
    return _with_rest(problem, points)


def _with_rest(problem: Problem, points: Array) -> Array:
    if not problem.moving:
        return points
    return np.concatenate([points, np.zeros_like(points)], axis=-1)


def _cost(problem: Problem, points: Array) -> Array:
    """Bounded misfit (...): one gross row must not hide the right place."""
    at = system(with_start_axis(problem), _with_rest(problem, points))
    return np.sum(np.log1p(at.r**2), axis=-1)


def with_start_axis(problem: Problem) -> Problem:
    """The same problem with an axis for starting points before the time axis."""
    scans = problem.scans
    times = scans.times if scans.times.ndim == 1 else scans.times[..., None, :]
    pairs = scans.pairs
    if pairs is not None and pairs.ndim > 3:
        pairs = pairs[..., None, :, :, :]
    reference = np.asarray(problem.reference)
    return attrs.evolve(
        problem,
        scans=attrs.evolve(scans, times=times, values=scans.values[..., None, :, :], pairs=pairs),
        reference=reference if reference.ndim == 0 else reference[..., None],
    )


def _arms(d: int) -> Array:
    corners = np.array([c for c in product((-1.0, 0.0, 1.0), repeat=d) if any(c)])
    result: Array = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    return result


def _stations_heard(problem: Problem) -> tuple[Array, Array]:
    """Centre (..., d) and spread (...) of the stations that heard something."""
    scans = problem.scans
    where = scans.together().anchors(scans.times, np.isfinite(scans.values))
    if where.shape[-2] == 0:
        batch, d = scans.batch, scans.measurement.dims
        return np.zeros((*batch, d)), np.ones(batch)
    where = where.reshape(*where.shape[:-3], -1, where.shape[-1])
    known = np.isfinite(where).all(axis=-1)
    count = np.maximum(np.count_nonzero(known, axis=-1), 1)[..., None]
    where = np.where(known[..., None], where, 0.0)
    centre = np.sum(where, axis=-2) / count
    away = np.where(known[..., None], where - centre[..., None, :], 0.0)
    spread = np.sqrt(np.sum(away**2, axis=(-2, -1)) / count[..., 0])
    return centre, np.where(spread > 0.0, spread, 1.0)
