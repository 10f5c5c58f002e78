"""Gross errors: which sources of error a scan is better read without (ALGORITHMS §4, §13 T3).

Robust filters judge sources of error, not rows: where differences share an arrival, a gross error
of that arrival is one source that shows in several rows, and no result depends on which station
is called the reference. Every mode reads the scan alike, or their likelihoods would not compare;
and it is the evidence of the whole bank that decides, so that a manoeuvre which one of the modes
explains well is not taken for gross errors, nor gross errors for a manoeuvre which none does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np
import scipy

from imm_tdoa import gaussian, mixture
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.observation import Observation, combined, mixture_innovation, without_offsets

AMBIGUOUS = 3.0  # log-odds of two sources, 20 to 1, below which either may be the bad one
TESTABLE = 1e-9  # share of a source's information that the others leave to test it by
ROUNDS = 15  # of the weights of Student's t
SETTLED = 1e-2  # relative change of a weight that ends them
SAME = 1e-6  # difference of two bounds that says nothing: rounding must not choose between them


@attrs.frozen(eq=False)
class Reading:
    """How a scan is read, alike in every mode; call it with an `Observation`.

    Attributes
    ----------
    combine : (..., m, m) or None
        Combinations of the rows in which shared offsets and sources left out do not occur.
    extra_noise : (..., m, m) or None
        What is added to the noise covariance.
    present : (..., m)
        Rows (or combinations) that count.
    price : (...)
        Log-density of what was left out or trusted less, so that likelihoods of filters that
        read scans differently compare.
    row_weight : (..., m)
        Share of its information that each row keeps; NaN is missing.
    rejected : (...)
        Whether the scan as a whole contradicts the prediction.
    pieces : (...)
        Independent pieces of information in the scan: rows, less one per shared offset.
    """

    present: Mask
    price: Array
    row_weight: Array
    rejected: Mask
    pieces: Index
    combine: Array | None = None
    extra_noise: Array | None = None

    def __call__(self, seen: Observation) -> Observation:
        """Return the observation as it is read."""
        if self.extra_noise is not None:
            seen = attrs.evolve(seen, R=tuple(R + self.extra_noise for R in seen.R))
        if self.combine is not None:
            seen = combined(seen, self.combine, self.present)
            return attrs.evolve(seen, group=np.full_like(seen.group, -1))
        return attrs.evolve(seen, present=self.present)


def plainly(seen: Observation) -> Reading:
    """Every row as it is."""
    weight = np.where(seen.present, 1.0, np.nan)
    batch = seen.present.shape[:-1]
    pieces = np.count_nonzero(_free_of_offsets(seen)[1].present, axis=-1)
    no = np.zeros(batch, dtype=bool)
    return Reading(seen.present, np.zeros(batch), weight, no, np.asarray(pieces))


def gate(seen: Observation, log_weight: Array, P: Sequence[Array], threshold: float) -> Reading:
    """Leave out the sources of error without which the whole bank explains the scan better.

    Data snooping (Baarda 1968) for several modes. For one Gaussian with W = S^-1, leaving out an
    error along d lowers the normalised innovation squared by (d' W nu)² / (d' W d), chi-square
    with one degree of freedom while the error is an ordinary one: above `threshold` it goes.
    With several modes the mixture's likelihood decides in the same way: with the source, or
    without it, and it as if it lay on the gate of the bank's innovation covariance. The worst
    source goes first and the rest is judged anew, so one gross error does not take its
    neighbours along, correlated or not; but where it cannot be told which of several sources is
    the bad one, all of them go.

    What was left out counts in the likelihood as if it lay on the gate: given the rows kept, k
    pieces of covariance C count as -(k (threshold + log 2 pi) + log det C)/2, so that dropping
    good rows does not pay. log det C is the difference of the log-determinants of all rows and
    of those kept, shared offsets eliminated from both. Errors that hide each other, so that no
    single one can be told, are not let in either: where the scan is explained better by leaving
    it out as a whole, that is done.

    Parameters
    ----------
    seen : Observation
        The scan against the predictions, with its sources.
    log_weight : (..., r)
        Log of the predicted mode probabilities.
    P : sequence of (..., n_j, n_j)
        The predictions' covariances.
    threshold : float
        Largest acceptable statistic, a chi-square quantile of one degree of freedom.
    """
    assert seen.directions is not None
    offsets, free = _free_of_offsets(seen)
    m = seen.present.shape[-1]
    rows = np.where(seen.present[..., None], np.eye(m), 0.0)
    raw = np.concatenate(
        [np.broadcast_to(a, (*rows.shape[:-1], a.shape[-1])) for a in (seen.directions, rows)],
        axis=-1,
    )
    raw = np.where(seen.present[..., None], raw, 0.0)
    combine, present, left_out = _snoop(free, log_weight, P, threshold, offsets @ raw)
    if not np.any(left_out):
        return plainly(seen)
    whole = attrs.evolve(free, present=np.broadcast_to(free.present, present.shape))
    (log_det, count), (log_det_kept, kept) = (
        _size(part, np.exp(log_weight), P) for part in (whole, combined(whole, combine, present))
    )
    price = -0.5 * ((count - kept) * (threshold + gaussian.LOG_2PI) + log_det - log_det_kept)
    touched = np.any((raw != 0.0) & left_out[..., None, :], axis=-1)
    seen_rows = np.broadcast_to(seen.present, touched.shape)
    few = 2 * kept <= count
    return Reading(
        pieces=np.asarray(count, dtype=np.int64),
        present=present,
        price=price,
        row_weight=np.where(seen_rows, np.where(touched, 0.0, 1.0), np.nan),
        rejected=few & (count > 0),
        combine=combine @ offsets,
    )


def _free_of_offsets(seen: Observation) -> tuple[Array, Observation]:
    """The combinations (..., m, m) that eliminate shared offsets, and what they leave."""
    m = seen.present.shape[-1]
    if np.all(seen.group < 0):
        return np.eye(m), seen
    variance = np.einsum("...ii->...i", seen.R[0])
    T, _ = gaussian.offset_contrast(variance, seen.present, seen.group)
    return T, without_offsets(seen)


def _size(part: Observation, weight: Array, P: Sequence[Array]) -> tuple[Array, Array]:
    """Log-determinant of the bank's innovation covariance, and the rows in it."""
    _, S = mixture_innovation(part, weight, P)
    diagonal = np.einsum("...ii->...i", gaussian.innovation_factor(S))
    return 2.0 * np.sum(np.log(diagonal), axis=-1), np.count_nonzero(part.present, axis=-1)


