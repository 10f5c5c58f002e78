"""The gate of messages where the prediction is so vague that the measurement bends over it.

Linearised at the prediction, ranges to a place 8 km off are wrong by more than their noise, and
a gate refuses the right message. Iterating moves the linearisation to where the message puts the
target: what is left of the innovation there, by the covariance there, is how far prediction and
message contradict each other, the message's residual and the prior's mismatch together. Where
the measurement is straight over the prediction that is the usual innovation.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import product

import attrs
import numpy as np

from imm_tdoa import gaussian, observation
from imm_tdoa.contract import AXES, Array, Mask, MeasurementModel
from imm_tdoa.observation import Observation
from imm_tdoa.state import State
from imm_tdoa.tracking.gates import threshold

BETWEEN = 0.2  # of the width that rows were found to have: what lies between points looked at
SETTLED = 0.5  # posterior standard deviations by which one more round of the iteration may move


def possible(
    measurement: MeasurementModel, state: State, values: Array, gate_probability: float
) -> Mask:
    """Which of the pairs (P,) of target and message may pass the gate, generously and cheaply.

    Row by row: if the target is anywhere within the gate, the message's rows are among those that
    are predicted there, but for their noise. Rows that depend on the velocity say nothing here.

    Parameters
    ----------
    measurement : MeasurementModel
        What was measured.
    state : State
        The targets of the pairs (P,), predicted.
    values : (P, m)
        Their messages, in the measurement's units.
    gate_probability : float
        Probability that a target's own message passes its gate.
    """
    z = values * measurement.scale
    rows = observation.usable_rows(z)
    z, present = z[..., rows], measurement.independent(np.isfinite(z))[..., rows]
    T, left = gaussian.offset_contrast(np.ones(z.shape), present, measurement.offset_group[rows])
    dof = np.count_nonzero(left, axis=-1)
    limit = np.maximum(threshold(gate_probability, dof), 0.0)
    place, speed, reach = _kinematics(state)
    there = place[:, None] + np.sqrt(limit)[:, None, None] * (_star(measurement.dims) @ reach)
    h = measurement.predict(
        there,
        np.broadcast_to(speed[:, None], there.shape),
        np.broadcast_to(state.time[:, None], there.shape[:-1]),
    )[..., rows]
    R = measurement.noise_covariance(place, speed, state.time)[..., rows[:, None], rows]
    both = present[..., :, None] & present[..., None, :]
    R = np.broadcast_to(R, both.shape)
    noise = np.einsum("pij,pjk,pik->pi", T, np.where(both, R, 0.0), T)
    seen = np.einsum("pij,pj->pi", T, np.where(present, z, 0.0))
    foreseen = np.einsum("pij,pkj->pki", T, np.where(present[:, None], h, 0.0))
    low, high = foreseen.min(axis=1), foreseen.max(axis=1)
    margin = BETWEEN * (high - low) + np.sqrt(limit[:, None] * noise)
    near = (seen >= low - margin) & (seen <= high + margin)
    moves = measurement.jacobian(place, speed, state.time)[1][..., rows, :].any(axis=(0, -1))
    near |= ~left | measurement.angular[rows] | moves | ~np.isfinite(margin)  # a station unheard
    result: Mask = near.all(axis=-1) & (dof > 0)
    return result


def _kinematics(state: State) -> tuple[Array, Array, Array]:
    """Position and velocity (P, d), and the axes (P, d, d) of the position's spread, as rows."""
    names, d = state.components, state.space.dims
    i = np.array([names.index(a) for a in AXES[:d]])
    place, speed = state.mean[:, i], np.zeros((len(state.mean), d))
    if all(f"v{a}" in names for a in AXES[:d]):
        speed = state.mean[:, [names.index(f"v{a}") for a in AXES[:d]]]
    w, V = np.linalg.eigh(state.covariance[:, i[:, None], i])
    return place, speed, np.swapaxes(V * np.sqrt(np.maximum(w, 0.0))[:, None, :], -1, -2)


@cache
def _star(d: int) -> Array:
    """Points (K, d) all over the unit ball."""
    corners = np.array([c for c in product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=d) if any(c)])
    size = np.linalg.norm(corners, axis=-1, keepdims=True)
    arms = np.unique(np.round(corners / size, 12), axis=0)
    return np.concatenate([np.zeros((1, d)), *(r * arms for r in (1.0 / 3.0, 2.0 / 3.0, 1.0))])


def arrived(measurement: MeasurementModel, before: State, after: State, values: Array) -> State:
    """States of targets (P,) that took in messages, their innovation linearised at these states.

    Where the iteration has not settled it stays linearised at the prediction.

    Parameters
    ----------
    measurement : MeasurementModel
        What was measured.
    before, after : State
        The targets (P,) before and after they took in the messages.
    values : (P, m)
        The messages, in the measurement's units.
    """
    free = _relinearised(measurement, before, after.means, values)
    again = [
        gaussian.update(x, P, nu, H, R, free.present)
        for x, P, nu, H, R in zip(
            before.means, before.covariances, free.nu, free.H, free.R, strict=True
        )
    ]
    moved = np.max([_moved(u, x) for u, x in zip(again, after.means, strict=True)], axis=0)
    nis = np.where(moved <= SETTLED, _nis(free, before), after.taken.nis)
    return attrs.evolve(after, taken=attrs.evolve(after.taken, nis=nis))


def _relinearised(
    measurement: MeasurementModel, before: State, there: Sequence[Array], values: Array
) -> Observation:
    """Innovations of the prediction by the line through `there`, offsets eliminated."""
    space = before.space
    seen = observation.observe(
        measurement, there, space.position, space.velocity, before.time, values
    )
    nu = tuple(
        n - np.einsum("...ij,...j->...i", H, x - a)
        for n, H, x, a in zip(seen.nu, seen.H, before.means, there, strict=True)
    )
    return observation.without_offsets(attrs.evolve(seen, nu=nu))


def _moved(update: gaussian.Update, there: Array) -> Array:
    """How far (P,) an update lies from where it was linearised, in its own deviations."""
    variance = np.einsum("...ii->...i", update.P)
    spread = np.sqrt(np.where(variance > 0.0, variance, np.inf))
    result: Array = np.max(np.abs(update.x - there) / spread, axis=-1)
    return result


def _nis(free: Observation, state: State) -> Array:
    """Normalised innovation squared (P,) of the whole bank."""
    weight = np.exp(state.log_mode_probability)
    nu, S = observation.mixture_innovation(free, weight, state.covariances)
    white = np.linalg.solve(gaussian.innovation_factor(S), nu[..., None])[..., 0]
    result: Array = np.sum(white**2, axis=-1)
    return result
