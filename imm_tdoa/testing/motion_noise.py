"""Laws of motion models: what chance adds to a state (ALGORITHMS §2)."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.testing.compare import agree, show
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import ViolationError, law
from imm_tdoa.testing.motion_dynamics import flat, flow, turn
from imm_tdoa.testing.motion_structure import Motion
from imm_tdoa.testing.strategies import rotations, time_steps


def _noise(subject: Motion, dt: float, d: int) -> Array:
    return np.asarray(subject.model.process_noise(dt, d), dtype=float)


@law("noise covariance", "Q(dt) = Q(dt)' is positive semi-definite")
def noise_covariance(subject: Motion, draw: Draw) -> None:
    """A covariance is one."""
    d = subject.draw_dims(draw)
    Q = _noise(subject, draw("dt", time_steps()), d)
    semi_definite("Q(dt)", Q, subject.model.components(d))


def semi_definite(name: str, Q: Array, names: tuple[str, ...] = ()) -> None:
    """Raise `ViolationError` unless Q (n, n) is symmetric and positive semi-definite."""
    variance = np.diag(Q)
    if np.any(variance < 0.0):
        i = int(np.argmin(variance))
        raise ViolationError(
            f"{name} has the negative variance {show(variance[i])} at {_of(names, i)}"
        )
    scale = np.sqrt(np.outer(variance, variance))
    agree(name, Q, f"{name}'", Q.T, scale=scale, names=names)
    unit = np.where(variance > 0.0, np.sqrt(variance), 1.0)
    least = np.linalg.eigvalsh(0.5 * (Q + Q.T) / np.outer(unit, unit))[0]
    if not least >= -1e-9 * len(Q):
        raise ViolationError(
            f"{name} is not positive semi-definite: its correlation matrix has the eigenvalue "
            f"{show(least)}"
        )


def _of(names: tuple[str, ...], i: int) -> str:
    return names[i] if len(names) > i else str(i)


@law("noise at once", "Q(0) = 0")
def noise_at_once(subject: Motion, draw: Draw) -> None:
    """Two measurements at one instant see the same state."""
    d = subject.draw_dims(draw)
    Q = _noise(subject, 0.0, d)
    agree("Q(0)", Q, "0", np.zeros_like(Q), names=subject.model.components(d))


@law("noise grows", "every variance in Q(a + b) is at least that in Q(a)")
def noise_grows(subject: Motion, draw: Draw) -> None:
    """Waiting longer never makes the state better known."""
    d = subject.draw_dims(draw)
    a, b = draw("a", time_steps()), draw("b", time_steps())
    early, late = np.diag(_noise(subject, a, d)), np.diag(_noise(subject, a + b, d))
    if np.any(late < (1.0 - 1e-9) * early):
        i = int(np.argmax(early - late))
        raise ViolationError(
            f"the variance of {subject.model.components(d)[i]} falls from {show(early[i])} in "
            f"Q(a) to {show(late[i])} in Q(a + b)"
        )


@law(
    "noise reaches position",
    "where velocity or acceleration is disturbed over dt > 0, so is the position of that axis",
)
def noise_reaches_position(subject: Motion, draw: Draw) -> None:
    """A disturbed velocity has moved the emitter by the end of the step."""
    d = subject.draw_dims(draw)
    variance = np.diag(_noise(subject, draw("dt", time_steps()), d))
    names = subject.model.components(d)
    for order in (1, 2):
        for axis, i in enumerate(subject.indices(d, order)):
            if variance[i] > 0.0 and not variance[axis] > 0.0:
                raise ViolationError(
                    f"Q(dt) gives {names[i]} the variance {show(variance[i])} and {names[axis]} "
                    f"{show(variance[axis])}"
                )


def _piecewise(subject: Motion) -> str:
    if getattr(subject.model, "composes", True):
        return ""
    return "the model says that its noise does not compose (composes = False)"


@law("noise composes", "Q(a + b) = F(b) Q(a) F(b)' + Q(b), F at rest", exempt=_piecewise)
def noise_composes(subject: Motion, draw: Draw) -> None:
    """Noise over one long step is that of two short ones, so that scans may come at any time.

    F is taken from `propagate` by differences, about the state 0.
    """
    model, d = subject.model, subject.draw_dims(draw)
    a, b = draw("a", time_steps()), draw("b", time_steps())
    F, _ = flow(subject, d, np.zeros(len(model.components(d))), b)
    first, second = _noise(subject, a, d), _noise(subject, b, d)
    deviation = np.sqrt(np.abs(np.diag(np.abs(F) @ np.abs(first) @ np.abs(F).T + np.abs(second))))
    agree(
        "Q(a + b)",
        _noise(subject, a + b, d),
        "F(b) Q(a) F(b)' + Q(b)",
        F @ first @ F.T + second,
        scale=np.outer(deviation, deviation),
        tolerance=1e-7,
        names=model.components(d),
    )


@law("isotropy", "Q(dt) = T Q(dt) T', T a turn of all vectors", exempt=flat)
def isotropy(subject: Motion, draw: Draw) -> None:
    """Chance prefers no horizontal direction."""
    model, d = subject.model, subject.draw_dims(draw, least=2)
    Q = _noise(subject, draw("dt", time_steps()), d)
    T = turn(model.components(d), draw("rotation", rotations(d)))
    deviation = np.sqrt(np.abs(T) @ np.abs(np.diag(Q)))
    scale = np.outer(deviation, deviation)
    agree("Q(dt)", Q, "T Q(dt) T'", T @ Q @ T.T, scale=scale, names=model.components(d))
