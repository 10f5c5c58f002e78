"""Laws of measurement models: what they offer, what shapes it has, what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
from hypothesis import strategies as st

from imm_tdoa.contract import Array, Mask
from imm_tdoa.testing.compare import agree, finite, show
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import ViolationError, law
from imm_tdoa.testing.motion_structure import refuses
from imm_tdoa.testing.strategies import Kinematics, present_rows

METHODS = (
    "predict",
    "jacobian",
    "noise_covariance",
    "error_sources",
    "independent",
    "anchors",
    "with_pairs",
)
PROPERTIES = ("dims", "size", "scale", "angular", "offset_group")


@attrs.frozen(eq=False)
class Measured:
    """A measurement model and where it is tried.

    Attributes
    ----------
    model : MeasurementModel
        The model.
    places : strategy of Kinematics
        Emitters it can measure.
    bad_arguments : tuple of callables
        Calls that must raise ValueError.
    """

    model: Any
    places: st.SearchStrategy[Kinematics]
    bad_arguments: tuple[Callable[[], Any], ...] = ()

    def draw_place(self, draw: Draw, label: str = "emitter") -> Kinematics:
        """Draw an emitter."""
        return draw(label, self.places)

    def noise(self, k: Kinematics) -> Array:
        """Return R (m, m)."""
        return np.asarray(self.model.noise_covariance(*k), dtype=float)


@law(
    "interface",
    f"a measurement model offers {', '.join(PROPERTIES)}, {', '.join(f'{m}()' for m in METHODS)}",
    gate=True,
)
def interface(subject: Measured, draw: Draw) -> None:
    """Everything of the contract is there."""
    lacking = [m for m in METHODS if not callable(getattr(subject.model, m, None))]
    for name in PROPERTIES:
        try:
            getattr(subject.model, name)
        except (AttributeError, NotImplementedError):
            lacking.append(name)
    if lacking:
        raise ViolationError(f"{type(subject.model).__name__} has no {', '.join(lacking)}")


@law(
    "shapes",
    "with m = size, d = dims: scale (m,) is positive, angular (m,) bool, offset_group (m,) int "
    "from -1; predict is (m,), both Jacobians (m, d), noise_covariance (m, m), all finite; "
    "independent(present) is (m,) bool, anchors (k, d)",
    gate=True,
)
def shapes(subject: Measured, draw: Draw) -> None:
    """Shapes without batch axes."""
    model = subject.model
    m, d = model.size, model.dims
    if not isinstance(m, int | np.integer) or m < 1 or d not in (1, 2, 3):
        raise ViolationError(f"size is {m!r} and dims {d!r}, expected rows and dims 1 to 3")
    m, d = int(m), int(d)
    if np.any(finite("scale", model.scale, (m,)) <= 0.0):
        raise ViolationError(f"scale is {show(np.asarray(model.scale))}, expected positive factors")
    _kind("angular", model.angular, (m,), "b")
    if np.any(_kind("offset_group", model.offset_group, (m,), "iu") < -1):
        raise ViolationError(f"offset_group is {show(model.offset_group)}, expected -1 or a group")
    k = subject.draw_place(draw)
    finite("predict", model.predict(*k), (m,))
    Hp, Hv = model.jacobian(*k)
    finite("d rows / d position", Hp, (m, d))
    finite("d rows / d velocity", Hv, (m, d))
    finite("noise_covariance", model.noise_covariance(*k), (m, m))
    present = draw("present", present_rows(m))
    _kind("independent(present)", model.independent(present), (m,), "b")
    anchors = np.asarray(model.anchors(k.time, present))
    if anchors.ndim != 2 or anchors.shape[-1] != d:
        raise ViolationError(f"anchors has shape {anchors.shape}, expected (k, {d})")


def _kind(name: str, value: Any, shape: tuple[int, ...], kinds: str) -> Any:
    array = np.asarray(value)
    if array.shape != shape or array.dtype.kind not in kinds:
        what = "bool" if kinds == "b" else "int"
        raise ViolationError(f"{name} is {array.dtype} {array.shape}, expected {what} {shape}")
    return array


@law("batch", "a batch of emitters and times gives for each what each gives alone")
def batch(subject: Measured, draw: Draw) -> None:
    """Positions and velocities (2, d) at times (2,)."""
    model = subject.model
    m, d = model.size, model.dims
    ks = [subject.draw_place(draw, f"emitter {i}") for i in range(2)]
    p, v = np.stack([k.position for k in ks]), np.stack([k.velocity for k in ks])
    time = np.array([k.time for k in ks])
    rows = np.array([model.predict(*k) for k in ks])
    scale = np.max(np.abs(rows))
    agree("predict of a batch", model.predict(p, v, time), "predict one by one", rows, scale=scale)
    singles = [model.jacobian(*k) for k in ks]
    for i, name in enumerate(("position", "velocity")):
        one = np.array([single[i] for single in singles])
        many = _spread(f"d rows / d {name}", model.jacobian(p, v, time)[i], (2, m, d))
        agree(f"d rows / d {name} of a batch", many, "one by one", one, scale=np.max(np.abs(one)))
    R = np.array([subject.noise(k) for k in ks])
    many = _spread("noise_covariance", model.noise_covariance(p, v, time), (2, m, m))
    agree("noise_covariance of a batch", many, "one by one", R, scale=np.max(np.abs(R)))
    present = np.stack([draw(f"present {i}", present_rows(m)) for i in range(2)])
    kept = np.array([model.independent(mask) for mask in present])
    agree("independent of a batch", model.independent(present), "one by one", kept)


def _spread(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Broadcast a result that is the same over the batch."""
    array = np.asarray(value, dtype=float)
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ViolationError(
            f"{name} of a batch has shape {array.shape}, expected {shape}"
        ) from None


