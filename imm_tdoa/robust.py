"""Gross errors: which sources of error a scan is better read without (ALGORITHMS §4, §13 T3).

Robust filters judge sources of error, not rows: where differences share an arrival, a gross error
of that arrival is one source that shows in several rows, and no result depends on which station
is called the reference. Every mode reads the scan alike, or their likelihoods would not compare.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np
from scipy.special import digamma, gammaln

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.observation import Observation, combined, mixture_innovation, without_offsets

TESTABLE = 1e-9  # share of a source's information that the others leave to test it by
ROUNDS = 30  # of the weights of Student's t
SETTLED = 1e-3  # relative change of a weight that ends them


@attrs.frozen(eq=False)
class Reading:
    """How a scan is read, alike in every mode; call it with an `Observation`.

    Attributes
    ----------
    combine : (..., m, m) or None
        Combinations of the rows in which sources left out do not occur.
    extra_noise : (..., m, m) or None
        What is added to the noise covariance.
    present : (..., m)
        Rows that count.
    price : (...)
        Log-density of what was left out or trusted less, so that likelihoods of filters that
        read scans differently compare.
    row_weight : (..., m)
        Share of its information that each row keeps; NaN is missing.
    rejected : (...)
        Whether the scan as a whole contradicts the prediction.
    """

    present: Mask
    price: Array
    row_weight: Array
    rejected: Mask
    combine: Array | None = None
    extra_noise: Array | None = None

    def __call__(self, seen: Observation) -> Observation:
        """Return the observation as it is read."""
        if self.extra_noise is not None:
            seen = attrs.evolve(seen, R=tuple(R + self.extra_noise for R in seen.R))
        if self.combine is not None:
            seen = combined(seen, self.combine, self.present)
        return attrs.evolve(seen, present=self.present)


def plainly(seen: Observation) -> Reading:
    """Every row as it is."""
    weight = np.where(seen.present, 1.0, np.nan)
    batch = seen.present.shape[:-1]
    return Reading(seen.present, np.zeros(batch), weight, np.zeros(batch, dtype=bool))


def gate(seen: Observation, weight: Array, P: Sequence[Array], threshold: float) -> Reading:
    """Leave out the sources that contradict the bank's prediction and each other (`snoop`).

    What was left out counts in the likelihood as if it lay on the gate: given the rows kept, k
    pieces of covariance C count as -(k (threshold + log 2 pi) + log det C)/2, so that dropping
    good rows does not pay. log det C is the difference of the log-determinants of all rows and
    of those kept, shared offsets eliminated from both.

    Parameters
    ----------
    seen : Observation
        The scan against the predictions.
    weight : (..., r)
        Predicted mode probabilities.
    P : list of (..., n_j, n_j)
        The predictions' covariances.
    threshold : float
        Largest acceptable statistic, a chi-square quantile of one degree of freedom.
    """
    nu, S = mixture_innovation(seen, weight, P)
    rows = np.eye(nu.shape[-1])
    directions = rows
    if seen.directions is not None and not np.array_equal(seen.directions, rows):
        shape = (*nu.shape, nu.shape[-1])
        full = np.broadcast_to(seen.directions, (*nu.shape, seen.directions.shape[-1]))
        directions = np.concatenate([full, np.broadcast_to(rows, shape)], axis=-1)
    T, present, clean = snoop(nu, S, seen.present, seen.group, threshold, directions)
    if np.array_equal(present, np.broadcast_to(seen.present, present.shape)):
        return plainly(seen)
    whole = attrs.evolve(seen, present=np.broadcast_to(seen.present, present.shape))
    (log_det, count), (log_det_kept, kept) = (
        _size(part, weight, P) for part in (whole, combined(whole, T, present))
    )
    price = -0.5 * ((count - kept) * (threshold + gaussian.LOG_2PI) + log_det - log_det_kept)
    return Reading(
        present=present,
        price=price,
        row_weight=np.where(whole.present, np.where(clean, 1.0, 0.0), np.nan),
        rejected=_few(np.where(present, 1.0, 0.0), whole.present),
        combine=T,
    )


def _size(part: Observation, weight: Array, P: Sequence[Array]) -> tuple[Array, Array]:
    """Log-determinant of the bank's innovation covariance, and the rows in it."""
    part = without_offsets(part)
    _, S = mixture_innovation(part, weight, P)
    diagonal = np.einsum("...ii->...i", gaussian.factor(S))
    return 2.0 * np.sum(np.log(diagonal), axis=-1), np.count_nonzero(part.present, axis=-1)


