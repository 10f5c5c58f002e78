"""Tracks begin from scans too thin for a fix: what several of them say together.

Rows may come one pair of stations at a time. One value of the present scan and values of earlier
ones, of as many different rows as a position has coordinates, allow places; where more values
agree with a place than it takes, the last scans are told of an emitter that moves by the birth
law (`imm_tdoa.tracking.retold`), and how likely that is decides. `imm_tdoa.initiation` does the
same for a single target.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.births import unknown
from imm_tdoa.tracking.clutter import extent
from imm_tdoa.tracking.combinations import GATE, places_of, ranging, seed_spread, seeds_of
from imm_tdoa.tracking.exclusive import shared
from imm_tdoa.tracking.memory import Heard
from imm_tdoa.tracking.retold import Retold, retold
from imm_tdoa.tracking.rows import Unlabelled
from imm_tdoa.tracking.standing import TOLD, UNKNOWN, WINDOW

STORIES = 60  # places told of in one scan, those that can be likeliest
CREDIBLE = 0.0  # log-odds of the rows being one emitter's, under which nothing begins
SURE = 5.0  # a story that much likelier than another that shares values with it displaces it
SAME = 9.0  # squared distance, in standard deviations, within which two stories are one


class Gathered(NamedTuple):
    """Tracks (B,) that the last thin scans suggest, the likeliest first.

    Attributes
    ----------
    state : State or None
        Their states now; None for none.
    members : (B, m)
        Which value of the present scan each row had; -1 none.
    gains : (B, W)
        Log-ratio that each of the last scans gives, newest first; NaN where not gathered.
    past : (B, TOLD, m)
        Which values they had, as in `Standing.own`.
    log_ratio : (B,)
        Log of how much likelier all their values are from a target than false, less the log of
        how many places were tried: the best of many fits well by chance.
    left_out : int
        Combinations that were not tried.
    """

    state: State | None
    members: Index
    gains: Array
    past: Index
    log_ratio: Array
    left_out: int


def is_thin(measurement: MeasurementModel, now: Heard) -> bool:
    """Whether a scan, no message, has too few different rows for a position, whoever took them."""
    if now.emission is not None:
        return False
    every = Unlabelled(np.zeros(len(now.row)), now.row)
    return len(ranging(measurement, now.time, every)) < measurement.dims


def gathered(
    imm: IMM, heard: Sequence[Heard], speed: Array, most: int, detection_probability: float
) -> Gathered:
    """Return the tracks that thin scans suggest, each with a value of the last of them.

    Parameters
    ----------
    imm : IMM
        Predicts and takes in.
    heard : sequence of Heard
        The last thin scans, oldest first, the present one last.
    speed : (d,)
        Standard deviation of the birth law's velocity, m/s.
    most : int
        Most combinations of values that are tried.
    detection_probability : float
        Probability that a row of a target is measured.
    """
    measurement, now = imm.measurement, heard[-1]
    d, m = measurement.dims, measurement.size
    gains, past = unknown(0, m)
    nothing = Gathered(None, np.zeros((0, m), dtype=np.int64), gains, past, np.zeros(0), 0)
    pool = _pooled(heard)
    columns = ranging(measurement, now.time, pool)
    if not np.isfinite(now.values).any() or len(columns) < d:
        return nothing
    seeds, left_out = _seeds(measurement, pool, now, columns, most)
    nothing = nothing._replace(left_out=left_out)
    places, seeds = places_of(measurement, now.time, pool, seeds)
    if not len(places):
        return nothing
    price = float(np.log(len(places)))
    wide, bound = _agreed(measurement, heard, pool, places, seeds, speed, detection_probability)
    order = np.argsort(-bound, kind="stable")[:STORIES]
    order = order[bound[order] - price >= CREDIBLE]
    if not len(order):
        return nothing
    places, wide, seeds = places[order], wide[order], seeds[order]
    state = batches.whole(imm.start(np.full(len(places), now.time), places, wide))
    story = retold(imm, state, heard, _by_scan(heard, seeds), detection_probability)
    ratio = story.gains.sum(axis=1) - price
    chosen = _credible(measurement.dims, columns, story, ratio)
    if not len(chosen):
        return nothing
    gains, past = unknown(len(chosen), m)
    for k, h in enumerate(heard):
        ago = now.scan - h.scan
        if ago < WINDOW:
            gains[:, ago] = story.gains[chosen, len(heard) - 1 - k]
        if ago < TOLD:
            past[:, ago] = story.members[chosen, k]
    return Gathered(
        batches.select(story.state, chosen),
        story.members[chosen, -1],
        gains,
        past,
        ratio[chosen],
        left_out,
    )


def _pooled(heard: Sequence[Heard]) -> Unlabelled:
    """All values as if they were of one scan."""
    return Unlabelled(
        np.concatenate([h.values for h in heard]), np.concatenate([h.row for h in heard])
    )


def _seeds(
    measurement: MeasurementModel, pool: Unlabelled, now: Heard, columns: Index, most: int
) -> tuple[Index, int]:
    """Combinations (B, m) with a value of the present scan, and how many were left out."""
    d, m = measurement.dims, measurement.size
    older = np.arange(len(pool.values)) < len(pool.values) - len(now.values)
    parts, left_out = [np.zeros((0, m), dtype=np.int64)], 0
    for i in np.intersect1d(now.row[np.isfinite(now.values)], columns).tolist():
        values = np.where(older & (pool.row == i), np.nan, pool.values)
        some, over = seeds_of(attrs.evolve(pool, values=values), columns, d, m, most, among=i)
        parts.append(some)
        left_out += over
    return np.unique(np.concatenate(parts), axis=0), left_out


def _agreed(
    measurement: MeasurementModel,
    heard: Sequence[Heard],
    pool: Unlabelled,
    places: Array,
    seeds: Index,
    speed: Array,
    P_D: float,
) -> tuple[Array, Array]:
    """How wide (P, d, d) places are, and how likely (P,) they can be at best, as log-odds.

    At best: every value that agrees with the place, the emitter moving, does so exactly. Minus
    infinity where no more values agree than it takes.
    """
    now, d = heard[-1].time, measurement.dims
    rest = np.zeros_like(places)
    far = (speed * (now - heard[0].time)) ** 2 * np.eye(d)
    h = measurement.predict(places, rest, now)
    H = measurement.jacobian(places, rest, now)[0]
    R = np.broadcast_to(measurement.noise_covariance(places, rest, now), (*h.shape, h.shape[1]))
    moved = R + H @ far @ np.swapaxes(H, -1, -2) * np.eye(h.shape[1])
    C = seed_spread(h, H, moved, pool, seeds)[2]
    count, bound = np.zeros(len(places)), 0.5 * np.linalg.slogdet(C)[1]
    bound += d * (0.5 * gaussian.LOG_2PI - np.log(extent(measurement, now)))
    for one in heard:
        h = measurement.predict(places, rest, one.time)
        H = measurement.jacobian(places, rest, one.time)[0]
        R = measurement.noise_covariance(places, rest, one.time)
        variance = np.broadcast_to(np.einsum("...mm->...m", R), h.shape)
        S = np.einsum("fmi,fij,fmj->fm", H, C + far, H) + variance
        near = np.abs(one.values - h[:, one.row]) <= GATE * np.sqrt(S[:, one.row])
        hit = np.log(P_D / one.density) - 0.5 * (gaussian.LOG_2PI + np.log(variance))
        for i in np.unique(one.row):
            agree = near[:, one.row == i].any(axis=-1)
            count += agree
            bound += np.where(agree, hit[:, i], np.log1p(-min(P_D, 0.999)))
    return C + far, np.where(count > d, bound, -np.inf)


def _by_scan(heard: Sequence[Heard], seeds: Index) -> Index:
    """Seeds (F, m) of the pool as values of each scan (F, K, m); not known where none is."""
    own = np.full((len(seeds), len(heard), seeds.shape[1]), UNKNOWN, dtype=np.int64)
    first = 0
    for k, h in enumerate(heard):
        here = (seeds >= first) & (seeds < first + len(h.values))
        own[:, k] = np.where(
            here.any(axis=-1, keepdims=True), np.where(here, seeds - first, -1), UNKNOWN
        )
        first += len(h.values)
    return own


def _credible(d: int, columns: Index, story: Retold, likely: Array) -> Index:
    """Stories that may be true, the likeliest first, none beside a far likelier of its values."""
    took = story.members >= 0
    good = (likely >= CREDIBLE) & took[:, -1].any(axis=-1)
    good &= np.count_nonzero(took, axis=(1, 2)) > d
    good &= np.count_nonzero(took[:, :, columns].any(axis=1), axis=-1) >= d
    order = np.flatnonzero(good)
    order = order[np.argsort(-likely[order], kind="stable")]
    common = shared(story.values)
    x, P = story.state.mean[:, :d], story.state.covariance[:, :d, :d]
    kept: list[int] = []
    for n in order.tolist():
        rivals = np.array([k for k in kept if common[k, n]], dtype=np.int64)
        apart = x[rivals] - x[n]
        near = np.einsum(
            "ni,ni->n", apart, np.linalg.solve(P[rivals] + P[n], apart[..., None])[..., 0]
        )
        if np.all(likely[rivals] <= likely[n] + SURE) and np.all(near > SAME):
            kept.append(n)
    return np.array(kept, dtype=np.int64)
