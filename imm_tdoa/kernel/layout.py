"""What the compiled recursion is given: plain numbers and arrays, by name."""

from __future__ import annotations

from typing import NamedTuple

from imm_tdoa.contract import Array, Index


class Spec(NamedTuple):
    """A bank on a measurement; r modes, d dimensions, m rows, S stations.

    Attributes
    ----------
    dims, rule : int
        Space dimensions; mixing rule (`mixing.BIRTH`, ...).
    rates : bool
        Whether any row is a range rate.
    order, n : (r,)
        Derivatives and components of each mode, n = order * dims.
    birth : (largest n,)
        Variance of each component under the birth law.
    pattern : (r, k, k)
        Where the modes' transition matrices are not zero, per axis.
    kind, group : (m,)
        What each row is (`looking.RANGE`, ...) and its offset group, -1: none.
    scale : (m,)
        From given values to internal units.
    frame : (12,)
        Of heights, see `earth.height`.
    """

    dims: int
    rule: int
    rates: bool
    order: Index
    n: Index
    birth: Array
    pattern: Array
    kind: Index
    group: Index
    scale: Array
    frame: Array


class Feed(NamedTuple):
    """B targets through T scans. An axis of length 1 holds for all targets, or for all scans.

    Attributes
    ----------
    tables : (U, W)
        What the bank's models and chain make of each different time step; see `plan.tables`.
    step : (1 | B, T)
        Which of them each scan takes.
    values : (1 | B, T, m)
        What was measured; NaN is missing.
    since : (1 | B,)
        The first scan that each target takes in.
    usable : (0 | 1 | B, 0 | T, m)
        Rows that do not merely repeat others; empty where that is all.
    noise : (1 | B, 1 | T, m, m)
        Covariances, internal units.
    place, speed : (1 | B, 1 | T, S, d)
        Of the stations, m and m/s; NaN where one is not heard.
    station, reference : (1 | B, 1 | T, m, 1)
        Ends of each row's difference; reference -1: none. The station of an `AXIS` row is the
        axis.
    """

    tables: Array
    step: Index
    values: Array
    since: Index
    usable: Index
    noise: Array
    place: Array
    speed: Array
    station: Index
    reference: Index


class Robust(NamedTuple):
    """How gross errors are treated, and how far each target is trusted.

    Attributes
    ----------
    gates : bool
        Whether sources are left out (`imm_tdoa.robust.gate`), not trusted less (`student_t`).
    threshold, degrees_of_freedom, constant, digamma : float
        The gate, or the tail and what of its price does not depend on a weight.
    patience : int
        Scans rejected on end after which a track is lost.
    time : (1 | B, T)
        Of the scans, s.
    directions, variance : (1 | B, 1 | T, m, k), (1 | B, 1 | T, k)
        Of the sources of error.
    trust : (B, 4 + ...)
        Of each target: scans rejected and used on end, whether it is lost, when it was last
        trusted, and its modes then (means, covariances, log-probabilities). Written to.
    """

    gates: bool
    threshold: float
    degrees_of_freedom: float
    constant: float
    digamma: float
    patience: int
    time: Array
    directions: Array
    variance: Array
    trust: Array


class Record(NamedTuple):
    """Where a target's numbers are in its record, the state of its filter after a scan.

    Means and covariances of the modes come first; the rest are offsets: log-probabilities (r),
    log-likelihood, nis, its degrees of freedom, log-likelihood and nis of each mode (r), weight
    of each row (m), whether the track is lost, whether it was reopened.
    """

    log_p: int
    log_likelihood: int
    nis: int
    dof: int
    mode_log_likelihood: int
    mode_nis: int
    row_weight: int
    lost: int
    reopened: int
    size: int


def record(components: int, squares: int, r: int, m: int) -> Record:
    """Return the layout for modes of `components` in all, whose squares sum to `squares`."""
    log_p = components + squares
    mode_log_likelihood = log_p + r + 3
    row_weight = mode_log_likelihood + 2 * r
    lost = row_weight + m
    return Record(
        log_p,
        log_p + r,
        log_p + r + 1,
        log_p + r + 2,
        mode_log_likelihood,
        mode_log_likelihood + r,
        row_weight,
        lost,
        lost + 1,
        lost + 2,
    )