def _few(weight: Array, present: Mask) -> Mask:
    """Whether no more than half of the `present` rows (..., m) is left."""
    left = np.sum(np.where(present, weight, 0.0), axis=-1)
    result: Mask = left <= 0.5 * np.count_nonzero(present, axis=-1)
    return result & present.any(axis=-1)


def snoop(
    nu: Array, S: Array, present: Mask, group: Index, threshold: float, directions: Array
) -> tuple[Array, Mask, Mask]:
    """Leave out the sources of error that the rest contradicts, strongest first.

    Data snooping (Baarda 1968): with W = S^-1, less its projection on offsets that rows share,
    leaving out an error along d lowers the normalised innovation squared by
    (d' W nu)² / (d' W d), which is chi-square with one degree of freedom while the error is an
    ordinary one. The worst source above `threshold` is eliminated and the rest judged anew, so
    one gross error does not take its neighbours along, correlated or not.

    Parameters
    ----------
    nu : (..., m)
        Innovations.
    S : (..., m, m)
        Their covariance, prediction and noise.
    present : (..., m)
        Rows that were measured.
    group : (m,)
        Offset group of each row; -1: none.
    threshold : float
        Largest acceptable statistic.
    directions : (..., m, k)
        How each source enters the rows.

    Returns
    -------
    combine : (..., m, m)
        Combinations of the rows in which the sources left out do not occur.
    present : (..., m)
        The combinations that count.
    clean : (..., m)
        Rows in which no source that was left out occurs.
    """
    m = nu.shape[-1]
    present = np.array(np.broadcast_to(present, nu.shape))
    clean = np.ones(nu.shape, dtype=bool)
    d = np.where(present[..., None], directions, 0.0)
    offsets = np.equal.outer(group, np.unique(group[group >= 0])).astype(float)
    offsets = np.where(present[..., None], offsets, 0.0)
    T = np.broadcast_to(np.eye(m), (*nu.shape, m))
    for _ in range(m):
        statistic = _statistic(nu, S, present, offsets, d)
        worst = np.argmax(statistic, axis=-1)[..., None]
        out = np.take_along_axis(statistic, worst, axis=-1) > threshold
        if not np.any(out):
            break
        one = np.take_along_axis(d, worst[..., None, :], axis=-1)[..., 0]
        touched = present & out & (np.abs(one) > TESTABLE * np.abs(one).max(axis=-1, keepdims=True))
        variance = np.where(touched, np.einsum("...ii->...i", S), np.inf)
        pivot = touched & (np.arange(m) == np.argmin(variance, axis=-1)[..., None])
        there = np.sum(np.where(pivot, one, 0.0), axis=-1, keepdims=True)
        ratio = np.where(touched & ~pivot, one / np.where(there != 0.0, there, 1.0), 0.0)
        step = np.eye(m) - ratio[..., :, None] * np.where(pivot, 1.0, 0.0)[..., None, :]
        clean &= ~touched
        present &= ~pivot
        both = present[..., :, None] & present[..., None, :]
        S = np.where(both, step @ S @ np.swapaxes(step, -1, -2), np.eye(m))
        nu = np.where(present, np.einsum("...ij,...j->...i", step, nu), 0.0)
        d = np.where(present[..., None], step @ d, 0.0)
        offsets = np.where(present[..., None], step @ offsets, 0.0)
        T = step @ T
    return T, present, clean


