"""Laws of measurement models: Jacobians, and noise that a filter can work with (§1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import Array
from imm_tdoa.gaussian import offset_contrast, wrap
from imm_tdoa.testing.compare import agree, show
from imm_tdoa.testing.derivative import derivative
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import ViolationError, law
from imm_tdoa.testing.measurement_structure import Measured, rows_of
from imm_tdoa.testing.motion_noise import semi_definite
from imm_tdoa.testing.strategies import EXTENT, Kinematics, present_rows, stations_of

VELOCITY_STEP = 1.0


@law("position jacobian", "jacobian()[0] = d predict / d position, by finite differences")
def position_jacobian(subject: Measured, draw: Draw) -> None:
    """Angular rows are differenced around the circle."""
    k = subject.draw_place(draw)
    step = 1e-4 * _clearance(subject, k)
    numeric = derivative(
        lambda p: np.asarray(subject.model.predict(p, k.velocity, k.time)),
        k.position,
        np.full(len(k.position), step),
        subtract=lambda a, b: _subtract(subject, a, b),
    )
    _agree_jacobian(subject, "position", subject.model.jacobian(*k)[0], *numeric)


@law("velocity jacobian", "jacobian()[1] = d predict / d velocity, by finite differences")
def velocity_jacobian(subject: Measured, draw: Draw) -> None:
    """Zero for what does not depend on velocity, whatever the motion model (§5.2-9)."""
    k = subject.draw_place(draw)
    numeric = derivative(
        lambda v: np.asarray(subject.model.predict(k.position, v, k.time)),
        k.velocity,
        np.full(len(k.velocity), VELOCITY_STEP),
        subtract=lambda a, b: _subtract(subject, a, b),
    )
    _agree_jacobian(subject, "velocity", subject.model.jacobian(*k)[1], *numeric)


def _agree_jacobian(subject: Measured, by: str, given: Array, numeric: Array, error: Array) -> None:
    size = np.max(np.maximum(np.abs(given), np.abs(numeric)), axis=-1, keepdims=True)
    agree(
        f"d rows / d {by}",
        given,
        "the difference quotient of predict",
        numeric,
        scale=size,
        tolerance=1e-6,
        slack=10.0 * error,
    )


def _clearance(subject: Measured, k: Kinematics) -> float:
    """Return the distance to the nearest station, m, over which predictions bend."""
    places = [s.at(k.time)[0] for s in stations_of(subject.model)]
    if not places:
        return EXTENT
    return float(np.min(np.linalg.norm(np.concatenate(places) - k.position, axis=-1)))


def _subtract(subject: Measured, a: Array, b: Array) -> Array:
    return np.where(subject.model.angular, wrap(a - b), a - b)


@law("noise covariance", "R = R' is positive semi-definite")
def noise_covariance(subject: Measured, draw: Draw) -> None:
    """A covariance is one."""
    R = subject.noise(subject.draw_place(draw))
    semi_definite("R", R)


@law(
    "error sources",
    "error_sources() = D (m, k), v (k,): v >= 0, every row has a source, and no row gets more "
    "variance from its sources than R gives it: sum_k D_ik^2 v_k <= R_ii",
)
def error_sources(subject: Measured, draw: Draw) -> None:
    """What a robust filter takes to be able to go wrong by itself."""
    k = subject.draw_place(draw)
    D, v = (np.asarray(a, dtype=float) for a in subject.model.error_sources(*k))
    m = int(subject.model.size)
    if D.ndim != 2 or D.shape[0] != m or v.shape != D.shape[1:]:
        raise ViolationError(f"D has shape {D.shape} and v {v.shape}, expected ({m}, k) and (k,)")
    if not (np.all(np.isfinite(D)) and np.all(np.isfinite(v)) and np.all(v >= 0.0)):
        raise ViolationError("D or v has entries that are negative variances or not finite")
    lacking = np.flatnonzero(~np.any(D != 0.0, axis=1))
    if len(lacking):
        raise ViolationError(f"row {lacking[0]} has no source of error")
    got, R = np.sum(D**2 * v, axis=1), np.diag(subject.noise(k))
    worst = int(np.argmax(got - R))
    if got[worst] > R[worst] * (1.0 + 1e-9):
        raise ViolationError(
            f"the sources give row {worst} the variance {show(got[worst])}, R {show(R[worst])}"
        )


@law(
    "noise definite",
    "R is positive definite over the rows that independent() keeps of any that arrive, less the "
    "reference row of each offset group",
)
def noise_definite(subject: Measured, draw: Draw) -> None:
    """What a filter factors must have a factor."""
    model = subject.model
    present = draw("present", present_rows(model.size))
    R = subject.noise(subject.draw_place(draw))
    kept = np.asarray(model.independent(present))
    T, left = offset_contrast(np.diag(R), kept, np.asarray(model.offset_group))
    rows = rows_of(left)
    S = (T @ np.where(kept[:, None] & kept, R, 0.0) @ T.T)[np.ix_(rows, rows)]
    if not len(rows):
        return
    variance = np.diag(S)
    if not np.all(variance > 0.0):
        i = int(np.argmin(variance))
        raise ViolationError(f"row {rows[i]} has the variance {show(variance[i])}")
    least = np.linalg.eigvalsh(S / np.sqrt(np.outer(variance, variance)))[0]
    if not least > 1e-12:
        raise ViolationError(
            f"R of rows {show(rows)} is singular: its correlation matrix has the eigenvalue "
            f"{show(least)}"
        )


@law(
    "independent rows",
    "independent(present) keeps rows that are present, and leaves out only what they repeat: "
    "h_left - C h_kept has neither gradient nor noise, C = R_left,kept R_kept^-1",
)
def independent_rows(subject: Measured, draw: Draw) -> None:
    """A row that closes a loop of differences is the sum of the others; nothing else may go."""
    model = subject.model
    present = draw("present", present_rows(model.size))
    k = subject.draw_place(draw)
    kept = np.asarray(model.independent(present))
    if np.any(kept & ~present):
        raise ViolationError(f"row {rows_of(kept & ~present)[0]} is kept, but did not arrive")
    a, b = rows_of(kept), rows_of(present & ~kept)
    if not len(b):
        return
    if not len(a):
        raise ViolationError(f"rows {show(b)} arrive and none is kept")
    R = subject.noise(k)
    H = np.concatenate(model.jacobian(*k), axis=-1)
    C = _solve(R[np.ix_(a, a)], R[np.ix_(a, b)]).T
    rest = R[np.ix_(b, b)] - C @ R[np.ix_(a, b)]
    scale = np.max(np.diag(R))
    agree("noise of the rows left out", rest, "0", 0.0 * rest, scale=scale, tolerance=1e-7)
    size = np.abs(H[b]) + np.abs(C) @ np.abs(H[a])
    agree("gradient of the rows left out", H[b], "C H_kept", C @ H[a], scale=size, tolerance=1e-7)


def _solve(A: Array, B: Array) -> NDArray[np.float64]:
    return np.asarray(np.linalg.lstsq(A, B, rcond=None)[0])
