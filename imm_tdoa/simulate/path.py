"""How an emitter moves: legs of different motion, joined in position and velocity."""

from __future__ import annotations

from typing import Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.simulate import _checks
from imm_tdoa.simulate._checks import Vector

MOTIONS = ("static", "constant-velocity", "constant-acceleration", "turn")

_TAKES = {
    "static": (),
    "constant-velocity": ("velocity_mps",),
    "constant-acceleration": ("velocity_mps", "acceleration_mps2", "end_velocity_mps"),
    "turn": ("velocity_mps", "turn_rate_dps"),
}
_ONE_NEEDED = {
    "constant-acceleration": ("acceleration_mps2", "end_velocity_mps"),
    "turn": ("turn_rate_dps",),
}


@attrs.frozen(kw_only=True)
class Leg:
    """A stretch of one motion.

    Parameters
    ----------
    motion : str
        ``"static"`` stands still from the first moment, whatever the velocity before;
        ``"constant-velocity"``; ``"constant-acceleration"``; ``"turn"`` turns the horizontal
        velocity at a constant rate and keeps the vertical one.
    duration_s : float
        How long it lasts, s.
    velocity_mps : (d,), optional
        Velocity at its start, m/s; without it the leg goes on with the velocity before.
    acceleration_mps2 : (d,)
        Acceleration of a ``"constant-acceleration"`` leg, m/s²; or give
    end_velocity_mps : (d,)
        the velocity, m/s, that the leg ends with: zeros are a stop.
    turn_rate_dps : float
        Turn rate of a ``"turn"``, degrees per second, positive counter-clockwise.
    acceleration_psd : float
        Density of white acceleration on top of the motion, m²/s³ per axis; 0 for none.
    """

    motion: str = attrs.field(validator=_checks.one_of(*MOTIONS))
    duration_s: float = attrs.field(validator=_checks.above_zero)
    velocity_mps: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    acceleration_mps2: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    end_velocity_mps: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    turn_rate_dps: float | None = attrs.field(default=None, validator=_checks.finite)
    acceleration_psd: float = attrs.field(default=0.0, validator=_checks.at_least_zero)

    def __attrs_post_init__(self) -> None:
        takes = _TAKES[self.motion]
        for key in ("velocity_mps", "acceleration_mps2", "end_velocity_mps", "turn_rate_dps"):
            if getattr(self, key) is not None and key not in takes:
                expected = ", ".join(("duration_s", *takes))
                raise ValueError(f"{key}: a {self.motion!r} leg takes {expected} only")
        if self.motion == "static" and self.acceleration_psd > 0.0:
            raise ValueError(
                "acceleration_psd: a 'static' leg stands still, expected 0, "
                f"got {self.acceleration_psd:g}"
            )
        needed = _ONE_NEEDED.get(self.motion, ())
        if needed and sum(getattr(self, key) is not None for key in needed) != 1:
            one = "one of " if len(needed) > 1 else ""
            raise ValueError(
                f"{needed[0]}: a {self.motion!r} leg needs {one}{' and '.join(needed)}"
            )


