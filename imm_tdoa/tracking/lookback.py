"""What the scans before its birth say of a track: rivals are then compared on the same scans.

Where rows are barely enough for a position, ghosts pass for targets, and only all scans together
tell them apart. A track that begins from fixes of two scans is led through the remembered scans
between them, and backwards in time through those before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa.contract import AXES, Array, Index
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.statespace import KIND_OF
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.alone import likeliest
from imm_tdoa.tracking.memory import Heard
from imm_tdoa.tracking.merit import merit, noise_variance
from imm_tdoa.tracking.rows import Association, Prediction
from imm_tdoa.tracking.targets import predict_rows

REVERSED = {"velocity": -1.0, "turn_rate": -1.0}  # what changes its sign when time runs back


class Said(NamedTuple):
    """What a scan says of tracks (B,): log-ratio, merit, and which values (B, m) they had."""

    gain: Array
    merit: Array
    members: Index


def between(
    imm: IMM,
    state: State,
    heard: Sequence[Heard],
    ends: tuple[Array, Array],
    covariance: Array,
    times: tuple[float, float],
    detection_probability: float,
) -> tuple[State, list[Said]]:
    """Lead tracks from a fix through the scans before their next, which lies on a straight line.

    Parameters
    ----------
    imm : IMM
        Predicts and takes in.
    state : State
        Tracks (B,) at the first fix.
    heard : sequence of Heard
        The scans between, in order.
    ends : two of (B, d)
        The fixes.
    covariance : (B, d, d)
        How uncertain a place between them is.
    times : (float, float)
        Their times, s.
    detection_probability : float
        Probability that a row of a target is measured.

    Returns
    -------
    state : State
        After the scans.
    said : list of Said
        What each scan says of them.
    """
    said: list[Said] = []
    measurement = imm.measurement
    for h in heard:
        share = (h.time - times[0]) / (times[1] - times[0])
        place = ends[0] + share * (ends[1] - ends[0])
        rest = np.zeros_like(place)
        rows = measurement.predict(place, rest, h.time)
        H = measurement.jacobian(place, rest, h.time)[0]
        S = H @ covariance @ np.swapaxes(H, -1, -2)
        S = S + measurement.noise_covariance(place, rest, h.time)
        there = np.isin(np.arange(measurement.size), h.row)
        prediction = Prediction(np.where(there, rows, np.nan), S)
        state, one = _take(imm, state, h, prediction, h.time, detection_probability)
        said.append(one)
    return state, said


def before(
    imm: IMM, state: State, heard: Sequence[Heard], detection_probability: float
) -> list[Said]:
    """Return what scans before the tracks' birth say of them, the latest first.

    Parameters
    ----------
    imm, detection_probability
        As for `between`.
    state : State
        Tracks (B,) at their birth.
    heard : sequence of Heard
        The scans, latest first.
    """
    if not heard:
        return []
    back = backwards(imm, state)
    said: list[Said] = []
    for h in heard:
        there = np.isin(np.arange(imm.measurement.size), h.row)
        back = moved(imm, back, -h.time)
        then = turned(back)  # stations are where they were then
        prediction = predict_rows(imm.measurement, then, there)
        then, one = _take(imm, then, h, prediction, h.time, detection_probability)
        back = turned(then)
        said.append(one)
    return said


def backwards(imm: IMM, state: State) -> State:
    """Return states (B,) from which time runs back, by clocks that show minus the time."""
    now = float(np.max(state.time))
    sign = np.array([REVERSED.get(KIND_OF.get(c, c), 1.0) for c in state.components])
    mean, covariance = state.mean * sign, state.covariance * sign[:, None] * sign
    return batches.whole(imm.start(np.full(len(mean), -now), mean, covariance, state.components))


def turned(state: State) -> State:
    """Return the states with the other sign on their clocks."""
    return attrs.evolve(state, time=-state.time)


def moved(imm: IMM, state: State, time: float) -> State:
    """Return states (B,) predicted to a time, s."""
    B = len(state.log_likelihood)
    nothing = np.full((B, imm.measurement.size), np.nan)
    return batches.whole(imm.step(state, np.full(B, time), nothing, engine="numpy"))


def _take(
    imm: IMM, state: State, h: Heard, prediction: Prediction, time: float, P_D: float
) -> tuple[State, Said]:
    """Take in the rows nearest a prediction, and return what they say."""
    association = likeliest(prediction, h.rows, h.density, P_D)
    z = association.values
    state = moved(imm, state, time)
    after = batches.whole(imm.step(state, state.time, z / imm.measurement.scale, engine="numpy"))
    took = np.isfinite(z)
    position = state.mean[
        0, np.array([state.components.index(a) for a in AXES[: state.space.dims]])
    ]
    hit, miss = np.log(P_D) - np.log(h.density), np.log1p(-min(P_D, 0.999))
    gain = after.log_likelihood - state.log_likelihood
    gain = gain + np.sum(np.where(took, hit, np.where(prediction.known, miss, 0.0)), axis=-1)
    worth = merit(
        after.taken.nis,
        after.taken.nis_dof.astype(float),
        took,
        prediction.known,
        noise_variance(imm.measurement, position, h.time),
        h.density,
        P_D,
    )
    return after, Said(gain, worth, members_of(association, h.row))


def members_of(association: Association, row: Index) -> Index:
    """Return which value (B, m) each row was given; -1 none."""
    members = np.full(association.values.shape, -1, dtype=np.int64)
    n, k = np.nonzero(association.weight > 0.5)
    members[n, row[k]] = k
    return members
