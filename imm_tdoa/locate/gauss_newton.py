"""Fixes by damped Gauss-Newton iteration (Foy 1976; ALGORITHMS §3.1)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from imm_tdoa import registry
from imm_tdoa._validate import array
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.guess import starting_points, with_start_axis
from imm_tdoa.locate.least_squares import Problem, Solution, solve, solve_robust, student_cost
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations

MIRROR_CHI2 = 9.0  # a second solution within this of the best chi2 is a rival
MIRROR_DISTANCE = 25.0  # squared distance, in covariances of the first, that makes it another


def gauss_newton(
    stations: Stations,
    tdoa: Any,
    *,
    toa_sigma: Any = None,
    tdoa_sigma: Any = None,
    pairs: Any = "reference",
    speed: float = 299792458.0,
    range_rate: Any = None,
    range_rate_sigma: Any = None,
    times: Any = None,
    initial: Any = None,
    robust: Literal["student-t"] | None = None,
) -> Fix:
    """Locate an emitter by weighted least squares on time differences of arrival.

    Damped (Levenberg-Marquardt), whitened by the Cholesky factor of the full noise covariance,
    and begun from several points around the stations, so that it finds the global minimum and
    any mirror solution.

    Parameters
    ----------
    stations : Stations
        The receivers.
    tdoa : (..., m) or (..., T, m) with `times`
        Arrival-time differences, s; NaN is missing. Leading axes are separate fixes.
    toa_sigma, tdoa_sigma : float or array
        Exactly one: standard deviation per arrival (S,) or per difference (m,), s.
    pairs : "reference", "adjacent" or (m, 2)
        Which differences `tdoa` holds.
    speed : float
        Signal speed, m/s.
    range_rate, range_rate_sigma : optional
        Range-rate differences of the same pairs, m/s, like `tdoa`, and their standard deviation
        per station, m/s: the velocity is estimated too.
    times : (T,), optional
        Times of several epochs that are to give one fix of an emitter that stands (with
        range rates: that moves straight on from the last time back), s.
    initial : (..., d), optional
        Position to start from instead of searching; no mirror is looked for then.
    robust : None or "student-t"
        ``"student-t"``: iteratively re-weighted, so that gross errors do not pull.

    Returns
    -------
    Fix
        With `converged`, `chi2` and a `mirror` where a second position fits as well.

    Raises
    ------
    ValueError
        Shapes, sigmas or pairs that do not fit; fewer differences than unknowns.
    """
    measurement: MeasurementModel = registry.load("tdoa")(
        stations, toa_sigma=toa_sigma, tdoa_sigma=tdoa_sigma, pairs=pairs, speed=speed
    )
    values = array("tdoa", tdoa, (None, measurement.size), finite=False)
    if (range_rate is None) != (range_rate_sigma is None):
        raise ValueError("range_rate: give range_rate and range_rate_sigma together")
    if range_rate is not None:
        fdoa = registry.load("fdoa")(stations, range_rate_sigma=range_rate_sigma, pairs=pairs)
        rates = array("range_rate", range_rate, values.shape, finite=False)
        measurement = registry.load("stack")(measurement, fdoa)
        values = np.concatenate([values, rates], axis=-1)
    stamps = np.zeros(1) if times is None else times
    if times is None:
        values = values[..., None, :]
    scans = Scans.checked(measurement, stamps, values)
    return fix_scans(scans, moving=range_rate is not None, initial=initial, robust=robust)


def fix_scans(
    scans: Scans,
    *,
    moving: bool = False,
    velocity_std: Array | None = None,
    initial: Any = None,
    robust: Literal["student-t"] | None = None,
) -> Fix:
    """Locate from scans of any measurement model: one position, or one straight motion.

    Parameters
    ----------
    scans : Scans
        Values (..., T, m); all T scans together give one fix at the last scan's time.
    moving : bool
        Whether the velocity is unknown too.
    velocity_std : (d,), optional
        Standard deviation of a zero-mean prior on the velocity, m/s.
    initial : (..., d), optional
        Position to start from instead of searching.
    robust : None or "student-t"
        Whether gross errors may pull.
    """
    if robust not in (None, "student-t"):
        raise ValueError(f"robust: expected None or 'student-t', got {robust!r}")
    problem = Problem(scans, scans.times[..., -1], moving, velocity_std)
    d = scans.measurement.dims
    _refuse_too_few(problem)
    if initial is None:
        theta = starting_points(problem)
    else:
        point = np.broadcast_to(array("initial", initial, (None, d)), (*scans.batch, d))
        rest = np.zeros((*scans.batch, problem.unknowns - d))
        theta = np.concatenate([point, rest], axis=-1)[..., None, :]
    wide = with_start_axis(problem)
    if robust is None:
        solution, weight = solve(wide, theta), None
        rank = solution.chi2
    else:
        solution, weight = solve_robust(wide, theta)
        rank = student_cost(solution.standardised)
    return _fix(problem, solution, rank, weight)


def _fix(problem: Problem, solution: Solution, rank: Array, weight: Array | None) -> Fix:
    """Choose the best of the solutions (..., starts) and name its rival."""
    d = problem.scans.measurement.dims
    rank = np.where(np.isfinite(rank), rank, np.inf)
    rank = np.where(solution.converged, rank, rank + 1e6 * (1.0 + np.abs(rank)))
    best = np.argmin(rank, axis=-1)

    def pick(a: Array, trailing: int) -> Array:
        index = best.reshape(best.shape + (1,) * (trailing + 1))
        return np.take_along_axis(a, index, axis=a.ndim - trailing - 1).squeeze(
            a.ndim - trailing - 1
        )

    theta, covariance = pick(solution.theta, 1), pick(solution.covariance, 2)
    converged = pick(solution.converged, 0)
    mirror = _mirror(solution, rank, pick(rank, 0), theta[..., :d], covariance[..., :d, :d])
    rows = pick(solution.rows, 0)
    unknowns = d if problem.velocity_std is not None else problem.unknowns
    return Fix(
        position=theta[..., :d],
        velocity=theta[..., d:] if problem.moving else None,
        covariance=covariance,
        converged=converged,
        iterations=pick(solution.iterations, 0),
        chi2=pick(solution.chi2, 0),
        dof=np.maximum(rows - unknowns, 0),
        mirror=None if np.all(np.isnan(mirror)) else mirror,
        weight=None if weight is None else pick(weight, 2),
    )


def _mirror(
    solution: Solution, rank: Array, least: Array, position: Array, covariance: Array
) -> Array:
    """The best other converged solution (..., d) that is a rival of the first, or NaN."""
    d = position.shape[-1]
    usable = np.isfinite(covariance).all(axis=(-2, -1))
    C = np.where(usable[..., None, None], covariance, np.eye(d))
    delta = solution.theta[..., :d] - position[..., None, :]
    away = np.einsum(
        "...si,...si->...s",
        delta,
        np.swapaxes(np.linalg.solve(C, np.swapaxes(delta, -1, -2)), -1, -2),
    )
    rival = solution.converged & (away > MIRROR_DISTANCE) & usable[..., None]
    rival &= rank <= least[..., None] + MIRROR_CHI2
    second = np.argmin(np.where(rival, rank, np.inf), axis=-1)[..., None]
    found = np.take_along_axis(solution.theta[..., :d], second[..., None], axis=-2)[..., 0, :]
    result: Array = np.where(np.any(rival, axis=-1)[..., None], found, np.nan)
    return result


def _refuse_too_few(problem: Problem) -> None:
    """Refuse a scan shape that can never determine a position, whatever its values."""
    measurement = problem.scans.measurement
    groups = measurement.offset_group
    shared = len(np.unique(groups[groups >= 0]))
    rows = (measurement.size - shared) * problem.scans.count
    needed = problem.unknowns - (0 if problem.velocity_std is None else measurement.dims)
    if rows < needed:
        raise ValueError(
            f"stations: {rows} independent measurements cannot determine {needed} unknowns; "
            f"expected at least {needed} differences ({needed + 1} stations)"
        )
