"""Values that stay together: which message (emission) is whose.

Arrival times of one message share an unknown emission time, so rows cannot be predicted one by
one. Every message is taken in by every target on trial of being its own, a step of the IMM of no
length, which eliminates the offset exactly; the likelihoods say who has which. Messages come
seldom, and between two of them a prediction grows vague: an extended filter iterates here, and
the gate goes with it (`imm_tdoa.tracking.bending`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import AXES, Array, Index, Mask, MeasurementModel
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.assignment import assign
from imm_tdoa.tracking.bending import arrived, possible
from imm_tdoa.tracking.gates import threshold
from imm_tdoa.tracking.rows import Unlabelled

BATCH = 4000  # pairs of target and message tried at a time
GAIN = (-10.0, 30.0)  # least and greatest log-ratio that one message is worth


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


def locate(measurement: MeasurementModel, members: Index) -> Mask:
    """Which messages (E, m) have as many rows, beyond their unknown offset, as a place takes."""
    present = measurement.independent(members >= 0)
    group = measurement.offset_group
    left = gaussian.offset_contrast(np.ones(present.shape), present, group)[1]
    enough: Mask = np.count_nonzero(left, axis=-1) >= measurement.dims
    return enough


def choose(
    imm: IMM,
    measurement: MeasurementModel,
    state: State,
    scan: Unlabelled,
    gate_probability: float,
    log_region: float,
    strangers: float = -np.inf,
    *,
    exclusive: bool,
) -> Choice:
    """Return which message each target takes, those outside its gate excluded.

    Nor does a target take a message that is as likely a stranger's: where nearly nothing is known
    of it any more, every message passes its gate.

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
    strangers : float
        Log of how many emitters without a track there are per m^d
        (`imm_tdoa.tracking.strangers`).
    exclusive : bool
        One target per message, all pairs together likeliest; else each target for itself.
    """
    m, N = measurement.size, len(state.log_likelihood)
    group = messages(scan, m)
    E = len(group)
    nothing = Choice(state, np.full((N, m), -1, dtype=np.int64), np.zeros(N))
    if N == 0 or E == 0:
        return nothing
    if imm.update == "ekf":
        imm = attrs.evolve(imm, update="iekf")
    z = np.where(group >= 0, scan.values[group] / measurement.scale, np.nan)
    known = np.flatnonzero(_densest(state) >= strangers)
    cost, density, place, after = _tried(imm, measurement, state, known, z, gate_probability)
    cost = np.where(density >= strangers, cost, np.inf)
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
    gain[n] = np.clip(log_region + density[n, choice[n]], *GAIN)
    return Choice(batches.put(state, n, chosen), members, gain)


def _tried(
    imm: IMM,
    measurement: MeasurementModel,
    state: State,
    known: Index,
    z: Array,
    gate_probability: float,
) -> tuple[Array, Array, Index, State | None]:
    """What it costs (N, E) that one of the targets `known` has a message; outside the gate inf.

    With it the log of the target's density at the message's place (N, E), and the states after
    the pairs that were tried as one batch, with each pair's place (N, E) in it.
    """
    N, E = len(state.log_likelihood), len(z)
    n, e = (i.ravel() for i in np.meshgrid(known, np.arange(E), indexing="ij"))
    own_modes = imm.merging in ("imm", "autonomous")  # a hypothesis each, as `arrived` has them
    iterates = imm.update == "iekf" and imm.robust is None and own_modes
    if iterates and len(n):
        near = [
            possible(measurement, batches.select(state, n[some]), z[e[some]], gate_probability)
            for some in _shares(len(n))
        ]
        n, e = n[np.concatenate(near)], e[np.concatenate(near)]
    cost, density = np.full((N, E), np.inf), np.full((N, E), -np.inf)
    place = np.full((N, E), -1, dtype=np.int64)
    if not len(n):
        return cost, density, place, None
    after = batches.join(
        [
            _after(imm, measurement, batches.select(state, n[some]), z[e[some]], iterates)
            for some in _shares(len(n))
        ]
    )
    change = after.log_likelihood - state.log_likelihood[n]
    cost[n, e] = np.where(_within(after, gate_probability), -2.0 * change, np.inf)
    density[n, e] = _density(batches.select(state, n), after)
    place[n, e] = np.arange(len(n))
    return cost, density, place, after


def _shares(count: int) -> Iterator[slice]:
    """All pairs, some at a time."""
    for first in range(0, count, BATCH):
        yield slice(first, first + BATCH)


def _after(
    imm: IMM, measurement: MeasurementModel, before: State, z: Array, iterates: bool
) -> State:
    """States after targets (P,) took in messages (P, m), with the innovation that is gated."""
    after = imm.step(before, before.time, z, measurement=measurement, engine="numpy")
    after = batches.whole(after)
    return arrived(measurement, before, after, z) if iterates else after


def _within(after: State, gate_probability: float) -> Mask:
    """Which of the pairs (P,) pass the gate."""
    nis, dof = after.taken.nis, after.taken.nis_dof
    passed: Mask = (nis <= threshold(gate_probability, dof)) & (dof > 0)
    return passed


def _density(before: State, after: State) -> Array:
    """Log of the predicted density (P,), per m^d, of the place that the message alone gives.

    The covariance of that place follows from what the message took away.
    """
    d, P = before.space.dims, _place(before)
    left = np.linalg.eigvals(np.linalg.solve(P, _place(after))).real.clip(0.0, 1.0 - 1e-6)
    log_det = np.linalg.slogdet(P)[1] - np.sum(np.log1p(-left), axis=-1)
    nis = after.taken.nis - np.maximum(after.taken.nis_dof - d, 0)  # the place's share of it
    result: Array = -0.5 * (d * gaussian.LOG_2PI + log_det + np.maximum(nis, 0.0))
    return result


def _densest(state: State) -> Array:
    """Log of the density (N,) of the targets where they are expected most."""
    result: Array = -0.5 * np.linalg.slogdet(2.0 * np.pi * _place(state))[1]
    return result


def _place(state: State) -> Array:
    """Covariance (N, d, d) of the position."""
    i = np.array([state.components.index(a) for a in AXES[: state.space.dims]])
    result: Array = state.covariance[:, i[:, None], i]
    return result
