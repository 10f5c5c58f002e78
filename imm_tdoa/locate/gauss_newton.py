"""Fixes by damped Gauss-Newton iteration (Foy 1976; ALGORITHMS §3.1)."""

from __future__ import annotations

from typing import Any, Literal

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa._validate import array
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.locate.choice import choose
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.guess import ranked, starting_points
from imm_tdoa.locate.least_squares import Solution, solve, student_cost
from imm_tdoa.locate.problem import Problem
from imm_tdoa.makeup import RANGE_RATE
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations, pair_index

CHUNK = 4000  # fits searched for at a time; bounds the memory of large batches


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
    and begun from several points in closed form and around the stations, so that it finds the
    global minimum and any mirror solution.

    Parameters
    ----------
    stations : Stations
        The receivers; position errors they declare are part of the noise.
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
        range rates: that moves straight on; the fix is at the last time), s.
    initial : (..., d), optional
        Position to start from instead of searching; no mirror is looked for then.
    robust : None or "student-t"
        ``"student-t"``: iteratively re-weighted, so that gross errors do not pull. With
        `toa_sigma` and one reference for all differences the arrivals are judged, so that a
        gross error at the reference is found too; otherwise each difference for itself.

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
    rates = None
    if range_rate is not None:
        rates = array("range_rate", range_rate, values.shape, finite=False)
    index = pair_index(pairs, stations)
    starry = np.all(index[:, 1] == index[0, 1]) and len(np.unique(index[:, 0])) == len(index)
    if robust is not None and toa_sigma is not None and starry:
        values = _undifferenced(values, index, len(stations))
        measurement = registry.load("toa")(stations, sigma=toa_sigma, speed=speed)
        other = "range-rate", {"sigma": range_rate_sigma}
        rates = None if rates is None else _undifferenced(rates, index, len(stations))
    else:
        other = "fdoa", {"range_rate_sigma": range_rate_sigma, "pairs": pairs}
    if rates is not None:
        second = registry.load(other[0])(stations, **other[1])
        measurement = registry.load("stack")(measurement, second)
        values = np.concatenate([values, rates], axis=-1)
    stamps = np.zeros(1) if times is None else times
    if times is None:
        values = values[..., None, :]
    scans = Scans.checked(measurement, stamps, values)
    return fix_scans(scans, moving=rates is not None, initial=initial, robust=robust)


def _undifferenced(values: Array, index: Index, S: int) -> Array:
    """Arrivals (..., S) up to a constant from differences against one reference."""
    result = np.full((*values.shape[:-1], S), np.nan)
    result[..., index[:, 0]] = values
    result[..., index[0, 1]] = np.where(np.isfinite(values).any(axis=-1), 0.0, np.nan)
    return result


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

    Raises
    ------
    ValueError
        A scan shape with fewer independent rows than unknowns.
    """
    if robust not in (None, "student-t"):
        raise ValueError(f"robust: expected None or 'student-t', got {robust!r}")
    if moving and velocity_std is not None and _silent_on_velocity(scans):
        fix = fix_scans(scans, initial=initial, robust=robust)
        return _with_velocity(fix, velocity_std)
    problem = Problem.of(scans, moving, velocity_std)
    _refuse_too_few(problem)
    heavy_tails = robust is not None
    B, d = len(problem.z), problem.dims
    if initial is not None:
        point = np.broadcast_to(array("initial", initial, (None, d)), (*scans.batch, d))
        theta, _ = ranked(problem, point.reshape(B, 1, d))
        solution = solve(problem, theta[:, 0], np.arange(B), robust=heavy_tails)
        return _fix(problem, solution, scans.batch)
    parts = []
    for first in range(0, B, CHUNK):
        part = problem.part(slice(first, first + CHUNK))
        theta, fit = starting_points(part, robust=heavy_tails)
        parts.append(solve(part, theta, fit, robust=heavy_tails))
    return _fix(problem, Solution.joined(parts), scans.batch)


def _silent_on_velocity(scans: Scans) -> bool:
    """Whether nothing in the scans depends on the velocity: one scan, and no rates in it."""
    says = getattr(scans.measurement, "makeup", None)
    made = None if says is None or scans.count > 1 else says()
    return made is not None and not np.any(made.kind == RANGE_RATE)


def _with_velocity(fix: Fix, std: Array) -> Fix:
    """Return a fix of the position with a velocity of which only the prior is known."""
    *batch, d = fix.position.shape
    known = np.isfinite(fix.covariance[..., :1, :1])
    covariance = np.zeros((*batch, 2 * d, 2 * d))
    covariance[..., :d, :d] = fix.covariance
    covariance[..., d:, d:] = np.diag(std**2)
    return attrs.evolve(
        fix,
        velocity=np.where(np.isfinite(fix.position), 0.0, np.nan),
        covariance=np.where(known, covariance, np.nan),
    )


def _fix(problem: Problem, solution: Solution, batch: tuple[int, ...]) -> Fix:
    """Choose the best of each fit's K solutions and name its rival."""
    d, B = problem.dims, len(problem.z)
    K = len(solution.theta) // B
    rank = solution.chi2 if solution.weight is None else student_cost(solution.standardised)
    usable = solution.converged
    C = np.where(usable[:, None, None], solution.covariance[:, :d, :d], np.eye(d))
    index, mirror = choose(
        solution.theta[:, :d].reshape(B, K, d),
        rank.reshape(B, K),
        usable.reshape(B, K),
        np.linalg.inv(C).reshape(B, K, d, d),
        problem.stations_heard()[0],
    )
    best = np.arange(B) * K + index
    theta, covariance = solution.theta[best], solution.covariance[best]
    determined = np.asarray(np.isfinite(covariance).all(axis=(-2, -1)))
    theta = np.where(determined[:, None], theta, np.nan)
    weight = None
    if solution.weight is not None:
        weight = np.ones((B, *problem.scans.values.shape[1:]))
        weight[..., problem.rows] = solution.weight[best]
        weight = weight.reshape(*batch, *weight.shape[1:])
    unknowns = d if problem.velocity_std is not None else problem.unknowns
    return Fix(
        position=theta[:, :d].reshape(*batch, d),
        velocity=theta[:, d:].reshape(*batch, d) if problem.moving else None,
        covariance=covariance.reshape(*batch, *covariance.shape[1:]),
        converged=solution.converged[best].reshape(batch),
        iterations=solution.iterations[best].reshape(batch),
        chi2=solution.chi2[best].reshape(batch),
        dof=np.maximum(problem.equations() - unknowns, 0).reshape(batch),
        mirror=None if np.all(np.isnan(mirror)) else mirror.reshape(*batch, d),
        weight=weight,
    )


def _refuse_too_few(problem: Problem) -> None:
    """Refuse scans of a shape that can never determine a position, whatever their values."""
    scans, needed = problem.scans, problem.unknowns
    if problem.velocity_std is not None:
        needed = problem.dims
    every = np.ones((scans.count, scans.measurement.size), dtype=bool)
    independent = scans.together().independent(every)
    rows = int(np.max(problem.independent_rows(independent), initial=0))
    if rows < needed:
        raise ValueError(
            f"stations: {rows} independent measurements cannot determine {needed} unknowns; "
            f"expected at least {needed} differences ({needed + 1} stations)"
        )
