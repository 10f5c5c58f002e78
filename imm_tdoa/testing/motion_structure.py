"""Laws of motion models: what they offer, what shapes it has, what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
from hypothesis import strategies as st

from imm_tdoa.contract import AXES, PREFIX, Array
from imm_tdoa.testing.compare import agree, finite
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import ViolationError, law
from imm_tdoa.testing.strategies import states, time_steps

METHODS = ("components", "propagate", "jacobian", "process_noise")


@attrs.frozen(eq=False)
class Motion:
    """A motion model and the space dimensions it is tried in.

    Attributes
    ----------
    model : MotionModel
        The model.
    asked : tuple of int
        Dimensions to try.
    dims : tuple of int
        Those of them that the model does not refuse.
    """

    model: Any
    asked: tuple[int, ...]
    dims: tuple[int, ...] = ()

    def draw_dims(self, draw: Draw, least: int = 1) -> int:
        """Draw a number of space dimensions, at least `least`."""
        return draw("dims", st.sampled_from([d for d in self.dims if d >= least]))

    def draw_state(self, draw: Draw, label: str, dims: int) -> Array:
        """Draw a state (n,)."""
        return draw(label, states(self.model.components(dims)))

    def indices(self, dims: int, order: int) -> list[int]:
        """Return where the state keeps position (order 0), velocity, acceleration; [] if not."""
        names = list(self.model.components(dims))
        if order == 0:
            return list(range(dims))
        wanted = [PREFIX[order] + axis for axis in AXES[:dims]]
        return [names.index(w) for w in wanted] if set(wanted) <= set(names) else []


def motion(model: Any, asked: tuple[int, ...]) -> Motion:
    """Return the model with those of the dimensions asked that it takes."""

    def takes(d: int) -> bool:
        try:
            return len(model.components(d)) >= d
        except Exception:
            return False  # the law "components" tells why

    return Motion(model, asked, tuple(d for d in asked if takes(d)))


@law("interface", "a motion model offers " + ", ".join(f"{m}()" for m in METHODS), gate=True)
def interface(subject: Motion, draw: Draw) -> None:
    """Every method of the contract is there."""
    lacking = [m for m in METHODS if not callable(getattr(subject.model, m, None))]
    if lacking:
        raise ViolationError(f"{type(subject.model).__name__} has no {', '.join(lacking)}")


@law(
    "components",
    "positions x, y, z come first and in order, no name repeats, velocities and accelerations "
    "are all there or none; ValueError for dimensions the model does not take",
)
def components(subject: Motion, draw: Draw) -> None:
    """Names are what banks and measurement models look for."""
    taken = 0
    for d in subject.asked:
        try:
            names = subject.model.components(d)
        except ValueError:
            continue
        taken += 1
        if isinstance(names, str) or not all(isinstance(n, str) for n in names):
            raise ViolationError(f"components({d}) is {names!r}, expected a tuple of strings")
        names = tuple(names)
        if names[:d] != AXES[:d]:
            raise ViolationError(f"components({d}) is {names}, expected {AXES[:d]} first")
        if len(set(names)) != len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise ViolationError(f"components({d}) is {names}: {twice!r} appears twice")
        for order in (1, 2):
            vector = [PREFIX[order] + axis for axis in AXES]
            there = [n for n in vector if n in names]
            if there and there != vector[:d]:
                raise ViolationError(
                    f"components({d}) is {names}, expected all of {vector[:d]} or none"
                )
    if not taken:
        raise ViolationError(
            f"components refuses all of dims = {', '.join(map(str, subject.asked))}"
        )


@law(
    "shapes",
    "with n = len(components(dims)): propagate(x, dt) is (n,), jacobian(x, dt) and "
    "process_noise(dt, dims) are (n, n), all finite",
    gate=True,
)
def shapes(subject: Motion, draw: Draw) -> None:
    """Shapes without batch axes."""
    if not subject.dims:
        raise ViolationError(f"there are no components for any of dims = {subject.asked}")
    model, d = subject.model, subject.draw_dims(draw)
    n = len(model.components(d))
    x, dt = subject.draw_state(draw, "x", d), draw("dt", time_steps())
    finite("propagate(x, dt)", model.propagate(x, dt), (n,))
    finite("jacobian(x, dt)", model.jacobian(x, dt), (n, n))
    finite("process_noise(dt, dims)", model.process_noise(dt, d), (n, n))
    if hasattr(model, "transition"):
        finite("transition(dt, dims)", model.transition(dt, d), (n, n))


@law("batch", "a batch of states and time steps gives for each what each gives alone")
def batch(subject: Motion, draw: Draw) -> None:
    """States (2, 1, n) and time steps (3,) broadcast to (2, 3)."""
    model, d = subject.model, subject.draw_dims(draw)
    n = len(model.components(d))
    x = np.stack([subject.draw_state(draw, f"x{i}", d) for i in range(2)])
    steps = [0.0, *(draw(f"dt{i}", time_steps()) for i in range(2))]
    dt = np.array(steps)
    singles = {
        "propagate": [[model.propagate(a, t) for t in steps] for a in x],
        "jacobian": [[model.jacobian(a, t) for t in steps] for a in x],
    }
    together = {
        "propagate": np.asarray(model.propagate(x[:, None], dt)),
        "jacobian": _spread(model.jacobian(x[:, None], dt), (2, 3, n, n)),
    }
    for name, single in singles.items():
        alone = np.array(single)
        scale = np.max(np.abs(alone), axis=-1, keepdims=True)
        agree(f"{name} of a batch", together[name], f"{name} one by one", alone, scale=scale)
    noise = np.array([model.process_noise(t, d) for t in steps])
    agree("process_noise of a batch", model.process_noise(dt, d), "process_noise one by one", noise)
    agree("dt afterwards", dt, "dt before", steps, tolerance=0.0)


def _spread(value: Any, shape: tuple[int, ...]) -> Array:
    """Broadcast a result that is the same over part of the batch."""
    array = np.asarray(value, dtype=float)
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ViolationError(
            f"jacobian of a batch has shape {array.shape}, expected {shape}"
        ) from None


@law("pure", "the same arguments give the same, and are left as they were")
def pure(subject: Motion, draw: Draw) -> None:
    """No hidden state, no work in place."""
    model, d = subject.model, subject.draw_dims(draw)
    x, dt = subject.draw_state(draw, "x", d), draw("dt", time_steps())
    before = x.copy()
    calls: dict[str, Callable[[], Any]] = {
        "propagate": lambda: model.propagate(x, dt),
        "jacobian": lambda: model.jacobian(x, dt),
        "process_noise": lambda: model.process_noise(dt, d),
    }
    for name, call in calls.items():
        first = np.array(call(), dtype=float)
        agree(f"the second {name}", call(), "the first", first, tolerance=0.0)
        agree(f"x after {name}", x, "x before", before, tolerance=0.0)


@law("refusal", "a negative or NaN time step, and dims = 0 or 4, raise ValueError")
def refusal(subject: Motion, draw: Draw) -> None:
    """Nonsense does not pass silently."""
    model, d = subject.model, subject.draw_dims(draw)
    x = np.ones(len(model.components(d)))
    timed: list[tuple[Callable[..., Any], str, tuple[Any, ...]]] = [
        (model.propagate, "propagate(x, {})", (x,)),
        (model.jacobian, "jacobian(x, {})", (x,)),
        (lambda dt: model.process_noise(dt, d), "process_noise({}, dims)", ()),
    ]
    sized: list[tuple[Callable[..., Any], str, tuple[Any, ...]]] = [
        (model.components, "components({})", ()),
        (model.process_noise, "process_noise(1.0, {})", (1.0,)),
    ]
    if hasattr(model, "transition"):
        timed.append((lambda dt: model.transition(dt, d), "transition({}, dims)", ()))
        sized.append((model.transition, "transition(1.0, {})", (1.0,)))
    for method, text, arguments in timed:
        for dt in (-1.0, float("nan"), np.array([1.0, -1.0])):
            refuses(text.format(dt), method, *arguments, dt)
    for method, text, arguments in sized:
        for dims in (0, 4):
            refuses(text.format(dims), method, *arguments, dims)


def refuses(what: str, call: Callable[..., Any], *arguments: Any) -> None:
    """Raise `ViolationError` unless ``call(*arguments)`` raises a ValueError."""
    try:
        result = call(*arguments)
    except ValueError:
        return
    except Exception as error:
        raise ViolationError(
            f"{what} raises {type(error).__name__} ({error}), expected ValueError"
        ) from error
    text = repr(result)
    raise ViolationError(f"{what} raises nothing and returns {text if len(text) < 80 else '...'}")
