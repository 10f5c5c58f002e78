"""Laws of motion models: how states move (ALGORITHMS §2, §14.3)."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import AXES, Array
from imm_tdoa.statespace import KIND_OF
from imm_tdoa.testing.compare import agree
from imm_tdoa.testing.derivative import derivative
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import law
from imm_tdoa.testing.motion_structure import Motion
from imm_tdoa.testing.strategies import rotations, time_steps, vectors

STEP = {"position": 1.0, "velocity": 0.1, "acceleration": 0.01}
SMALL_STEP = 1e-3


@law("identity", "propagate(x, 0) = x and jacobian(x, 0) = I")
def identity(subject: Motion, draw: Draw) -> None:
    """Nothing happens in no time."""
    d = subject.draw_dims(draw)
    x = subject.draw_state(draw, "x", d)
    names = subject.model.components(d)
    agree("propagate(x, 0)", subject.model.propagate(x, 0.0), "x", x, names=names)
    F = subject.model.jacobian(x, 0.0)
    agree("jacobian(x, 0)", F, "I", np.eye(len(x)), scale=1.0, names=names)


@law("semigroup", "propagate(propagate(x, a), b) = propagate(x, a + b), so F(a + b) = F(b) F(a)")
def semigroup(subject: Motion, draw: Draw) -> None:
    """Two steps on end are one long one."""
    model, d = subject.model, subject.draw_dims(draw)
    x = subject.draw_state(draw, "x", d)
    a, b = draw("a", time_steps()), draw("b", time_steps())
    middle = model.propagate(x, a)
    twice, once = model.propagate(middle, b), model.propagate(x, a + b)
    agree(
        "propagate(propagate(x, a), b)",
        twice,
        "propagate(x, a + b)",
        once,
        scale=magnitude(subject, d, a + b, x, middle, once),
        names=model.components(d),
    )


@law("kinematics", "d position / dt = velocity, and d velocity / dt = acceleration, at dt = 0")
def kinematics(subject: Motion, draw: Draw) -> None:
    """Components mean what their names say: a measurement model relies on it."""
    model, d = subject.model, subject.draw_dims(draw)
    x = subject.draw_state(draw, "x", d)
    rate, error = derivative(
        lambda t: np.asarray(model.propagate(x, float(t[0]))),
        np.zeros(1),
        np.array([1e-2]),
        one_sided=True,
    )
    for order, name in ((0, "position"), (1, "velocity")):
        here, above = subject.indices(d, order), subject.indices(d, order + 1)
        if not here or not above:
            continue
        agree(
            f"d {name} / dt",
            rate[here, 0],
            ("velocity", "acceleration")[order],
            x[above],
            scale=np.max(np.abs(x[above])),
            tolerance=1e-6,
            slack=10.0 * error[here, 0],
            names=AXES[:d],
        )


@law("jacobian", "jacobian(x, dt) = d propagate(x, dt) / dx, by finite differences")
def jacobian(subject: Motion, draw: Draw) -> None:
    """The extended Kalman filter's matrix belongs to the motion it predicts with."""
    model, d = subject.model, subject.draw_dims(draw)
    x, dt = subject.draw_state(draw, "x", d), draw("dt", time_steps())
    numeric, error = flow(subject, d, x, dt)
    agree(
        "jacobian(x, dt)",
        model.jacobian(x, dt),
        "the difference quotient of propagate",
        numeric,
        tolerance=1e-6,
        slack=10.0 * error,
        names=model.components(d),
    )


def flow(subject: Motion, d: int, x: Array, dt: float) -> tuple[Array, Array]:
    """Return d propagate / dx (n, n) by finite differences, and a bound on its error."""
    names = subject.model.components(d)
    step = np.array([STEP.get(KIND_OF.get(c, ""), SMALL_STEP) for c in names])
    return derivative(lambda y: np.asarray(subject.model.propagate(y, dt)), x, step)


def _no_transition(subject: Motion) -> str:
    return "" if hasattr(subject.model, "transition") else "the model has no transition matrix"


@law(
    "linear",
    "propagate(x, dt) = transition(dt, dims) x and jacobian(x, dt) = transition(dt, dims)",
    exempt=_no_transition,
)
def linear(subject: Motion, draw: Draw) -> None:
    """A transition matrix, where there is one, is what moves the state."""
    model, d = subject.model, subject.draw_dims(draw)
    x, dt = subject.draw_state(draw, "x", d), draw("dt", time_steps())
    F, names = np.asarray(model.transition(dt, d)), model.components(d)
    scale = np.abs(F) @ np.abs(x)
    agree("propagate(x, dt)", model.propagate(x, dt), "F x", F @ x, scale=scale, names=names)
    agree("jacobian(x, dt)", model.jacobian(x, dt), "transition(dt, dims)", F, names=names)


@law("translation", "propagate(x + shift, dt) = propagate(x, dt) + shift, for shifts of position")
def translation(subject: Motion, draw: Draw) -> None:
    """No place is special."""
    model, d = subject.model, subject.draw_dims(draw)
    x, dt = subject.draw_state(draw, "x", d), draw("dt", time_steps())
    shift = np.zeros(len(x))
    shift[:d] = draw("shift", vectors([1e4] * d))
    there, here = model.propagate(x + shift, dt), model.propagate(x, dt) + shift
    agree(
        "propagate(x + shift, dt)",
        there,
        "propagate(x, dt) + shift",
        here,
        scale=magnitude(subject, d, dt, x, shift, here),
        names=model.components(d),
    )


def flat(subject: Motion) -> str:
    """Tell models that are tried in one dimension only: there is nothing to turn."""
    return "" if max(subject.dims, default=0) >= 2 else "one dimension has no directions"


@law("rotation", "propagate(T x, dt) = T propagate(x, dt), T a turn of all vectors", exempt=flat)
def rotation(subject: Motion, draw: Draw) -> None:
    """No horizontal direction is special."""
    model, d = subject.model, subject.draw_dims(draw, least=2)
    x, dt = subject.draw_state(draw, "x", d), draw("dt", time_steps())
    T = turn(model.components(d), draw("rotation", rotations(d)))
    straight = model.propagate(x, dt)
    agree(
        "propagate(T x, dt)",
        model.propagate(T @ x, dt),
        "T propagate(x, dt)",
        T @ straight,
        scale=magnitude(subject, d, dt, x, straight),
        names=model.components(d),
    )


def turn(names: tuple[str, ...], rotation: Array) -> Array:
    """Return the matrix (n, n) that turns the horizontal part of every vector in a state.

    Two components whose names differ only in a last ``x`` and ``y`` are such a part.
    """
    T = np.eye(len(names))
    for i, name in enumerate(names):
        if name.endswith("x") and name[:-1] + "y" in names:
            j = names.index(name[:-1] + "y")
            T[np.ix_([i, j], [i, j])] = rotation[:2, :2]
    return T


def magnitude(subject: Motion, d: int, dt: float, *states: Array) -> Array:
    """Return how large (n,) the terms may be that add up to each component over `dt`."""
    size = np.max(np.abs(np.stack([np.asarray(s, dtype=float) for s in states])), axis=0)
    groups = [subject.indices(d, order) for order in range(3)]
    largest = [float(np.max(size[g], initial=0.0)) for g in groups]
    for order, group in enumerate(groups):
        size[group] = sum(largest[k] * dt ** (k - order) for k in range(order, 3))
    return np.asarray(size)
