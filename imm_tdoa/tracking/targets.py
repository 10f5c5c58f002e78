"""From the states of several targets to predicted rows, and from weighed rows back to states.

A target is predicted to the time of the scan by a step without measurement,
``imm.step(state, time, np.full(m, np.nan))``. Rows that an associator decided on are then taken
in by a step of no length, ``imm.step(state, time, association.values / measurement.scale)``,
during which no mode switches; rows that it weighed by `take_in`.
"""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa import gaussian, mixture, observation
from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.state import State
from imm_tdoa.tracking.jpda import soft_update
from imm_tdoa.tracking.rows import Association, Prediction


def predict_rows(
    measurement: MeasurementModel, state: State, heard: Mask | None = None
) -> Prediction:
    """Return how each of N targets is expected to be measured at its state's time.

    Parameters
    ----------
    measurement : MeasurementModel
        What is measured. None of its rows may follow from others (as all pairs of stations do).
    state : State
        Predicted states of N targets, a batch with one axis.
    heard : (m,) bool, optional
        Rows that the scan has any values of; the others are not predicted (their noise need not
        be known).

    Raises
    ------
    ValueError
        A state of another batch shape, or rows that share an unknown offset (arrival times):
        what one emitter's rows predict of another's is then known only of their differences.
    """
    rows, H, R = _seen(measurement, state)
    if heard is not None:
        rows = [np.where(heard, row, np.nan) for row in rows]
    S = [
        h @ P @ np.swapaxes(h, -1, -2) + r for h, P, r in zip(H, state.covariances, R, strict=True)
    ]
    return Prediction(
        np.stack(rows, axis=1),
        np.stack(S, axis=1),
        log_weight=state.log_mode_probability,
        angular=measurement.angular,
    )


def take_in(measurement: MeasurementModel, state: State, association: Association) -> State:
    """Return the states after an associator that weighs instead of deciding.

    Every mode is updated with what its rows are believed to have been (`soft_update`), and
    weighed by the scan's likelihood ratio under it. The state's log-likelihood grows by the log
    of how much likelier the scan is with the target than without it; `taken` and `trust` stay.

    Parameters
    ----------
    measurement : MeasurementModel
        What was measured.
    state : State
        The predicted states that `association` was made from.
    association : Association
        What `Jpda` returned.

    Raises
    ------
    ValueError
        An association that was decided: `IMM.step` takes that in.
    """
    nu, covariance, log_ratio = (
        association.innovation,
        association.covariance,
        association.log_likelihood_ratio,
    )
    if nu is None or covariance is None or log_ratio is None:
        raise ValueError("association: it was decided; give its values to IMM.step")
    rows, H, R = _seen(measurement, state)
    known: Mask = np.asarray(np.isfinite(np.stack(rows, axis=1)).all(axis=1))
    means, covariances = [], []
    for j, (x, P) in enumerate(zip(state.means, state.covariances, strict=True)):
        nu_j, H_j, R_j = gaussian.mask_rows(nu[:, j], H[j], R[j], known)
        x, P = soft_update(x, P, H_j, R_j, nu_j, covariance[:, j])
        means.append(x)
        covariances.append(P)
    log_p, log_total = mixture.normalise(state.log_mode_probability + log_ratio)
    return attrs.evolve(
        state,
        means=tuple(means),
        covariances=tuple(covariances),
        log_mode_probability=log_p,
        log_likelihood=state.log_likelihood + log_total,
    )


def _seen(
    measurement: MeasurementModel, state: State
) -> tuple[list[Array], tuple[Array, ...], tuple[Array, ...]]:
    """Predicted rows (N, m), Jacobians and noise covariances of each mode."""
    batch = state.log_likelihood.shape
    if len(batch) != 1:
        raise ValueError(f"state: expected a batch of N targets, got batch shape {batch}")
    if np.any(measurement.offset_group >= 0):
        raise ValueError(
            "measurement: its rows share an unknown offset; associate differences instead"
        )
    nothing = np.zeros((*batch, measurement.size))
    space = state.space
    seen = observation.observe(
        measurement, state.means, space.position, space.velocity, state.time, nothing
    )
    return [-nu for nu in seen.nu], seen.H, seen.R