class _Judged(NamedTuple):
    """Sources against one Gaussian: log-density of the rows, and per source (..., k)."""

    log_density: Array
    log_det: Array
    statistic: Array
    information: Array


def _judge(nu: Array, S: Array, present: Mask, d: Array) -> _Judged:
    """Judge errors along the columns of `d` (..., m, k) by an innovation N(0, S)."""
    both = present[..., :, None] & present[..., None, :]
    S = np.where(both, S, np.eye(S.shape[-1]))
    nu = np.where(present, nu, 0.0)
    L = gaussian.innovation_factor(S)
    white = np.linalg.solve(L, np.concatenate([nu[..., None], d], axis=-1))
    w, e = white[..., 0], white[..., 1:]
    information = np.sum(e**2, axis=-2)
    score = np.einsum("...ik,...i->...k", e, w)
    alone = np.einsum("...ik,...ii->...k", d**2, np.where(both, S, 0.0))
    tested = information * alone > TESTABLE
    statistic = np.where(tested, score**2 / np.where(tested, information, 1.0), 0.0)
    log_det = 2.0 * np.sum(np.log(np.einsum("...ii->...i", L)), axis=-1)
    return _Judged(-0.5 * (np.sum(w**2, axis=-1) + log_det), log_det, statistic, information)


def _snoop(
    free: Observation, log_weight: Array, P: Sequence[Array], threshold: float, d: Array
) -> tuple[Array, Mask, Mask]:
    """Combinations (..., m, m) without the sources left out, which count (..., m), and who goes.

    `d` (..., m, k) are the directions of all candidates, rows and sources, offsets eliminated.
    """
    m = free.present.shape[-1]
    weight = np.exp(log_weight)
    parts = [_innovation(free, j, C) for j, C in enumerate(P)]
    parts.append(mixture_innovation(free, weight, P))
    batch = np.broadcast_shapes(log_weight.shape[:-1], *(nu.shape[:-1] for nu, _ in parts))
    d = np.broadcast_to(np.where(free.present[..., None], d, 0.0), (*batch, *d.shape[-2:]))
    present = np.array(np.broadcast_to(free.present, (*batch, m)))
    T = np.broadcast_to(np.eye(m), (*batch, m, m))
    raw_rows = np.any(d != 0.0, axis=-2)
    left_out = np.zeros((*batch, d.shape[-1]), dtype=bool)
    suspect = np.zeros_like(left_out)
    for _ in range(m):
        judged = [_judge(nu, S, present, d) for nu, S in parts]
        gain = _gain(judged, log_weight, threshold)
        gain = np.where(np.any(d != 0.0, axis=-2), gain, -np.inf)
        suspect &= np.isfinite(gain)
        suspect |= (gain > 0.0) & (gain >= np.max(gain, axis=-1, keepdims=True) - AMBIGUOUS)
        worst = np.argmax(np.where(suspect, np.inf, gain), axis=-1)[..., None]
        out = np.take_along_axis(suspect, worst, axis=-1)
        if not np.any(out):
            break
        one = np.take_along_axis(d, worst[..., None, :], axis=-1)[..., 0]
        touched = present & out & (np.abs(one) > TESTABLE * np.abs(one).max(axis=-1, keepdims=True))
        variance = np.where(touched, np.einsum("...ii->...i", parts[-1][1]), np.inf)
        pivot = touched & (np.arange(m) == np.argmin(variance, axis=-1)[..., None])
        there = np.sum(np.where(pivot, one, 0.0), axis=-1, keepdims=True)
        ratio = np.where(touched & ~pivot, one / np.where(there != 0.0, there, 1.0), 0.0)
        step = np.eye(m) - ratio[..., :, None] * np.where(pivot, 1.0, 0.0)[..., None, :]
        left_out |= out & (np.arange(d.shape[-1]) == worst)
        present &= ~pivot
        parts = [
            (np.einsum("...ij,...j->...i", step, nu), step @ S @ np.swapaxes(step, -1, -2))
            for nu, S in parts
        ]
        d = np.where(present[..., None], step @ d, 0.0)
        d = np.where(np.abs(d) > 1e-12, d, 0.0)
        T = step @ T
    hopeless = _hopeless(judged, log_weight, present, threshold)
    if np.any(hopeless):
        rows = np.arange(d.shape[-1]) >= d.shape[-1] - m
        left_out |= hopeless[..., None] & rows & np.broadcast_to(raw_rows, left_out.shape)
        present &= ~hopeless[..., None]
    return T, present, left_out


