"""Laws of measurement models: moved, turned or magnified with its stations, nothing changes."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.stations import Stations
from imm_tdoa.testing.compare import agree
from imm_tdoa.testing.examine import Draw
from imm_tdoa.testing.laws import law
from imm_tdoa.testing.measurement_structure import Measured
from imm_tdoa.testing.strategies import Kinematics, numbers, rotations, vectors


class Move:
    """The map p -> factor * rotation p + shift, of emitters, stations and models.

    Parameters
    ----------
    rotation : (d, d)
    shift : (d,)
        m.
    factor : float
        Magnification of all lengths; a model's signal speed goes with it.
    """

    def __init__(self, rotation: Array, shift: Array, factor: float = 1.0) -> None:
        self.T = factor * rotation
        self.shift = shift
        self.factor = factor
        self._moved: dict[int, Stations] = {}  # models that share stations go on sharing them

    def emitter(self, k: Kinematics) -> Kinematics:
        """Return the moved emitter."""
        return Kinematics(self.T @ k.position + self.shift, self.T @ k.velocity, k.time)

    def stations(self, stations: Stations) -> Stations:
        """Return the moved stations, their velocities and covariances."""
        if id(stations) not in self._moved:
            fields: dict[str, Any] = {"positions": stations.positions @ self.T.T + self.shift}
            if stations.velocities is not None:
                fields["velocities"] = stations.velocities @ self.T.T
            for name in ("position_covariance", "velocity_covariance"):
                value = getattr(stations, name)
                if value is not None:
                    fields[name] = self.T @ value @ self.T.T
            self._moved[id(stations)] = attrs.evolve(stations, **fields)
        return self._moved[id(stations)]

    def model(self, model: Any) -> Any:
        """Return the model with moved stations."""
        if hasattr(model, "models"):
            return type(model)(*(self.model(member) for member in model.models))
        fields: dict[str, Any] = {"stations": self.stations(model.stations)}
        if self.factor != 1.0:
            fields["speed"] = self.factor * model.speed
        return attrs.evolve(model, **fields)


def _lacks(model: Any, *fields: str) -> str:
    """Return why a model cannot be moved: it or a member is no attrs class with these fields."""
    members = getattr(model, "models", None)
    if members is not None:
        return next((reason for m in members if (reason := _lacks(m, *fields))), "")
    own = {f.name for f in attrs.fields(type(model))} if attrs.has(type(model)) else set()
    if set(fields) <= own and isinstance(model.stations, Stations):
        return ""
    return f"{type(model).__name__} is no attrs class with the fields {', '.join(fields)}"


def _immovable(subject: Measured) -> str:
    return _lacks(subject.model, "stations")


def _unturnable(subject: Measured) -> str:
    if subject.model.dims == 1:
        return "one dimension has no directions"
    if np.any(subject.model.angular):
        return "rows are angles, which may turn with the frame"
    return _immovable(subject)


def _unscalable(subject: Measured) -> str:
    return _lacks(subject.model, "stations", "speed")


def _compare(subject: Measured, k: Kinematics, move: Move, rows: float, what: str) -> None:
    """Raise unless the moved model sees the moved emitter as the model does, times `rows`."""
    model, moved, there = subject.model, move.model(subject.model), move.emitter(k)
    h, H, R = model.predict(*k), model.jacobian(*k), subject.noise(k)
    far = float(np.max(np.abs(there.position))) + float(np.max(np.abs(k.position)))
    round_off = 1e-14 * far * max(1.0, float(np.max(np.abs(H[0]))))
    agree(
        f"predict {what}",
        moved.predict(*there),
        f"{rows:.6g} predict" if rows != 1.0 else "predict before",
        rows * np.asarray(h),
        scale=rows * np.max(np.abs(h)),
        slack=100.0 * round_off,
    )
    turned = (part @ move.T.T / move.factor**2 * rows for part in H)
    for name, after, before in zip(
        ("position", "velocity"), moved.jacobian(*there), turned, strict=True
    ):
        size = np.max(np.abs(before))
        before_name = f"d rows / d {name} before, turned"
        agree(f"d rows / d {name} {what}", after, before_name, before, scale=size, tolerance=1e-7)
    agree(
        f"R {what}",
        np.asarray(moved.noise_covariance(*there), dtype=float),
        f"{rows**2:.6g} R" if rows != 1.0 else "R before",
        rows**2 * R,
        scale=rows**2 * np.max(np.abs(R)),
        tolerance=1e-7,
    )


@law(
    "translation",
    "predict, its Jacobians and R are the same after a shift of emitter and stations",
    exempt=_immovable,
)
def translation(subject: Measured, draw: Draw) -> None:
    """No place is special."""
    k, d = subject.draw_place(draw), subject.model.dims
    move = Move(np.eye(d), draw("shift", vectors([1e4] * d)))
    _compare(subject, k, move, 1.0, "after the shift")


@law(
    "rotation",
    "predict and R are the same, and Jacobians turn, after a turn of emitter and stations about "
    "the vertical",
    exempt=_unturnable,
)
def rotation(subject: Measured, draw: Draw) -> None:
    """No horizontal direction is special."""
    k, d = subject.draw_place(draw), subject.model.dims
    move = Move(draw("rotation", rotations(d)), np.zeros(d))
    _compare(subject, k, move, 1.0, "after the turn")


@law(
    "units",
    "all lengths and the signal speed times c: predict and scale times c, R times c², so that "
    "values in seconds stay",
    exempt=_unscalable,
)
def units(subject: Measured, draw: Draw) -> None:
    """Metres or kilometres, it is the same measurement."""
    k, d = subject.draw_place(draw), subject.model.dims
    c = draw("c", numbers(1e-3, 1e3))
    move = Move(np.eye(d), np.zeros(d), c)
    agree(
        "scale of the magnified model",
        move.model(subject.model).scale,
        "c scale",
        c * np.asarray(subject.model.scale),
    )
    _compare(subject, k, move, c, "of the magnified model")
