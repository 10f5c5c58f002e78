"""Marginal association probabilities of targets that compete for the same candidates.

A joint event gives each target one candidate or none, and each candidate to at most one target.
Its weight is the product of its targets' factors. The sums over all events are permanents; they
are exact here by dynamic programming over subsets of the smaller side, whose cost is 2^k for k
targets or candidates, not k! as for a list of events.
"""

from __future__ import annotations

from math import comb
from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from imm_tdoa import mixture
from imm_tdoa.contract import Array

Permutations = Literal["all", "best"]
EXACT_UP_TO = 10
MOST_SUBSETS = 5000
ROUNDS = 500
SETTLED = 1e-8


class Marginals(NamedTuple):
    """What the joint events say of each target.

    Attributes
    ----------
    beta : (N, L + 1)
        Probability that target n has candidate l; the last column: that it has none.
    log_extrinsic : (N, L + 1)
        Log of what all other targets say of target n having l, relative to its having none:
        ``beta[n, l]`` is proportional to ``detect[n, l] exp(log_extrinsic[n, l])``. -inf where
        n cannot have l.
    log_ratio : (N,)
        Log of the weight of all events over that of those in a world without target n.
    """

    beta: Array
    log_extrinsic: Array
    log_ratio: Array


def marginals(
    log_detect: Array,
    log_miss: Array,
    exact_up_to: int = EXACT_UP_TO,
    permutations: Permutations = "all",
) -> Marginals:
    """Return the marginal association probabilities.

    Parameters
    ----------
    log_detect : (N, L)
        Log of target n's factor in an event where it has candidate l; -inf: impossible. In
        JPDA detection probability times density over clutter density.
    log_miss : (N,)
        Log of its factor where it has none, finite. In JPDA the probability that it is not
        detected within its gate.
    exact_up_to : int
        Targets that share candidates, and candidates that share targets, form a cluster. One
        with at most so many targets, or at most so many candidates, is summed exactly; in a
        bigger one the marginals are the fixed point of loopy belief propagation (Williams & Lau
        2014, IEEE TAES 50(4):2942-2959), which always exists and is exact where the cluster has
        no loops.
    permutations : "all" or "best"
        ``"best"``: of the events in which the same targets have the same candidates only the
        likeliest counts (JPDA*; Blom & Bloem 2000, IEEE TAC 45(2):247-259), so that targets close
        together are not drawn to one another. In a cluster of n targets and l candidates with
        more than 5000 subsets, (n + l)!/(n! l!), all count.

    Raises
    ------
    ValueError
        Shapes that do not fit, NaN, an infinite factor, a factor of none that is not finite.
    """
    log_detect, log_miss = np.asarray(log_detect, float), np.asarray(log_miss, float)
    if log_detect.ndim != 2:
        raise ValueError(f"log_detect: expected shape (N, L), got {log_detect.shape}")
    N, L = log_detect.shape
    if log_miss.shape != (N,) or not np.all(np.isfinite(log_miss)):
        raise ValueError(f"log_miss: expected {N} finite numbers, got {log_miss!r}")
    if np.any(np.isnan(log_detect) | np.isposinf(log_detect)):
        raise ValueError("log_detect: expected numbers or -infinity, got NaN or infinity")
    log_extrinsic = np.full((N, L + 1), -np.inf)
    log_extrinsic[:, L] = 0.0
    odds = log_detect - log_miss[:, None]
    possible = np.isfinite(log_detect)
    n, k = np.nonzero(possible)
    if len(n):
        graph = coo_array((np.ones(len(n)), (n, N + k)), shape=(N + L, N + L))
        _, cluster = connected_components(graph, directed=False)
        for c in np.unique(cluster[n]):
            targets = np.flatnonzero(cluster[:N] == c)
            candidates = np.flatnonzero(cluster[N:] == c)
            part = odds[np.ix_(targets, candidates)]
            if permutations == "best" and comb(sum(part.shape), len(part)) <= MOST_SUBSETS:
                found = log_best(part)
            elif min(part.shape) <= exact_up_to:
                found = log_exact(part)
            else:
                found = log_propagated(part)
            found = np.where(np.isfinite(part), found, -np.inf)
            log_extrinsic[np.ix_(targets, candidates)] = found
    joint = np.concatenate([np.where(possible, odds, 0.0), np.zeros((N, 1))], axis=1)
    log_beta, total = mixture.normalise(joint + log_extrinsic)
    return Marginals(np.exp(log_beta), log_extrinsic, log_miss + total)


def log_exact(odds: Array) -> Array:
    """Exact extrinsic logs (N, L) from the log odds (N, L) of having a candidate or none."""
    if odds.shape[1] <= odds.shape[0]:
        return _over_targets(odds)
    return _over_candidates(odds)