@law("pure", "the same arguments give the same, and are left as they were")
def pure(subject: Measured, draw: Draw) -> None:
    """No hidden state, no work in place."""
    model, k = subject.model, subject.draw_place(draw)
    p, v = k.position.copy(), k.velocity.copy()
    calls: dict[str, Callable[[], Any]] = {
        "predict": lambda: model.predict(p, v, k.time),
        "d rows / d position": lambda: model.jacobian(p, v, k.time)[0],
        "d rows / d velocity": lambda: model.jacobian(p, v, k.time)[1],
        "noise_covariance": lambda: model.noise_covariance(p, v, k.time),
    }
    for name, call in calls.items():
        first = np.array(call(), dtype=float)
        agree(f"the second {name}", call(), "the first", first, tolerance=0.0)
        agree(f"position after {name}", p, "position before", k.position, tolerance=0.0)
        agree(f"velocity after {name}", v, "velocity before", k.velocity, tolerance=0.0)


def _one_list_of_pairs(subject: Measured) -> str:
    ndim = np.ndim(getattr(subject.model, "pairs", ()))
    return "" if ndim <= 2 else "the model's pairs have a batch axis of their own"


@law(
    "pairs",
    "with_pairs(pairs) measures the rows of these pairs, in their order, for a batch of pairs "
    "too; it raises ValueError for a station that does not exist, or where rows are no pairs",
    exempt=_one_list_of_pairs,
)
def pairs(subject: Measured, draw: Draw) -> None:
    """Recordings name the pair of every row, scan by scan."""
    model = subject.model
    if not hasattr(model, "pairs"):
        if not hasattr(model, "models"):
            refuses("with_pairs([[1, 0]])", model.with_pairs, np.array([[1, 0]]))
        return
    k = subject.draw_place(draw)
    own = np.asarray(model.pairs)
    order = np.array(draw("order", st.permutations(range(len(own)))))
    backward = own[order][:, ::-1]
    rows = np.asarray(model.predict(*k))
    other = model.with_pairs(backward)
    agree("predict of swapped pairs", other.predict(*k), "- predict", -rows[order])
    many = model.with_pairs(np.stack([own, backward]))
    alone = np.stack([rows, -rows[order]])
    agree("predict of a batch of pairs", many.predict(*k), "predict one by one", alone)
    R = np.stack([model.with_pairs(p).noise_covariance(*k) for p in (own, backward)])
    together = _spread("noise_covariance", many.noise_covariance(*k), R.shape)
    agree("noise_covariance of a batch of pairs", together, "one by one", R, scale=np.max(R))
    beyond = own.copy()
    beyond[0, 0] = 1 + max(int(own.max()), len(model.stations) if hasattr(model, "stations") else 0)
    refuses(f"with_pairs of station {beyond[0, 0]}", model.with_pairs, beyond)


def _none_given(subject: Measured) -> str:
    return "" if subject.bad_arguments else "no bad_arguments were given"


@law("refusal", "each call in bad_arguments raises ValueError", exempt=_none_given)
def refusal(subject: Measured, draw: Draw) -> None:
    """Nonsense does not pass silently."""
    for i, call in enumerate(subject.bad_arguments):
        refuses(f"bad_arguments[{i}]", call)


def rows_of(present: Mask) -> Any:
    """Return the indices of the present rows."""
    return np.flatnonzero(present)