def _statistic(nu: Array, S: Array, present: Mask, offsets: Array, d: Array) -> Array:
    """Snooping statistic (..., k) of errors along the columns of `d`."""
    both = present[..., :, None] & present[..., None, :]
    W = np.where(both, np.linalg.inv(np.where(both, S, np.eye(S.shape[-1]))), 0.0)
    full = np.einsum("...ik,...ij,...jk->...k", d, W, d)
    for g in range(offsets.shape[-1]):
        one = offsets[..., g]
        W1 = np.einsum("...ij,...j->...i", W, one)
        total = np.sum(W1 * one, axis=-1)[..., None, None]
        W = W - W1[..., :, None] * W1[..., None, :] / np.where(total > 0.0, total, np.inf)
    Wd = W @ d
    own = np.einsum("...ik,...ik->...k", d, Wd)
    score = np.einsum("...ik,...i->...k", Wd, np.where(present, nu, 0.0))
    testable = own > TESTABLE * full
    result: Array = np.where(testable, score**2 / np.where(testable, own, 1.0), 0.0)
    return result


def student_t(seen: Observation, weight: Array, P: Sequence[Array], dof: float) -> Reading:
    """Read the scan as if its errors were Student's t: gross ones are trusted less, none is lost.

    Each source's error is normal with precision lambda / variance, lambda gamma-distributed with
    mean 1 (variational Bayes; Agamennoni, Nieto & Nebot 2012): lambda = (dof + 1)/(dof +
    E[e²]/variance), e the source's error given the whole bank's innovation. No source is trusted
    more than its variance says (lambda at most 1). The price is that of the variational bound.

    Parameters
    ----------
    seen, weight, P
        As for `gate`; `seen` has its sources.
    dof : float
        Degrees of freedom: the smaller, the heavier the tails.
    """
    assert seen.directions is not None
    assert seen.source_variance is not None
    free = without_offsets(seen)
    nu, S = mixture_innovation(free, weight, P)
    D = np.where(free.present[..., None], free.directions, 0.0)  # type: ignore[arg-type]
    known = np.isfinite(seen.source_variance) & (seen.source_variance > 0.0)
    v = np.where(known, seen.source_variance, 1.0)
    heard = known & np.any(D != 0.0, axis=-2)
    D = np.where(heard[..., None, :], D, 0.0)
    lam = np.ones(heard.shape)
    for _ in range(ROUNDS):
        noise = v / lam
        Q = S + np.einsum("...ik,...k,...jk->...ij", D, noise - v, D)
        solved = np.linalg.solve(Q, np.concatenate([nu[..., None], D], axis=-1))
        e = noise * np.einsum("...ik,...i->...k", D, solved[..., 0])
        left = noise - noise**2 * np.einsum("...ik,...ik->...k", D, solved[..., 1:])
        square = (e**2 + np.maximum(left, 0.0)) / v
        before, lam = lam, np.minimum((dof + 1.0) / (dof + square), 1.0)
        if np.all(np.abs(lam - before) <= SETTLED * lam):
            break
    lam = np.where(heard, lam, 1.0)
    raw = np.where(seen.present[..., None], seen.directions, 0.0)
    more = np.where(known, v * (1.0 / lam - 1.0), 0.0)
    extra = np.einsum("...ik,...k,...jk->...ij", raw, more, raw)
    own = np.einsum("...ii->...i", seen.R[0])
    share = own / (own + np.einsum("...ii->...i", extra))
    present = np.broadcast_to(seen.present, share.shape)
    return Reading(
        present=seen.present,
        price=np.sum(np.where(heard, _tail_price(lam, dof), 0.0), axis=-1),
        row_weight=np.where(present, share, np.nan),
        rejected=_few(share, present),
        extra_noise=extra,
    )


def _tail_price(lam: Array, dof: float) -> Array:
    """What the variational bound pays for trusting a source by `lam` instead of 1."""
    a, a0 = 0.5 * (dof + 1.0), 0.5 * dof
    b = a / lam
    log_lam = digamma(a) - np.log(b)
    divergence = (
        (a - a0) * digamma(a)
        - gammaln(a)
        + gammaln(a0)
        + a0 * (np.log(b) - np.log(a0))
        + a * (a0 - b) / b
    )
    result: Array = 0.5 * (log_lam - np.log(lam)) - divergence
    return result
