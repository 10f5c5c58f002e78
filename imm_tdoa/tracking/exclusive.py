"""Tracks on trial that explain the same values: which of them can be real together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from imm_tdoa.contract import Array, Index, Mask

RIVALS = 2  # values shared in the last scans that make two tracks rivals
GOOD = 0.8  # of the best rival's mean gain: whose gains stand in for missing ones
MOST = 60  # rivals considered together, the likeliest


class Contest(NamedTuple):
    """The best explanation of the last scans' values by tracks of which no two share one.

    Attributes
    ----------
    chosen : (N,) bool
        Tracks in it.
    behind : (N,)
        How much worse the best explanation with a track that is not in it is, nats, over the
        scans in which all tracks that make the difference were there.
    group : (N,) int
        Tracks of one group share values, directly or through others.
    """

    chosen: Mask
    behind: Array
    group: Index


def contest(values: Index, gains: Array) -> Contest:
    """Return which tracks explain the last scans best together (a packing, solved exactly).

    A value belongs to one target only. Of tracks that share values those count whose log-ratios
    sum highest, over the scans since the oldest of them began. A younger rival gets, for scans
    before it began, what the others had on average: to have begun late is no fault of its own.

    Parameters
    ----------
    values : (N, V)
        Which values each track took in the last scans, by numbers of their own; -1 none.
    gains : (N, W)
        Log-ratio that each of the last scans gave each track, newest first; NaN before it began.
    """
    N = len(values)
    chosen, behind = np.ones(N, dtype=bool), np.zeros(N)
    apart = shared(values) >= RIVALS
    np.fill_diagonal(apart, False)
    group = connected_components(csr_array(apart), directed=False)[1] if N else np.zeros(0, int)
    for g in np.flatnonzero(np.bincount(group) > 1):
        rivals = np.flatnonzero(group == g)
        weight = _comparable(gains[rivals])
        if len(rivals) > MOST:
            order = np.argsort(-weight, kind="stable")
            chosen[rivals[order[MOST:]]], behind[rivals[order[MOST:]]] = False, np.inf
            rivals, weight = rivals[order[:MOST]], weight[order[:MOST]]
        edges = apart[np.ix_(rivals, rivals)]
        packed = _packed(edges, weight)
        chosen[rivals] = packed
        for k in np.flatnonzero(~packed):
            out = edges[k] | (np.arange(len(rivals)) == k)
            other = _packed(edges, np.where(out, 0.0, weight))
            other[k] = True
            behind[rivals[k]] = _lead(gains[rivals], packed & ~other, other & ~packed)
    return Contest(chosen, behind, group.astype(np.int64))


def contest_of_stories(values: Index, gains: Array, prefer: Array) -> Contest:
    """As `contest`, where tracks that explain the very same values count once.

    Of such tracks the one to `prefer` (N,) most stands for all; the others are not in the best
    explanation, and not behind it.
    """
    order = np.argsort(-prefer, kind="stable")
    _, first, story = np.unique(values[order], axis=0, return_index=True, return_inverse=True)
    one = order[first]
    best = contest(values[one], gains[one])
    of = np.empty(len(values), dtype=np.int64)
    of[order] = story.reshape(-1)
    stands = np.zeros(len(values), dtype=bool)
    stands[one] = True
    chosen = best.chosen[of]
    return Contest(chosen & stands, np.where(chosen, 0.0, best.behind[of]), best.group[of])


def _lead(gains: Array, these: Mask, those: Mask) -> float:
    """How much more `these` tracks explained than `those`, while all of them were there."""
    common = np.isfinite(gains[these | those]).all(axis=0)
    return float(gains[these][:, common].sum() - gains[those][:, common].sum())


def outdone(values: Index, gains: Array) -> Array:
    """How much (N,) the best rival of each track explained more, while both were there, nats."""
    rivals = shared(values) >= RIVALS
    np.fill_diagonal(rivals, False)
    there = np.isfinite(gains)
    g = np.where(there, gains, 0.0)
    theirs = there.astype(float) @ g.T  # what the second got while the first was there
    lead = theirs - theirs.T
    result: Array = np.max(np.where(rivals, lead, -np.inf), axis=1, initial=-np.inf)
    return result


def shared(values: Index) -> Index:
    """Number (N, N) of values that each two tracks took both."""
    known, place = np.unique(values, return_inverse=True)
    place = place.reshape(values.shape)
    taken = np.zeros((len(values), len(known)))
    taken[np.arange(len(values))[:, None], place] = 1.0
    taken[:, known < 0] = 0.0
    return (taken @ taken.T).astype(np.int64)


def _comparable(gains: Array) -> Array:
    """Sums of gains (n,), a missing one being the mean of what good rivals got in its scan."""
    there = np.isfinite(gains)
    sums = np.where(there, gains, 0.0).sum(axis=1)
    rate = sums / np.maximum(there.sum(axis=1), 1)
    good = there & (rate >= GOOD * rate.max())[:, None]
    base = np.where(good, gains, 0.0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
    result: Array = np.where(there, gains, base).sum(axis=1)
    return result


def _packed(edges: Mask, weight: Array) -> Mask:
    """Tracks without an edge between any two whose weights sum highest."""
    gain = np.maximum(weight, 0.0)
    i, j = np.nonzero(np.triu(edges & (gain > 0.0) & (gain > 0.0)[:, None]))
    if not len(i):
        return np.asarray(weight > 0.0)
    line = np.arange(len(i))
    sides = csr_array(
        (np.ones(2 * len(i)), (np.tile(line, 2), np.concatenate([i, j]))),
        shape=(len(i), len(gain)),
    )
    found = milp(
        -gain,
        constraints=LinearConstraint(sides, ub=1.0),
        integrality=np.ones(len(gain)),
        bounds=Bounds(0.0, 1.0),
    )
    return np.asarray((np.round(found.x) > 0.5) & (weight > 0.0))
