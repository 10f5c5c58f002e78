"""Values that stay together: which message (emission) is whose.

Arrival times of one message share an unknown emission time, so rows cannot be predicted one by
one. Every message is taken in by every target on trial of being its own, a step of the IMM of no
length, which eliminates the offset exactly; the likelihoods say who has which.
"""

from __future__ import annotations

from typing import NamedTuple

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
    fit, nis, after = _tried(imm, measurement, state, z, gate_probability)
    if exclusive:
        spare = np.where(fit < np.inf, fit, -np.inf).max(axis=0)
        price = np.where(np.isfinite(spare), spare + 1.0, 0.0)
        choice = assign(fit - price)
    else:
        choice = np.where(np.isfinite(fit.min(axis=1)), np.argmin(fit, axis=1), -1)
    n = np.flatnonzero(choice >= 0)
    if not len(n):
        return nothing
    chosen = batches.join([batches.select(after[e], n[choice[n] == e]) for e in range(E)])
    n = np.concatenate([n[choice[n] == e] for e in range(E)])
    members, gain = nothing.members, nothing.gain
    members[n] = group[choice[n]]
    gain[n] = _gain(batches.select(state, n), chosen, nis[n, choice[n]], log_region)
    return Choice(batches.put(state, n, chosen), members, gain)


def _tried(
    imm: IMM, measurement: MeasurementModel, state: State, z: Array, gate_probability: float
) -> tuple[Array, Array, list[State]]:
    """Cost (N, E), infinite outside the gate; NIS less what its rows expect; states after each."""
    N, E = len(state.log_likelihood), len(z)
    after: list[State] = []
    step = max(BATCH // N, 1)
    for first in range(0, E, step):
        some = z[first : first + step]
        every = batches.select(state, np.tile(np.arange(N), len(some)))
        tried = imm.step(
            every,
            every.time,
            np.repeat(some, N, axis=0),
            measurement=measurement,
            engine="numpy",
        )
        tried = batches.whole(tried)
        after += [batches.select(tried, slice(e * N, (e + 1) * N)) for e in range(len(some))]
    nis = np.stack([a.taken.nis for a in after], axis=1)
    dof = np.stack([a.taken.nis_dof for a in after], axis=1)
    change = np.stack([a.log_likelihood - state.log_likelihood for a in after], axis=1)
    rejected: Mask = ~(nis <= threshold(gate_probability, dof)) | (dof == 0)
    spare = dof - state.space.dims
    return np.where(rejected, np.inf, -2.0 * change), nis - np.maximum(spare, 0), after


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