@attrs.frozen(kw_only=True)
class Target:
    """An emitter and its way.

    Parameters
    ----------
    name : str
        What tables call it.
    position_m : (d,)
        Position at its start, m; or give
    passes_m, at_s : (d,), float
        the position, m, that it passes at a time, s, between its start and its end; white
        acceleration comes on top.
    velocity_mps : (d,), optional
        Velocity at its start, m/s; without it zero.
    start_s : float
        When its first leg starts, s: it is born then, and gone when its last leg ends.
    legs : sequence of Leg
        At least one. Position and velocity go on from leg to leg, unless a leg gives its own
        `velocity_mps` or is ``"static"``.
    """

    name: str = attrs.field(validator=_checks.name)
    position_m: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    passes_m: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    at_s: float | None = attrs.field(default=None, validator=_checks.finite)
    velocity_mps: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    start_s: float = attrs.field(default=0.0, validator=_checks.finite)
    legs: tuple[Leg, ...] = attrs.field(converter=_checks.sequence, validator=_checks.all_are(Leg))

    def __attrs_post_init__(self) -> None:
        if not self.legs:
            raise ValueError("legs: expected at least one leg, got none")
        if (self.position_m is None) == (self.passes_m is None):
            raise ValueError("position_m: expected exactly one of position_m and passes_m")
        if (self.passes_m is None) != (self.at_s is None):
            raise ValueError("at_s: expected passes_m and at_s, or neither")
        if self.at_s is not None and not self.start_s <= self.at_s <= self.end_s:
            raise ValueError(
                f"at_s: expected a time from {self.start_s:g} s to {self.end_s:g} s, when the "
                f"target exists, got {self.at_s:g}"
            )
        check_lengths(self, self.dims)

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return len(self._given_m)

    @property
    def begins_m(self) -> Vector:
        """Position (d,) at its start, m."""
        if self.at_s is None:
            return self._given_m
        from_zero = attrs.evolve(
            self,
            position_m=(0.0,) * self.dims,
            passes_m=None,
            at_s=None,
            legs=[attrs.evolve(leg, acceleration_psd=0.0) for leg in self.legs],
        )
        gone = trajectory(from_zero, self.at_s).position
        return tuple((np.array(self._given_m) - gone).tolist())

    @property
    def _given_m(self) -> Vector:
        given = self.position_m if self.passes_m is None else self.passes_m
        assert given is not None
        return given

    @property
    def end_s(self) -> float:
        """When its last leg ends, s."""
        return self.start_s + sum(leg.duration_s for leg in self.legs)


class Trajectory(NamedTuple):
    """Position, velocity and acceleration (..., d) over time, m, m/s, m/s²."""

    position: Array
    velocity: Array
    acceleration: Array


def check_lengths(owner: Any, d: int) -> None:
    """Refuse vectors of `owner` and of its legs that do not have d components."""
    parts = [("", owner), *((f"legs[{i}].", leg) for i, leg in enumerate(owner.legs))]
    for place, part in parts:
        for key in ("velocity_mps", "acceleration_mps2", "end_velocity_mps"):
            value = getattr(part, key, None)
            if value is not None and len(value) != d:
                raise ValueError(
                    f"{place}{key}: expected as many numbers as in "
                    f"{'position_m' if owner.position_m is not None else 'passes_m'}, {d}, "
                    f"got {len(value)}"
                )
        if d < 2 and getattr(part, "motion", None) == "turn":
            raise ValueError(f"{place}motion: a turn needs 2 or 3 dimensions, got {d}")


def trajectory(target: Target, times: Any, rng: np.random.Generator | None = None) -> Trajectory:
    """Return where a target is, and how it moves, at given times.

    Parameters
    ----------
    target : Target
        The target; its legs are closed forms, exact at any time.
    times : (T,) or ()
        Times, s, between the target's start and end, increasing. At the border of two legs the
        later one holds.
    rng : numpy.random.Generator, optional
        Draws the white acceleration of legs with `acceleration_psd`; needed by those alone. The
        acceleration returned is that of the motion without it.

    Returns
    -------
    Trajectory
        Position, velocity, acceleration, each (T, d) or (d,).

    Raises
    ------
    ValueError
        Times outside the target's own, or decreasing; white acceleration without `rng`.
    """
    asked = _validate.array("times", times)
    t = np.atleast_1d(asked)
    if np.any(np.diff(t) < 0.0):
        raise ValueError("times: expected times that do not decrease")
    if t.size and (t[0] < target.start_s or t[-1] > target.end_s):
        bad = t[0] if t[0] < target.start_s else t[-1]
        raise ValueError(
            f"times: the target {target.name!r} exists from {target.start_s:g} s to "
            f"{target.end_s:g} s, got {bad:g} s"
        )
    p = np.array(target.begins_m)
    v = np.zeros_like(p) if target.velocity_mps is None else np.array(target.velocity_mps)
    wander = np.zeros((2, target.dims))  # position and velocity off the undisturbed way
    begin, parts = target.start_s, []
    for k, leg in enumerate(target.legs):
        last = k == len(target.legs) - 1
        end = target.end_s if last else begin + leg.duration_s
        inside = (t >= begin) & ((t <= end) if last else (t < end))
        moments = np.append(t[inside] - begin, leg.duration_s)
        if leg.velocity_mps is not None:
            v, wander[1] = np.array(leg.velocity_mps), 0.0
        elif leg.motion == "static":
            v, wander[1] = np.zeros_like(v), 0.0
        here = _leg(leg, p, v, moments)
        off = _wander(wander, leg, moments, rng)
        parts.append(Trajectory(here[0] + off[:, 0], here[1] + off[:, 1], here[2]))
        p, v, wander = here[0][-1], here[1][-1], off[-1].copy()
        begin = end
    rows = [np.concatenate([part[i][:-1] for part in parts]) for i in range(3)]
    return Trajectory(*(row.reshape(*asked.shape, target.dims) for row in rows))


