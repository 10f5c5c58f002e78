"""Whether tracks stay with their targets: purity, identity switches, latency."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.metrics.sets import aligned, distances


def follow(truth: Any, tracks: Any, cutoff: float) -> Index:
    """Return which track follows each target at each scan (M, T), -1 being none.

    As in the CLEAR metrics (Bernardin & Stiefelhagen, EURASIP J. Image Video Process. 2008,
    246309): a track stays with its target while it is within `cutoff` of it; what is left is
    matched one to one, as many pairs within `cutoff` as possible, at the least sum of distances.

    Parameters
    ----------
    truth : (M, T, d)
        Where each target is at each scan; NaN where it does not exist.
    tracks : (N, T, d)
        Where each track is; NaN where it does not exist.
    cutoff : float
        Largest distance at which a track follows a target, in the unit of the positions.
    """
    x, y = aligned(truth, tracks)
    c = _validate.positive("cutoff", cutoff)
    M, T = x.shape[:2]
    result = np.full((M, T), -1, dtype=np.int64)
    last = np.full(M, -1, dtype=np.int64)
    for k in range(T):
        D = distances(x[:, k], y[:, k])
        near = np.less_equal(D, c, where=np.isfinite(D), out=np.zeros(D.shape, dtype=bool))
        held = np.flatnonzero(last >= 0)
        for m in held[near[held, last[held]]]:
            if last[m] not in result[:, k]:
                result[m, k] = last[m]
        free = np.flatnonzero(result[:, k] < 0)
        rest = np.setdiff1d(np.arange(y.shape[0]), result[:, k])
        part = np.ix_(free, rest)
        # a pair too far apart costs more than all good ones together
        cost = np.where(near[part], D[part], c * (min(len(free), len(rest)) + 1.0))
        i, j = linear_sum_assignment(cost)
        good = near[part][i, j]
        result[free[i[good]], k] = rest[j[good]]
        last = np.where(result[:, k] >= 0, result[:, k], last)
    return result


def purity(label: Any) -> Array:
    """Share (...) of a track's labels that are its most frequent one.

    Parameters
    ----------
    label : (..., K) int
        The target behind each row that the track took, or that it followed at each scan;
        negative: nobody knows, and it does not count. Rows known to be false want a label of
        their own, unlike any target's.

    Returns
    -------
    (...)
        1 is a track of one target only; NaN where there is no label at all.
    """
    labels = _labels("label", label)
    result = np.full(labels.shape[:-1], np.nan)
    for n in np.ndindex(result.shape):
        own = labels[n][labels[n] >= 0]
        if len(own):
            result[n] = np.unique(own, return_counts=True)[1].max() / len(own)
    return result


def id_switches(track: Any) -> Index:
    """Number of times (...) that a target is taken over by another track than before.

    Parameters
    ----------
    track : (..., T) int
        Track that follows the target at each scan (`follow`); negative: none. A gap is no
        switch, another track after the gap is.
    """
    tracks = _labels("track", track)
    result = np.zeros(tracks.shape[:-1], dtype=np.int64)
    for n in np.ndindex(result.shape):
        result[n] = np.count_nonzero(np.diff(tracks[n][tracks[n] >= 0]))
    return result


def latency(present: Any, track: Any, times: Any = None) -> Array:
    """How long (...) each target existed before a track followed it; NaN where none ever did.

    Parameters
    ----------
    present : (..., T) bool
        Whether the target exists at each scan.
    track : (..., T) int
        Confirmed track that follows it (`follow`); negative: none.
    times : (T,), optional
        Times of the scans, s. Default: the latency is in scans, 0 if it was followed at once.

    Raises
    ------
    ValueError
        Shapes or types that do not fit.
    """
    tracks = _labels("track", track)
    there: Mask = np.asarray(present)
    if there.dtype != np.bool_ or there.shape != tracks.shape:
        raise ValueError(
            f"present: expected booleans of shape {tracks.shape}, got {there.dtype} "
            f"of shape {there.shape}"
        )
    T = tracks.shape[-1]
    clock = np.arange(T, dtype=float) if times is None else _validate.array("times", times, (T,))
    followed = there & (tracks >= 0)
    ever = followed.any(axis=-1)
    if T == 0:
        return np.full(ever.shape, np.nan)
    wait = clock[np.argmax(followed, axis=-1)] - clock[np.argmax(there, axis=-1)]
    return np.where(ever, wait, np.nan)


def false_tracks(track: Any, count: int) -> Mask:
    """Which of `count` tracks (count,) never followed any target.

    Parameters
    ----------
    track : (M, T) int
        Track that follows each target at each scan (`follow`).
    count : int
        Number of tracks.

    Raises
    ------
    ValueError
        More tracks in `track` than `count`.
    """
    tracks = _labels("track", track)
    if tracks.size and tracks.max() >= count:
        raise ValueError(f"count: expected more than {int(tracks.max())} tracks, got {count!r}")
    result: Mask = ~np.isin(np.arange(count), tracks)
    return result


def _labels(name: str, value: Any) -> Index:
    labels = np.asarray(value)
    if labels.ndim == 0 or not (labels.size == 0 or np.issubdtype(labels.dtype, np.integer)):
        raise ValueError(f"{name}: expected an array of whole numbers, got {value!r}")
    return labels.astype(np.int64)
