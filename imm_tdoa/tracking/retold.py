"""The last scans told anew, of tracks that compete: each from the same prior, with all it has now.

What a scan gave a track when it came depends on what was known of the track then: one that began
later, or from worse fixes, got less for the same rows. Rivals are compared by how likely all rows
of the last scans are together, from a prior that is the same for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa.contract import AXES, Array, Index
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.alone import likeliest
from imm_tdoa.tracking.clutter import extent
from imm_tdoa.tracking.combinations import own_values
from imm_tdoa.tracking.lookback import backwards, members_of, moved, turned
from imm_tdoa.tracking.memory import Heard
from imm_tdoa.tracking.standing import MANY, UNKNOWN
from imm_tdoa.tracking.targets import predict_rows


class Retold(NamedTuple):
    """The last scans told anew.

    Attributes
    ----------
    gains : (N, K)
        Log-ratio that each scan gives each track, newest first.
    members : (N, K, m)
        Which value of each scan each had, oldest first; -1 none.
    values : (N, K m)
        The same, numbered as in `Standing`.
    state : State
        What these say of the tracks now.
    """

    gains: Array
    members: Index
    values: Index
    state: State


def retold(
    imm: IMM, state: State, heard: Sequence[Heard], own: Index, detection_probability: float
) -> Retold:
    """Tell the last scans anew of tracks: which values they had, how likely, where they are then.

    An estimate that starts where the track was in the oldest scan, its position as vague as
    where emitters are expected and the rest by the birth law, takes in the rows that were the
    track's. The sum over the scans is the log of how much likelier they are together from the
    target than false: it does not depend on when the track began, and the prior is the same for
    all tracks. Which rows were the track's is told in several ways, of which the likeliest
    counts: as it has taken them itself, where that is known; as the present state led back
    finds them; and as the state finds them that the better of these leads to.

    Parameters
    ----------
    imm : IMM
        Predicts and takes in.
    state : State
        Tracks (N,) now.
    heard : sequence of Heard
        The last scans, oldest first, the present one last.
    own : (N, K, m)
        Which value of each of these scans the track had; -1 none, -2 not known.
    detection_probability : float
        Probability that a row of a target is measured.
    """
    P_D = detection_probability
    best, told = _led_back(imm, state, heard, np.full_like(own, UNKNOWN), P_D)
    gains, after = _forward(imm, told, heard, best, P_D)
    for from_there, known in ((state, own), (None, np.full_like(own, UNKNOWN))):
        members, told = _led_back(imm, from_there or after, heard, known, P_D)
        other, end = _forward(imm, told, heard, members, P_D)
        better = np.flatnonzero(other.sum(axis=1) > gains.sum(axis=1))
        gains[better], best[better] = other[better], members[better]
        after = batches.put(after, better, batches.select(end, better))
    number = np.array([h.scan for h in heard])[:, None]
    values = np.where(best >= 0, best + number * MANY, -1)
    return Retold(gains, best, values.reshape(len(best), -1), after)


def _led_back(
    imm: IMM, state: State, heard: Sequence[Heard], own: Index, P_D: float
) -> tuple[Index, State]:
    """Which values (N, K, m) were the tracks', and where they were in the oldest scan."""
    measurement = imm.measurement
    back, members = backwards(imm, state), own.copy()
    for k in reversed(range(len(heard))):
        h = heard[k]
        back = moved(imm, back, -h.time)
        then = turned(back)  # stations are where they were then
        there = np.isin(np.arange(measurement.size), h.row)
        found = likeliest(predict_rows(measurement, then, there), h.rows, h.density, P_D)
        known = (own[:, k] != UNKNOWN).all(axis=-1)
        members[:, k] = np.where(known[:, None], own[:, k], members_of(found, h.row))
        z = own_values(measurement, h.rows, members[:, k])
        back = turned(batches.whole(imm.step(then, then.time, z, engine="numpy")))
    return members, turned(back)


def _forward(
    imm: IMM, first: State, heard: Sequence[Heard], members: Index, P_D: float
) -> tuple[Array, State]:
    """Log-ratios (N, K), newest first, of values that tracks had, and the states after them."""
    if imm.update == "ekf":
        # with so vague a prior one linearisation costs more nats than rivals are apart
        imm = attrs.evolve(imm, update="iekf")
    measurement, d, N = imm.measurement, imm.measurement.dims, len(members)
    i = np.array([first.components.index(a) for a in AXES[:d]])
    vague = np.broadcast_to(extent(measurement, heard[0].time) ** 2 * np.eye(d), (N, d, d))
    state = batches.whole(imm.start(np.full(N, heard[0].time), first.mean[:, i], vague))
    gains = np.zeros((N, len(heard)))
    for k, h in enumerate(heard):
        state = moved(imm, state, h.time)
        z = own_values(measurement, h.rows, members[:, k])
        after = batches.whole(imm.step(state, state.time, z, engine="numpy"))
        hit, miss = np.log(P_D) - np.log(h.density), np.log1p(-min(P_D, 0.999))
        there = np.isin(np.arange(measurement.size), h.row)
        rows = np.where(np.isfinite(z), hit, np.where(there, miss, 0.0))
        gains[:, -1 - k] = after.log_likelihood - state.log_likelihood + rows.sum(axis=-1)
        state = after
    return gains, state