def log_best(odds: Array) -> Array:
    """As `log_exact`, but only the likeliest way to give the same candidates to the same targets.

    Over subsets of targets and of candidates, one target after the other; a subset keeps its
    likeliest event.
    """
    N, L = odds.shape
    best: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = {(0, 0): (0.0, ())}
    for n in range(N):
        following: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = {}
        able = _some(odds[n])
        for (having, used), (log_weight, event) in best.items():
            following[having, used] = max(
                following.get((having, used), (-np.inf, ())), (log_weight, (*event, L))
            )
            for k in able:
                if used >> k & 1:
                    continue
                key = (having | 1 << n, used | 1 << k)
                trial = (log_weight + float(odds[n, k]), (*event, k))
                following[key] = max(following.get(key, (-np.inf, ())), trial)
        best = following
    events = np.array([event for _, event in best.values()])
    logs = np.array([log_weight for log_weight, _ in best.values()])
    result = np.full((N, L + 1), -np.inf)
    whole = np.concatenate([odds, np.zeros((N, 1))], axis=1)
    for n in range(N):
        for k in np.unique(events[:, n]):
            result[n, k] = _sum(logs[events[:, n] == k]) - whole[n, k]
    return result[:, :L] - result[:, L:]


def _bit(sums: Array, b: int) -> Array:
    """View sums over subsets (2^size,) as (., 2, .): the middle axis tells whether b is in."""
    return sums.reshape(-1, 2, 1 << b)


def _some(row: Array) -> list[int]:
    return [int(k) for k in np.flatnonzero(np.isfinite(row))]


def _sum(logs: Array) -> float:
    return float(mixture.normalise(logs.reshape(-1))[1])


def _add(old: Array, row: Array, to: int) -> Array:
    """Return log sums after one more element, which takes nothing or one of those in `row`.

    From the subsets without that one to those with it (`to` 1), or back (`to` 0).
    """
    sums = old.copy()
    for b in _some(row):
        part = _bit(sums, b)
        part[:, to] = np.logaddexp(part[:, to], row[b] + _bit(old, b)[:, 1 - to])
    return sums


def _over_targets(odds: Array) -> Array:
    """Take targets one by one; the sums are over subsets of candidates that are in use."""
    N, L = odds.shape
    nothing = np.full(1 << L, -np.inf)
    nothing[0] = 0.0
    forward, behind = [nothing], [np.zeros(1 << L)]
    for n in range(N):
        forward.append(_add(forward[-1], odds[n], 1))
        behind.append(_add(behind[-1], odds[N - 1 - n], 0))
    result = np.full((N, L), -np.inf)
    for n in range(N):
        before, after = forward[n], behind[N - 1 - n]
        none = _sum(before + after)
        for k in _some(odds[n]):
            result[n, k] = _sum(_bit(before, k)[:, 0] + _bit(after, k)[:, 1]) - none
    return result


def _over_candidates(odds: Array) -> Array:
    """Take candidates one by one; the sums are over subsets of targets that have one."""
    N, L = odds.shape
    nothing = np.full(1 << N, -np.inf)
    nothing[0] = 0.0
    forward, behind = [nothing], [np.zeros(1 << N)]
    for k in range(L):
        forward.append(_add(forward[-1], odds[:, k], 1))
        behind.append(_add(behind[-1], odds[:, L - 1 - k], 0))
    result = np.full((N, L), -np.inf)
    for n in range(N):
        none = _sum(_bit(forward[L], n)[:, 0])
        for k in _some(odds[n]):
            before, after = forward[k], behind[L - 1 - k]
            result[n, k] = _sum(_bit(before, n)[:, 0] + _bit(after, n)[:, 1]) - none
    return result


def log_propagated(odds: Array) -> Array:
    """Extrinsic logs (N, L) by loopy belief propagation from the log odds (N, L).

    Messages of candidates to targets, ``1 / (1 + sum of the other targets' claims)``, and of
    targets to candidates, ``psi / (1 + sum of the other candidates' psi times message)``
    (Williams & Lau 2014), until they no longer change.
    """
    message = np.zeros_like(odds)
    for _ in range(ROUNDS):
        claim = odds - np.logaddexp(0.0, _others(odds + message, axis=1))
        new = -np.logaddexp(0.0, _others(claim, axis=0))
        change = float(np.max(np.abs(np.exp(new) - np.exp(message))))
        message = new
        if change <= SETTLED:
            break
    return message


def _others(logs: Array, axis: int) -> Array:
    """Log of the sum of all other entries along an axis."""
    moved = np.moveaxis(logs, axis, -1)
    none = np.full((*moved.shape[:-1], 1), -np.inf)
    before = np.logaddexp.accumulate(moved, axis=-1)[..., :-1]
    after = np.logaddexp.accumulate(moved[..., ::-1], axis=-1)[..., -2::-1]
    before = np.concatenate([none, before], axis=-1)
    after = np.concatenate([after, none], axis=-1)
    return np.moveaxis(np.logaddexp(before, after), -1, axis)
