"""Whether feeding the position increment back lets the spot shrink (ALGORITHMS §6.1, §6.2)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Mask
from imm_tdoa.geometry import difference, difference_covariance, ranges
from imm_tdoa.stations import Stations, pair_index

Rule = Literal["iso", "proj", "bound"]
Weights = Literal["full", "diagonal"]
RULES = ("iso", "proj", "bound")
WEIGHTS = ("full", "diagonal")
ROUNDS = 60  # of the iteration that finds the loop gain of "proj"


def increment_factor(rule: Rule, dims: int) -> float:
    """Return a in Q = a |Δs|²: 2/d for ``iso``, the mean of (cos a - cos b)²; 4 for ``bound``."""
    return 4.0 if rule == "bound" else 2.0 / dims


def process_noise(rule: Rule, increment: Array, G: Array) -> Array:
    """Return Q (..., m), m², of each sequence for a position increment (..., d), m.

    Parameters
    ----------
    rule : "iso", "proj" or "bound"
        ``iso``: a |Δs|² with a = 2/d, the mean over independent isotropic directions to the two
        stations (1 in two dimensions, 2/3 in three). ``proj``: (g_i' Δs)², g_i the sequence's own
        gradient. ``bound``: 4 |Δs|², the most that a difference of two ranges can change.
    G : (..., m, d)
        Gradients of the range differences by the position.
    """
    if rule == "proj":
        along: Array = np.einsum("...md,...d->...m", G, increment)
        return along**2
    square = increment_factor(rule, G.shape[-1]) * np.einsum("...d,...d->...", increment, increment)
    return np.broadcast_to(square[..., None], G.shape[:-1])


def pseudo_inverse(G: Array, R: Array, present: Mask) -> Array:
    """Return (G'WG)^-1 G'W (..., d, m), W the inverse of R over `present` rows; 0 elsewhere.

    NaN where the present rows do not determine a position.
    """
    if np.all(present):  # one inverse may serve all
        W = np.linalg.inv(R)
    else:
        both = present[..., :, None] & present[..., None, :]
        W = np.where(both, np.linalg.inv(np.where(both, R, np.eye(R.shape[-1]))), 0.0)
        G = np.where(present[..., None], G, 0.0)
    GW = np.swapaxes(G, -1, -2) @ W
    A = GW @ G
    size = np.einsum("...ii->...", A)
    good = np.isfinite(size) & (size > 0.0)
    A = np.where(good[..., None, None], A, np.eye(A.shape[-1]))
    good &= np.linalg.eigvalsh(A)[..., 0] > 1e-12 * np.where(good, size, 1.0)
    A = np.where(good[..., None, None], A, np.eye(A.shape[-1]))
    result: Array = np.where(good[..., None, None], np.linalg.solve(A, GW), np.nan)
    return result


def loop_gain(rule: Rule, G: Array, inverse: Array, correlation: Array) -> Array:
    """Return kappa (...) at multiplier 1 of a fix that moves by `inverse` (..., d, m) per row.

    Parameters
    ----------
    G : (..., m, d)
        Gradients of the range differences.
    correlation : (..., m, m)
        Correlation of the measured differences.
    """
    if rule != "proj":
        spread = np.einsum("...dm,...mn,...dn->...", inverse, correlation, inverse)
        return np.asarray(increment_factor(rule, G.shape[-1]) * spread)
    hat = G @ inverse
    q = np.ones(hat.shape[:-1])
    growth = np.ones(hat.shape[:-2])
    for _ in range(ROUNDS):
        part = hat * np.sqrt(q)[..., None, :]
        q = np.einsum("...im,...mn,...in->...i", part, correlation, part)
        growth = np.max(q, axis=-1)
        q = q / np.where(growth > 0.0, growth, 1.0)[..., None]
    return growth


def kappa(
    stations: Stations,
    position: Any,
    rule: Rule = "iso",
    *,
    multiplier: float = 1.0,
    weights: Weights = "full",
    time: float | Array = 0.0,
) -> Array:
    """Return the loop gain of the sequence filter for a target that stands (§6.2).

    The process noise Q is taken from the position increment, and the position moves because
    there is Q: with a small gain K = sqrt(Q/R) the filtered differences move by K times their
    innovations, the fix by G+ of that, so Q becomes kappa Q. Below 1 the gain decays and the spot
    of fixes shrinks to a point; above 1 the gain settles at a value at which little is gained.
    For ``iso`` and ``bound``

        kappa = multiplier a tr(G+ T G+'),   a = 2/d or 4,   T = tridiag(-1/2, 1, -1/2),

    which is multiplier times a times the squared ratio of the rms error of the raw fix to the
    standard deviation of one range difference. For ``proj``, whose noise differs from sequence
    to sequence, it is the factor by which the largest Q grows from epoch to epoch once the
    ratios between them have settled: 1 where the fix has no difference to spare, about as much or
    less elsewhere, whatever the dilution.

    Parameters
    ----------
    stations : Stations
        The receivers, in the order in which adjacent ones are differenced.
    position : (..., d)
        Where the target is, m.
    rule : "iso", "proj" or "bound"
        How Q follows from the increment.
    multiplier : float
        Factor on Q.
    weights : "full" or "diagonal"
        Whether the fix weighs the differences with the full R = tridiag(-1, 2, -1), or takes
        them as independent.
    time : float or (...)
        When, s, for stations that move.

    Returns
    -------
    (...)
        NaN where the stations do not determine a position.

    Raises
    ------
    ValueError
        Unknown rule or weights, a negative multiplier, a position of the wrong length, too few
        stations.
    """
    check_stations(stations)
    _validate.one_of("rule", rule, RULES)
    _validate.one_of("weights", weights, WEIGHTS)
    alpha = _validate.non_negative("multiplier", multiplier)
    p = _validate.array("position", position, (None, stations.dims))
    G = gradients(stations, p, time)
    pairs = pair_index("adjacent", stations)
    T = 0.5 * difference_covariance(np.ones(len(stations)), pairs)
    R = T if weights == "full" else np.eye(len(T))
    present = np.asarray(np.isfinite(G).all(axis=-1))
    inverse = pseudo_inverse(G, R, present)
    G = np.where(present[..., None], G, 0.0)
    return np.asarray(alpha * loop_gain(rule, G, inverse, T))


def gradients(stations: Stations, position: Array, time: float | Array) -> Array:
    """Return u_i - u_(i+1) (..., m, d) of adjacent stations; NaN where one is not heard."""
    _, u = ranges(position, stations.at(time)[0])
    return difference(u, pair_index("adjacent", stations), axis=-2)


def check_stations(stations: Stations) -> None:
    """Refuse what is not stations, or too few of them for a position."""
    if not isinstance(stations, Stations):
        raise ValueError(f"stations: expected Stations, got {stations!r}")
    needed = stations.dims + 1
    if len(stations) < needed:
        raise ValueError(
            f"stations: expected at least {needed} in {stations.dims} dimensions, "
            f"got {len(stations)}"
        )
