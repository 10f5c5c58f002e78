"""Two-step fixes that know of receiver errors (Ho & Xu 2004; Source D; ALGORITHMS §3.3, §3.4)."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.locate import linear_steps
from imm_tdoa.locate.arguments import checked, refuse_too_few
from imm_tdoa.locate.epochs import Epochs
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.linear_steps import Weights
from imm_tdoa.locate.receiver_errors import judged
from imm_tdoa.scans import Scans
from imm_tdoa.stations import Stations

SecondStep = Literal["error-correction", "squared", "none"]


def two_step(
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
    second_step: SecondStep = "error-correction",
    receiver_weights: Weights = "both",
    reweight: int = 3,
) -> Fix:
    """Locate an emitter in closed form, by weights that know of the receivers' errors.

    The first step solves linear equations for position and range to one station (with range
    rates: and velocity and range rate) as if they were independent; the second imposes their
    relation. Within a few per cent of the Cramér-Rao bound at low and moderate noise.

    Parameters
    ----------
    stations : Stations
        The receivers, fixed or moving; the errors they declare (`position_covariance`,
        `velocity_covariance`) are weighed.
    tdoa : (..., m)
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
    time : float or (...)
        When each fix was measured, for moving stations, s.
    second_step : "error-correction", "squared" or "none"
        Estimate the first step's errors and take them off (§3.4); solve for squares (§3.3), which
        fails where the emitter shares a coordinate with the reference; or leave it at the first.
    receiver_weights : "both", "first" or "none"
        Whether the weights of both steps (D1 and D2), of the first alone, or of neither know of
        the receivers' errors. ``"none"`` can double the error.
    reweight : int
        Times the first step's weights are recomputed from the current estimate (corrected, with
        ``"error-correction"``).

    Returns
    -------
    Fix
        `covariance` is that of this estimator to first order, receiver errors included whatever
        the weights; `chi2` counts them too. NaN, and not converged, where the equations are
        singular: fewer than d + 2 stations heard, stations in a plane (2-D: line).

    Raises
    ------
    ValueError
        Arguments that do not fit; fewer than d + 2 stations.

    References
    ----------
    K. C. Ho and W. Xu, IEEE Trans. Signal Processing 52(9), 2453-2463, 2004 (first step, squared
    second step); C. Liu et al., Acta Aeronautica et Astronautica Sinica 36(5), 1617-1626, 2015
    (error correction).
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
    return _located(scans, scans.batch, second_step, receiver_weights, reweight)


def two_step_scans(
    scans: Scans,
    *,
    second_step: SecondStep = "error-correction",
    receiver_weights: Weights = "both",
    reweight: int = 3,
) -> Fix:
    """Locate from each scan by itself, as `two_step` does.

    Parameters
    ----------
    scans : Scans
        Values (..., T, m) of time differences, with or without range-rate differences.
    second_step, receiver_weights, reweight : optional
        As in `two_step`.

    Returns
    -------
    Fix
        With batch axes (..., T).

    Raises
    ------
    ValueError
        Other measurements; fewer than d + 2 stations.
    """
    every = (*scans.batch, scans.count)
    return _located(scans, every, second_step, receiver_weights, reweight)


def _located(
    scans: Scans,
    batch: tuple[int, ...],
    second_step: SecondStep,
    receiver_weights: Weights,
    reweight: int,
) -> Fix:
    """Return a fix of each scan, in batch axes that hold as many."""
    _refuse_unknown(second_step, receiver_weights, reweight)
    epochs = Epochs.of(scans)
    refuse_too_few(epochs.stations, epochs.dims + 2, "two_step")
    x, covariance = estimate(epochs, second_step, receiver_weights, reweight)
    return fix_of(epochs, x, covariance, 1 + reweight, batch)


def estimate(
    epochs: Epochs,
    second_step: SecondStep = "error-correction",
    receiver_weights: Weights = "both",
    reweight: int = 3,
) -> tuple[Array, Array]:
    """Return x (N, n) and its first-order covariance (N, n, n); NaN where singular."""
    first = linear_steps.first_step(epochs, receiver_weights)
    for _ in range(reweight):
        at = first.theta
        if second_step == "error-correction":  # nearer the truth than the first step
            last = linear_steps.error_correction(epochs, first, receiver_weights)
            at = linear_steps.with_ranges(epochs, last)
        first = linear_steps.first_step(epochs, receiver_weights, at)
    if second_step == "error-correction":
        last = linear_steps.error_correction(epochs, first, receiver_weights)
    elif second_step == "squared":
        last = linear_steps.squared(epochs, first, receiver_weights)
    else:
        last = linear_steps.no_step(epochs, first)
    reference = [epochs.s[:, 0], epochs.vs[:, 0]] if epochs.moving else [epochs.s[:, 0]]
    x = last.theta + np.concatenate(reference, axis=-1)
    covariance = last.errors @ np.swapaxes(last.errors, -1, -2)
    good = last.regular & np.isfinite(x).all(axis=-1)
    return np.where(good[:, None], x, np.nan), np.where(good[:, None, None], covariance, np.nan)


def fix_of(epochs: Epochs, x: Array, covariance: Array, passes: int, batch: tuple[int, ...]) -> Fix:
    """Return the fix at x (N, n), NaN where the geometry determines none."""
    d = epochs.dims
    _, chi2, good = judged(epochs, x)
    x = np.where(good[:, None], x, np.nan)
    covariance = np.where(good[:, None, None], covariance, np.nan)
    return Fix(
        position=x[:, :d].reshape(*batch, d),
        velocity=x[:, d:].reshape(*batch, d) if epochs.moving else None,
        covariance=covariance.reshape(*batch, *covariance.shape[1:]),
        converged=good.reshape(batch),
        iterations=np.full(batch, passes, dtype=np.int64),
        chi2=chi2.reshape(batch),
        dof=np.maximum(epochs.rows - epochs.unknowns, 0).reshape(batch),
    )


def _refuse_unknown(second_step: str, receiver_weights: str, reweight: int) -> None:
    _validate.one_of("second_step", second_step, get_args(SecondStep))
    _validate.one_of("receiver_weights", receiver_weights, get_args(Weights))
    if isinstance(reweight, bool) or not isinstance(reweight, int) or reweight < 0:
        raise ValueError(f"reweight: expected a whole number of at least 0, got {reweight!r}")
