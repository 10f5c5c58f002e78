"""From two fixes of one emitter to its state now, and to what the scans around them say of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Index
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.statespace import KIND_OF
from imm_tdoa.tracking import batches, lookback
from imm_tdoa.tracking.births import unknown
from imm_tdoa.tracking.candidates import Candidates
from imm_tdoa.tracking.combinations import own_values
from imm_tdoa.tracking.memory import Heard, Memory
from imm_tdoa.tracking.merit import merit, noise_variance
from imm_tdoa.tracking.standing import TOLD, UNKNOWN, WINDOW

AMPLE = 2  # rows beyond need with which ghosts do not pass for targets


class Led(NamedTuple):
    """Tracks (B,) led from their first fix to the present.

    Attributes
    ----------
    state : State
        Their states now.
    log_ratio : (B,)
        Log of how much likelier the values of their fixes are from a target than false.
    gains, merits : (B, W)
        Log-ratio and merit of each of the last scans, newest first; NaN where not known.
    past : (B, TOLD, m)
        Which values they had, as in `Standing.own`.
    """

    state: State
    log_ratio: Array
    gains: Array
    merits: Array
    past: Index


def led(
    imm: IMM,
    now: Heard,
    memory: Memory,
    found: Candidates,
    pairs: tuple[Index, Index],
    detection_probability: float,
) -> Led:
    """Lead tracks from remembered fixes to those of the present scan.

    Where rows are barely enough for a position, the remembered scans between the two and before
    them have their say too.

    Parameters
    ----------
    imm : IMM
        Predicts and takes in.
    now : Heard
        The present scan.
    memory : Memory
        Remembered fixes and rows.
    found : Candidates
        Fixes of the present scan.
    pairs : two of (B,)
        Which of `found`, and which of the remembered fixes, are one emitter's.
    detection_probability : float
        Probability that a row of a target is measured.
    """
    measurement, P_D = imm.measurement, detection_probability
    m, (new_fix, old_fix) = measurement.size, pairs
    heard = np.isin(np.arange(m), now.row[np.isfinite(now.values)])
    thin = now.emission is None and np.count_nonzero(heard) < measurement.dims + AMPLE
    rows = memory.heard if thin else ()
    hit, miss = np.log(P_D) - np.log(now.density), np.log1p(-min(P_D, 0.999))
    gains, merits = unknown(len(new_fix), m)[0], unknown(len(new_fix), m)[0]
    ratio = np.zeros(len(new_fix))
    own = np.full((len(new_fix), WINDOW, m), UNKNOWN, dtype=np.int64)
    parts, order = [], []
    for some in _groups(memory.scan[old_fix], apart=now.emission is None):
        old, new = memory.part(old_fix[some]), found.part(new_fix[some])
        s, ago = int(old.scan[0]), np.minimum(now.scan - old.scan, WINDOW - 1)
        gains[some, ago], merits[some, ago] = old.log_odds, old.merit
        ratio[some], own[some, ago] = old.log_odds, old.members
        state = batches.whole(imm.start(old.time, old.position, old.covariance))
        between = [h for h in rows if h.scan > s]
        if between:
            state, more = _between(imm, state, between, old, new, now.time, P_D)
            for h, said in zip(between, more, strict=True):
                gains[some, now.scan - h.scan] = said.gain
                merits[some, now.scan - h.scan] = said.merit
                own[some, now.scan - h.scan] = said.members
        z = own_values(measurement, now.rows, new.members)
        state, change = _taken_in(imm, state, now.time, z)
        each = np.where(np.isfinite(z), hit, np.where(heard, miss, 0.0))
        gains[some, 0] = change + each.sum(axis=-1)
        ratio[some] += gains[some, 0]
        state = batches.whole(state)
        merits[some, 0] = merit(
            state.taken.nis,
            state.taken.nis_dof.astype(float),
            np.isfinite(z),
            np.broadcast_to(heard, z.shape),
            noise_variance(measurement, new.position[0], now.time),
            now.density,
            P_D,
        )
        before = [h for h in reversed(rows) if h.scan < s]
        for h, said in zip(before, lookback.before(imm, state, before, P_D), strict=True):
            gains[some, now.scan - h.scan] = said.gain
            merits[some, now.scan - h.scan] = said.merit
            own[some, now.scan - h.scan] = said.members
        parts.append(state)
        order.append(some)
    back = np.argsort(np.concatenate(order), kind="stable")
    state = batches.select(batches.join(parts), back)
    return Led(state, ratio, gains, merits, own[:, :TOLD])


def _groups(scan: Index, *, apart: bool) -> list[Index]:
    """Tracks that are led together: those from fixes of one scan, or messages, all (B,)."""
    if not apart:
        return [np.arange(len(scan))]
    return [np.flatnonzero(scan == s) for s in np.unique(scan)]


def swerve(imm: IMM, dt: Array) -> Array:
    """How far (F,) the acceleration of the birth law may lead in `dt`, m."""
    has = any(KIND_OF.get(c) == "acceleration" for c in imm.space.components)
    std = imm.bank.birth_std.get("acceleration", 0.0) if has else 0.0
    result: Array = 0.5 * std * dt**2
    return result


def _between(
    imm: IMM,
    state: State,
    heard: list[Heard],
    old: Memory,
    new: Candidates,
    time: float,
    P_D: float,
) -> tuple[State, list[lookback.Said]]:
    """Lead states from old fixes, all of one scan, through the scans before the new ones."""
    d = imm.measurement.dims
    times = float(old.time[0]), time
    reach = swerve(imm, np.array([0.5 * (times[1] - times[0])]))[0] ** 2
    wide = np.maximum(old.covariance, 0.0) * np.eye(d)
    wide = np.maximum(wide, new.covariance * np.eye(d))
    wide = wide + reach * np.eye(d)
    ends = old.position, new.position
    return lookback.between(imm, state, heard, ends, wide, times, P_D)


def _taken_in(imm: IMM, state: State, time: float, values: Array) -> tuple[State, Array]:
    """State (B,) after values (B, m) at `time`, and their log-likelihood."""
    state = imm.step(
        state, np.full(len(values), time), np.full_like(values, np.nan), engine="numpy"
    )
    after = imm.step(state, state.time, values, engine="numpy")
    return after, after.log_likelihood - state.log_likelihood