def _leg(leg: Leg, p: Array, v: Array, s: Array) -> Trajectory:
    """Closed form of one leg at times s (T,) after its start at position p and velocity v."""
    s = s[:, None]
    if leg.motion == "turn":
        assert leg.turn_rate_dps is not None
        return _turn(np.radians(leg.turn_rate_dps), p, v, s)
    a = np.zeros_like(p)
    if leg.acceleration_mps2 is not None:
        a = np.array(leg.acceleration_mps2)
    elif leg.end_velocity_mps is not None:
        a = (np.array(leg.end_velocity_mps) - v) / leg.duration_s
    velocity = v + s * a
    if leg.end_velocity_mps is not None:  # no rounding error is left of a stop
        velocity = np.where(s == leg.duration_s, np.array(leg.end_velocity_mps), velocity)
    return Trajectory(p + s * v + 0.5 * s**2 * a, velocity, np.broadcast_to(a, velocity.shape))


def _turn(omega: float, p: Array, v: Array, s: Array) -> Trajectory:
    """Turn at rate omega (rad/s): p' = p + S v + C Jv, v' = cos v + sin Jv, a = omega J v'.

    J turns by 90 degrees; S = sin(omega s)/omega and C = (1 - cos(omega s))/omega, written with
    sinc so that a rate of zero is no special case.
    """
    angle = omega * s
    S = s * np.sinc(angle / np.pi)
    C = 0.5 * omega * (s * np.sinc(0.5 * angle / np.pi)) ** 2
    level, climb = v.copy(), v.copy()
    level[2:], climb[:2] = 0.0, 0.0
    side = np.zeros_like(v)
    side[0], side[1] = -v[1], v[0]
    cos, sin = np.cos(angle), np.sin(angle)
    return Trajectory(
        p + S * level + C * side + s * climb,
        cos * level + sin * side + climb,
        omega * (cos * side - sin * level),
    )


def _wander(start: Array, leg: Leg, s: Array, rng: np.random.Generator | None) -> Array:
    """Position and velocity (T, 2, d) that white acceleration adds, exact at the times s (T,)."""
    h = np.diff(s, prepend=0.0)[:, None]
    jolt = np.zeros((len(s), 2, len(start[0])))
    if leg.acceleration_psd > 0.0:
        if rng is None:
            raise ValueError("rng: the target has white acceleration; expected a Generator")
        # Cholesky factor of q [h³/3 h²/2; h²/2 h], by rows of velocity and position
        unit = rng.standard_normal(jolt.shape) * np.sqrt(leg.acceleration_psd)
        jolt[:, 1] = np.sqrt(h) * unit[:, 0]
        jolt[:, 0] = 0.5 * h * jolt[:, 1] + np.sqrt(h**3 / 12.0) * unit[:, 1]
    velocity = start[1] + np.cumsum(jolt[:, 1], axis=0)
    before = velocity - jolt[:, 1]
    position = start[0] + np.cumsum(h * before + jolt[:, 0], axis=0)
    return np.stack([position, velocity], axis=1)
