"""Fixes that estimate emitter and receivers together (Source D; ALGORITHMS §3.5)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.locate.arguments import checked, refuse_too_few
from imm_tdoa.locate.epochs import Epochs
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.locate.joint_descent import descend, station_covariance
from imm_tdoa.locate.joint_fix import JointFix
from imm_tdoa.locate.receiver_errors import judged, receivers
from imm_tdoa.locate.two_step import estimate
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations

Initial = Literal["two-step", "gauss-newton"]
SPEED_STD = 3000.0  # m/s; begins the search for fixes whose range rates tell no velocity


def joint(
    stations: Stations,
    tdoa: Any,
    *,
    toa_sigma: Any = None,
    tdoa_sigma: Any = None,
    pairs: Any = "reference",
    speed: float = 299792458.0,
    range_rate: Any = None,
    range_rate_sigma: Any = None,
    time: Any = 0.0,
    initial: Initial = "two-step",
    iterations: int = 10,
) -> JointFix:
    """Locate an emitter and correct the receivers by damped Taylor iteration over both.

    Weighted least squares on the measurements and on the receivers' declared places together.
    Without declared errors the receivers stay where they are.

    Parameters
    ----------
    stations : Stations
        The receivers, fixed or moving, with the errors they declare (`position_covariance`,
        `velocity_covariance`).
    tdoa : (..., m)
        Arrival-time differences, s; NaN is missing. Leading axes are separate fixes, each with
        receiver errors of its own.
    toa_sigma, tdoa_sigma : float or array
        Exactly one: standard deviation per arrival (S,) or per difference (m,), s.
    pairs : "reference", "adjacent" or (m, 2)
        Which differences `tdoa` holds.
    speed : float
        Signal speed, m/s.
    range_rate, range_rate_sigma : optional
        Range-rate differences of the same pairs, m/s, like `tdoa`, and their standard deviation
        per station, m/s: the velocity is estimated too.
    time : float or (...)
        When each fix was measured, for moving stations, s.
    initial : "two-step" or "gauss-newton"
        Where to begin; where `two_step` finds nothing (fewer than d + 2 stations, a flat array)
        or what leads nowhere, `gauss_newton` is asked anyway.
    iterations : int
        Most steps tried from one beginning.

    Returns
    -------
    JointFix
        Where no minimum was reached, the initial value and the declared receivers, `converged`
        False. `covariance` is the bound with receiver errors at the fix; `mirror` is that of
        `gauss_newton`, where it was asked.

    Raises
    ------
    ValueError
        Arguments that do not fit; fewer than d + 1 stations.

    References
    ----------
    H. Xiong et al., CN112444776A, 2021 (Source D).
    """
    scans = checked(
        stations,
        tdoa,
        toa_sigma=toa_sigma,
        tdoa_sigma=tdoa_sigma,
        pairs=pairs,
        speed=speed,
        range_rate=range_rate,
        range_rate_sigma=range_rate_sigma,
        time=time,
    )
    return _located(scans, scans.batch, initial, iterations)


def joint_scans(scans: Scans, *, initial: Initial = "two-step", iterations: int = 10) -> JointFix:
    """Locate from each scan by itself, as `joint` does.

    Parameters
    ----------
    scans : Scans
        Values (..., T, m) of time differences, with or without range-rate differences.
    initial, iterations : optional
        As in `joint`.

    Returns
    -------
    JointFix
        With batch axes (..., T).

    Raises
    ------
    ValueError
        Other measurements; fewer than d + 1 stations.
    """
    return _located(scans, (*scans.batch, scans.count), initial, iterations)


def _located(scans: Scans, batch: tuple[int, ...], initial: Initial, iterations: int) -> JointFix:
    """Return a fix of each scan, in batch axes that hold as many."""
    _refuse_unknown(initial, iterations)
    epochs, single = Epochs.of(scans), scans.apart()
    refuse_too_few(epochs.stations, epochs.dims + 1, "joint")
    d, N = epochs.dims, len(epochs.z)
    start, mirror = np.full((N, epochs.unknowns), np.nan), np.full((N, d), np.nan)
    if initial == "two-step" and len(epochs.stations) >= d + 2:
        start, _ = estimate(epochs)
        start = np.where(judged(epochs, start)[2][:, None], start, np.nan)
    found = descend(epochs, start, iterations)
    lost = np.flatnonzero(~found.arrived)
    if lost.size:
        other, mirror[lost] = _searched(epochs, single, lost)
        again = descend(epochs.part(lost), other, iterations)
        nowhere = ~np.isfinite(start[lost]).all(axis=-1)
        start[lost[nowhere]] = other[nowhere]
        for old, new in zip(found, again, strict=True):
            old[lost[again.arrived]] = new[again.arrived]
    x = np.where(found.arrived[:, None], found.x, start)
    w = np.where(found.arrived[:, None], found.w, 0.0)
    covariance, chi2, good = judged(epochs, x)
    x = np.where(good[:, None], x, np.nan)
    chi2 = np.where(found.arrived, found.cost + epochs.excess, chi2)
    mirror = np.where((good & found.arrived)[:, None], mirror, np.nan)
    places, velocities, spreads = _stations(epochs, x, w, good)
    return JointFix(
        position=x[:, :d].reshape(*batch, d),
        velocity=x[:, d:].reshape(*batch, d) if epochs.moving else None,
        covariance=covariance.reshape(*batch, *covariance.shape[1:]),
        converged=(found.arrived & good).reshape(batch),
        iterations=found.iterations.reshape(batch),
        chi2=np.where(good, chi2, np.nan).reshape(batch),
        dof=np.maximum(epochs.rows - epochs.unknowns, 0).reshape(batch),
        mirror=None if np.all(np.isnan(mirror)) else mirror.reshape(*batch, d),
        stations=places.reshape(*batch, *places.shape[1:]),
        station_velocities=velocities.reshape(*batch, *places.shape[1:]),
        station_covariance=spreads.reshape(*batch, *spreads.shape[1:]),
    )


def _searched(epochs: Epochs, scans: Scans, which: Any) -> tuple[Array, Array]:
    """Where `gauss_newton` sees the emitters of some epochs: x (M, n), and mirrors (M, d)."""
    d = epochs.dims
    pairs = None if scans.pairs is None else scans.pairs[which]
    some = Scans(scans.measurement, scans.times[which], scans.values[which], pairs)
    std = np.full(d, SPEED_STD) if epochs.moving else None
    try:
        fix = fix_scans(some, moving=epochs.moving, velocity_std=std)
    except ValueError:
        if np.max(epochs.rows[which]) >= epochs.unknowns:
            raise
        nothing = np.full((len(which), d), np.nan)
        return np.full((len(which), epochs.unknowns), np.nan), nothing
    x = fix.position if fix.velocity is None else np.concatenate([fix.position, fix.velocity], -1)
    usable = fix.converged & (epochs.rows[which] >= epochs.unknowns)
    mirror = np.full((len(which), d), np.nan) if fix.mirror is None else fix.mirror
    return np.where(usable[:, None], x, np.nan), mirror


def _stations(epochs: Epochs, x: Array, w: Array, good: Any) -> tuple[Array, Array, Array]:
    """Positions and velocities (N, S, d) of all stations, and their covariances (N, S, d, d)."""
    N, S, d = len(x), len(epochs.stations), epochs.dims
    declared = epochs.stations.position_covariance
    spread = np.broadcast_to(np.zeros((S, d, d)) if declared is None else declared, (N, S, d, d))
    place, velocity, spread = (np.array(a) for a in (*epochs.declared, spread))
    row, column = np.nonzero((epochs.station >= 0) & good[:, None])
    station = epochs.station[row, column]
    at, moved = receivers(epochs, w)
    place[row, station] = at[row, column]
    velocity[row, station] = moved[row, column]
    if declared is not None:
        own = station_covariance(epochs, np.where(good[:, None], x, 0.0), w)
        spread[row, station] = own[row, column]
    return place, velocity, spread


def _refuse_unknown(initial: str, iterations: int) -> None:
    _validate.one_of("initial", initial, ("two-step", "gauss-newton"))
    if isinstance(iterations, bool) or not isinstance(iterations, int) or iterations < 1:
        raise ValueError(f"iterations: expected a whole number of at least 1, got {iterations!r}")