def _hopeless(
    judged: Sequence[_Judged], log_weight: Array, present: Mask, threshold: float
) -> Mask:
    """Where (...) the rows that are left would all the same better be left out, every one."""
    modes, bank = judged[:-1], judged[-1]
    with_them = np.stack([one.log_density for one in modes], axis=-1) + log_weight
    on_the_gate = -0.5 * (np.count_nonzero(present, axis=-1) * threshold + bank.log_det)
    worse = mixture.normalise(with_them)[1] < on_the_gate
    result: Mask = worse & np.any(present, axis=-1)
    return result


def _innovation(free: Observation, j: int, P: Array) -> tuple[Array, Array]:
    nu, H, R = gaussian.mask_rows(free.nu[j], free.H[j], free.R[j], free.present)
    return nu, H @ P @ np.swapaxes(H, -1, -2) + R


def _gain(judged: Sequence[_Judged], log_weight: Array, threshold: float) -> Array:
    """Log-evidence (..., k) that the bank gains by leaving each source out.

    `judged` by each mode, and last by the bank's moments, on whose gate the source then lies.
    """
    modes, bank = judged[:-1], judged[-1]
    with_it = np.stack([one.log_density for one in modes], axis=-1) + log_weight
    known = np.where(bank.information > 0.0, bank.information, 1.0)
    without = np.stack(
        [
            one.log_density[..., None]
            + log_weight[..., j, None]
            + 0.5 * (one.statistic - np.log(np.where(one.information > 0.0, one.information, 1.0)))
            for j, one in enumerate(modes)
        ],
        axis=-1,
    )
    price = -0.5 * (threshold - np.log(known))
    before = mixture.normalise(with_it)[1]
    result: Array = mixture.normalise(without)[1] + price - before[..., None]
    return result


def student_t(seen: Observation, log_weight: Array, P: Sequence[Array], dof: float) -> Reading:
    """Read the scan as if its errors were Student's t: gross ones are trusted less, none is lost.

    Each source's error is normal with precision lambda / variance, lambda gamma-distributed with
    mean 1 (variational Bayes; Agamennoni, Nieto & Nebot 2012): lambda = (dof + 1)/(dof +
    E[e²]/variance), e the source's error given the scan, averaged over the modes as they explain
    it. No source is trusted more than its variance says (lambda at most 1). The iteration begins
    once at lambda = 1, where a mode that explains the scan by a manoeuvre leads, and once with
    the modes as they were predicted; the better variational bound is taken, and is the price.

    Parameters
    ----------
    seen, log_weight, P
        As for `gate`.
    dof : float
        Degrees of freedom: the smaller, the heavier the tails.
    """
    assert seen.directions is not None
    assert seen.source_variance is not None
    offsets, free = _free_of_offsets(seen)
    known = np.isfinite(seen.source_variance) & (seen.source_variance > 0.0)
    v = np.where(known, seen.source_variance, 1.0)
    raw = np.where(seen.present[..., None], seen.directions, 0.0)
    D = np.where(free.present[..., None], offsets @ raw, 0.0)
    heard = known & np.any(D != 0.0, axis=-2)
    D = np.where(heard[..., None, :], D, 0.0)
    parts = [_innovation(free, j, C) for j, C in enumerate(P)]
    lam, price = np.ones(heard.shape), np.zeros(heard.shape[:-1])
    best = np.full(price.shape, -np.inf)
    for begin in (None, log_weight):
        trial, bound, cost = _weights(parts, log_weight, D, v, heard, dof, begin)
        better = bound > best + SAME
        lam = np.where(better[..., None], trial, lam)
        price, best = np.where(better, cost, price), np.where(better, bound, best)
    more = np.where(heard, v * (1.0 / lam - 1.0), 0.0)
    extra = np.einsum("...ik,...k,...jk->...ij", raw, more, raw)
    own = np.einsum("...ii->...i", seen.R[0])
    share = own / (own + np.einsum("...ii->...i", extra))
    present = np.broadcast_to(seen.present, share.shape)
    left = np.sum(np.where(present, share, 0.0), axis=-1)
    return Reading(
        present=seen.present,
        price=price,
        row_weight=np.where(present, share, np.nan),
        rejected=(left <= 0.5 * np.count_nonzero(present, axis=-1)) & present.any(axis=-1),
        pieces=np.asarray(np.count_nonzero(free.present, axis=-1)),
        extra_noise=extra,
    )


