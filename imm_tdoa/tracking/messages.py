"""Values that stay together: which message (emission) is whose.

Arrival times of one message share an unknown emission time, so rows cannot be predicted one by
one. Every message is taken in by every target on trial of being its own, a step of the IMM of no
length, which eliminates the offset exactly; the likelihoods say who has which.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa.contract import AXES, Array, Index, Mask, MeasurementModel
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.assignment import assign
from imm_tdoa.tracking.gates import threshold
from imm_tdoa.tracking.rows import Unlabelled

BATCH = 4000  # pairs of target and message tried at a time


class Choice(NamedTuple):
    """Which message each of N targets takes.

    Attributes
    ----------
    state : State
        The targets after it.
    members : (N, m)
        Which value of the scan each row took; -1 none.
    gain : (N,)
        Log of how much likelier the message is the target's than that of an emitter anywhere.
    """

    state: State
    members: Index
    gain: Array


def messages(scan: Unlabelled, size: int) -> Index:
    """Return the values (E, m) of each message by row; -1 where it has none."""
    there = np.flatnonzero(np.isfinite(scan.values))
    names, which = np.unique(scan.emission[there], return_inverse=True)
    members = np.full((len(names), size), -1, dtype=np.int64)
    members[which, scan.row[there]] = there
    return members


def choose(
    imm: IMM,
    measurement: MeasurementModel,
    state: State,
    scan: Unlabelled,
    gate_probability: float,
    log_region: float,
    *,
    exclusive: bool,
) -> Choice:
    """Return which message each target takes, those outside its gate excluded.

    Parameters
    ----------
    imm : IMM
        Takes the messages in.
    measurement : MeasurementModel
        What is measured.
    state : State
        Targets (N,) predicted to the time of the scan.
    scan : Unlabelled
        Rows with emissions, internal units.
    gate_probability : float
        Probability that a target's own message passes its gate.
    log_region : float
        Log of the volume in which an emitter nobody knows may be.
    exclusive : bool
        One target per message, all pairs together likeliest; else each target for itself.
    """
    m, N = measurement.size, len(state.log_likelihood)
    group = messages(scan, m)
    E = len(group)
    nothing = Choice(state, np.full((N, m), -1, dtype=np.int64), np.zeros(N))
    if N == 0 or E == 0:
        return nothing
    z = np.where(group >= 0, scan.values[group] / measurement.scale, np.nan)
    cost, nis, place, after = _tried(imm, measurement, state, z, gate_probability)
    if exclusive:
        spare = np.where(cost < np.inf, cost, -np.inf).max(axis=0)
        price = np.where(np.isfinite(spare), spare + 1.0, 0.0)
        choice = assign(cost - price)
    else:
        choice = np.where(np.isfinite(cost.min(axis=1)), np.argmin(cost, axis=1), -1)
    n = np.flatnonzero(choice >= 0)
    if not len(n) or after is None:
        return nothing
    chosen = batches.select(after, place[n, choice[n]])
    members, gain = nothing.members, nothing.gain
    members[n] = group[choice[n]]
    gain[n] = _gain(batches.select(state, n), chosen, nis[n, choice[n]], log_region)
    return Choice(batches.put(state, n, chosen), members, gain)


def _tried(
    imm: IMM, measurement: MeasurementModel, state: State, z: Array, gate_probability: float
) -> tuple[Array, Array, Index, State | None]:
    """What it costs (N, E) that a target has a message, infinite outside the gate.

    With it the normalised innovation less what its rows expect (N, E), and the states after the
    pairs within the gate as one batch, with each pair's place (N, E) in it.
    """
    N, E = len(state.log_likelihood), len(z)
    n, e = (i.ravel() for i in np.meshgrid(np.arange(N), np.arange(E), indexing="ij"))
    if imm.update == "iekf" and imm.robust is None:
        # iterating does not change the innovation, so nobody outside the gate need be iterated
        once = attrs.evolve(imm, update="ekf")
        near = np.concatenate(
            [
                _within(after, gate_probability)
                for after in _steps(once, measurement, state, z, n, e)
            ]
        )
        n, e = n[near], e[near]
    cost, nis = np.full((N, E), np.inf), np.zeros((N, E))
    place = np.full((N, E), -1, dtype=np.int64)
    if not len(n):
        return cost, nis, place, None
    after = batches.join(list(_steps(imm, measurement, state, z, n, e)))
    change = after.log_likelihood - state.log_likelihood[n]
    cost[n, e] = np.where(_within(after, gate_probability), -2.0 * change, np.inf)
    nis[n, e] = after.taken.nis - np.maximum(after.taken.nis_dof - state.space.dims, 0)
    place[n, e] = np.arange(len(n))
    return cost, nis, place, after


def _steps(
    imm: IMM, measurement: MeasurementModel, state: State, z: Array, n: Index, e: Index
) -> Iterator[State]:
    """States after targets n (P,) took in messages e (P,), some at a time."""
    for first in range(0, len(n), BATCH):
        some = slice(first, first + BATCH)
        every = batches.select(state, n[some])
        tried = imm.step(every, every.time, z[e[some]], measurement=measurement, engine="numpy")
        yield batches.whole(tried)


def _within(after: State, gate_probability: float) -> Mask:
    """Which of the pairs (P,) pass the gate."""
    nis, dof = after.taken.nis, after.taken.nis_dof
    passed: Mask = (nis <= threshold(gate_probability, dof)) & (dof > 0)
    return passed


def _gain(before: State, after: State, nis: Array, log_region: float) -> Array:
    """Log of the predicted density (n,) of the message's place over that of anywhere.

    The covariance of the place that the message alone gives follows from what it took away.
    """
    d = before.space.dims
    i = np.array([before.components.index(a) for a in AXES[:d]])
    P = before.covariance[:, i[:, None], i]
    Q = after.covariance[:, i[:, None], i]
    left = np.linalg.eigvals(np.linalg.solve(P, Q)).real.clip(0.0, 1.0 - 1e-6)
    log_det = np.linalg.slogdet(P)[1] - np.sum(np.log1p(-left), axis=-1)
    gain = log_region - 0.5 * (d * np.log(2.0 * np.pi) + log_det + np.maximum(nis, 0.0))
    result: Array = np.clip(gain, -10.0, 30.0)
    return result
