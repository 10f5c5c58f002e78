"""Who takes which rows of a scan, and what the tracks are afterwards."""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import AXES, Array, Index, Mask
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.alone import likeliest
from imm_tdoa.tracking.clutter import extent
from imm_tdoa.tracking.merit import merit, noise_variance
from imm_tdoa.tracking.messages import choose
from imm_tdoa.tracking.rows import Association, Prediction, Unlabelled
from imm_tdoa.tracking.settings import Settings
from imm_tdoa.tracking.targets import predict_rows, take_in

OWN = 0.5  # share of a value above which it counts as a track's own


class Taken(NamedTuple):
    """What N tracks made of a scan.

    Attributes
    ----------
    state : State
        After it.
    members : (N, m)
        Which value each row took, or took most of; -1 none.
    share : (N, m)
        How much of its rows each took; NaN is nothing.
    gain : (N,)
        Log of how much likelier the scan is with the track than without it.
    worth : (N,)
        Its merit (`imm_tdoa.tracking.merit`).
    claimed : (K,)
        How far each value is spoken for.
    """

    state: State
    members: Index
    share: Array
    gain: Array
    worth: Array
    claimed: Array


def confirmed_take(
    settings: Settings, state: State, rows: Unlabelled, density: Array, strangers: float
) -> Taken:
    """Give the confirmed tracks their rows by the associator, or whole messages."""
    measurement = settings.imm.measurement
    heard = heard_rows(rows, measurement.size)
    if not len(state.log_likelihood) or not heard.any():
        return _none(state, rows, measurement.size)
    if rows.emission is not None and np.any(measurement.offset_group >= 0):
        return _messages_take(settings, state, rows, strangers, exclusive=True)
    prediction = predict_rows(measurement, state, heard)
    association = settings.associate(density)(prediction, rows)
    if association.decided:
        return _decided(settings, state, rows, density, prediction, association)
    return _weighed(settings, state, rows, density, prediction, association)


def trials_take(
    settings: Settings, state: State, rows: Unlabelled, density: Array, strangers: float
) -> Taken:
    """Give each track on trial what is nearest, whoever else takes it."""
    measurement = settings.imm.measurement
    heard = heard_rows(rows, measurement.size)
    if not len(state.log_likelihood) or not heard.any():
        return _none(state, rows, measurement.size)
    if rows.emission is not None:
        return _messages_take(settings, state, rows, strangers, exclusive=False)
    prediction = predict_rows(measurement, state, heard)
    association = likeliest(
        prediction, rows, density, settings.detection_probability, settings.gate_probability
    )
    return _decided(settings, state, rows, density, prediction, association)


def _messages_take(
    settings: Settings, state: State, rows: Unlabelled, strangers: float, *, exclusive: bool
) -> Taken:
    measurement = settings.imm.measurement
    region = measurement.dims * np.log(extent(measurement, float(np.max(state.time))))
    chosen = choose(
        settings.imm,
        measurement,
        state,
        rows,
        settings.gate_probability,
        region,
        strangers,
        exclusive=exclusive,
    )
    share = np.where(chosen.members >= 0, 1.0, np.nan)
    claimed = values_of(chosen.members, len(rows.values))
    return Taken(chosen.state, chosen.members, share, chosen.gain, chosen.gain, claimed)


def _decided(
    settings: Settings,
    state: State,
    rows: Unlabelled,
    density: Array,
    prediction: Prediction,
    association: Association,
) -> Taken:
    """Take in rows that were given wholly, by a step of no length."""
    imm, measurement = settings.imm, settings.imm.measurement
    z = association.values / measurement.scale
    after = batches.whole(imm.step(state, state.time, z, engine="numpy"))
    members = _members(association.weight, rows, measurement.size)
    took = members >= 0
    P_D = settings.detection_probability
    hit, miss = np.log(P_D) - np.log(density), np.log1p(-P_D * settings.gate_probability)
    expected = prediction.known & ~took
    gain = after.log_likelihood - state.log_likelihood
    gain = gain + np.sum(np.where(took, hit, np.where(expected, miss, 0.0)), axis=-1)
    share = np.where(took, 1.0, np.nan)
    worth = _worth(settings, after, members, prediction.known, density)
    claimed = np.clip(association.weight.sum(axis=0), 0.0, 1.0)
    return Taken(after, members, share, gain, worth, claimed)


def _weighed(
    settings: Settings,
    state: State,
    rows: Unlabelled,
    density: Array,
    prediction: Prediction,
    association: Association,
) -> Taken:
    """Take in rows of which each track has shares."""
    after = take_in(settings.imm.measurement, state, association)
    got = np.where(prediction.known, 1.0 - association.missed, 0.0)
    assert association.innovation is not None
    w = np.exp(state.log_mode_probability)
    mean, S = prediction.bank()
    believed = np.einsum("nr,nrm->nm", w, prediction.mean + association.innovation) - mean
    used = got > OWN
    nu = np.where(used, believed, 0.0)
    both = used[:, :, None] & used[:, None, :]
    white = np.linalg.solve(gaussian.factor(np.where(both, S, np.eye(S.shape[-1]))), nu[..., None])
    dof = np.count_nonzero(used, axis=-1)
    taken = attrs.evolve(
        state.taken,
        nis=np.where(dof > 0, np.sum(white[..., 0] ** 2, axis=-1), np.nan),
        nis_dof=dof,
    )
    log_ratio = after.log_likelihood - state.log_likelihood
    after = attrs.evolve(after, taken=taken)
    members = _members(association.weight, rows, used.shape[1])
    return Taken(
        after,
        members,
        np.where(got > 0.0, got, np.nan),
        log_ratio,
        _worth(settings, after, members, prediction.known, density),
        np.clip(association.weight.sum(axis=0), 0.0, 1.0),
    )


def _worth(settings: Settings, after: State, members: Index, known: Mask, density: Array) -> Array:
    imm = settings.imm
    i = np.array([after.components.index(a) for a in AXES[: imm.measurement.dims]])
    return merit(
        after.taken.nis,
        np.asarray(after.taken.nis_dof, dtype=float),
        members >= 0,
        known,
        noise_variance(imm.measurement, after.mean[0, i], float(after.time[0])),
        density,
        settings.detection_probability,
    )


def _none(state: State, rows: Unlabelled, m: int) -> Taken:
    N = len(state.log_likelihood)
    return Taken(
        state,
        np.full((N, m), -1, dtype=np.int64),
        np.full((N, m), np.nan),
        np.zeros(N),
        np.zeros(N),
        np.zeros(len(rows.values)),
    )


def heard_rows(rows: Unlabelled, m: int) -> Mask:
    """Which of the m rows have any value."""
    return np.bincount(rows.row[np.isfinite(rows.values)], minlength=m)[:m] > 0


def _members(weight: Array, rows: Unlabelled, m: int) -> Index:
    """Which value (N, m) of each row a track has more than half of; -1 none."""
    members = np.full((len(weight), m), -1, dtype=np.int64)
    n, k = np.nonzero(weight > OWN)
    members[n, rows.row[k]] = k
    return members


def values_of(members: Index, count: int) -> Array:
    """Which of the scan's values (K,) are among the members, as 0 and 1."""
    result = np.zeros(count)
    result[members[members >= 0]] = 1.0
    return result


def less(rows: Unlabelled, claimed: Array) -> Unlabelled:
    """Return the rows without the values that are `claimed` (K,), which become NaN."""
    return attrs.evolve(rows, values=np.where(claimed > OWN, np.nan, rows.values))