def _weights(
    parts: Sequence[tuple[Array, Array]],
    log_weight: Array,
    D: Array,
    v: Array,
    heard: Mask,
    dof: float,
    begin: Array | None,
) -> tuple[Array, Array, Array]:
    """Fixed point of the sources' weights lambda (..., k), its bound and its price (...).

    `begin` are the logs of the modes' shares (..., r) in the first round; None: as they explain
    the scan.
    """
    batch = np.broadcast_shapes(heard.shape[:-1], log_weight.shape[:-1])
    heard = np.broadcast_to(heard, (*batch, heard.shape[-1]))
    lam, settled = np.ones(heard.shape), np.zeros(batch, dtype=bool)
    share = begin
    for _ in range(ROUNDS):
        noise = v / lam
        Q = np.einsum("...ik,...k,...jk->...ij", D, noise - v, D)
        explained = [_explain(nu, S + Q, D, noise) for nu, S in parts]
        if share is None:
            share = _shares(explained, log_weight)
        square = sum(np.exp(share[..., j, None]) * e2 for j, (e2, _) in enumerate(explained)) / v
        share = None
        new = np.where(heard, np.minimum((dof + 1.0) / (dof + square), 1.0), 1.0)
        still = np.all(np.abs(new - lam) <= SETTLED * new, axis=-1)
        lam = np.where(settled[..., None], lam, new)
        settled |= still
        if np.all(settled):
            break
    Q = np.einsum("...ik,...k,...jk->...ij", D, v / lam - v, D)
    log_joint = log_weight + np.stack(
        [_explain(nu, S + Q, D, v / lam)[1] for nu, S in parts], axis=-1
    )
    price = np.sum(np.where(heard, _tail_price(lam, dof), 0.0), axis=-1)
    return lam, mixture.normalise(log_joint)[1] + price, price


def _explain(nu: Array, S: Array, D: Array, noise: Array) -> tuple[Array, Array]:
    """E[e²] (..., k) of the sources' errors given the innovation, and its log-density (...)."""
    L = gaussian.innovation_factor(S)
    white = np.linalg.solve(L, np.concatenate([nu[..., None], D], axis=-1))
    w, G = white[..., 0], white[..., 1:]
    e = noise * np.einsum("...ik,...i->...k", G, w)
    left = noise - noise**2 * np.sum(G**2, axis=-2)
    log_det = 2.0 * np.sum(np.log(np.einsum("...ii->...i", L)), axis=-1)
    return e**2 + np.maximum(left, 0.0), -0.5 * (np.sum(w**2, axis=-1) + log_det)


def _shares(explained: Sequence[tuple[Array, Array]], log_weight: Array) -> Array:
    """Logs of the modes' shares (..., r) in the explanation of the scan."""
    return mixture.normalise(log_weight + np.stack([log_l for _, log_l in explained], axis=-1))[0]


def _tail_price(lam: Array, dof: float) -> Array:
    """What the variational bound pays for trusting a source by `lam` instead of 1."""
    a, a0 = 0.5 * (dof + 1.0), 0.5 * dof
    b = a / lam
    log_lam = scipy.special.digamma(a) - np.log(b)
    divergence = (
        (a - a0) * scipy.special.digamma(a)
        - scipy.special.gammaln(a)
        + scipy.special.gammaln(a0)
        + a0 * (np.log(b) - np.log(a0))
        + a * (a0 - b) / b
    )
    result: Array = 0.5 * (log_lam - np.log(lam)) - divergence
    return result
