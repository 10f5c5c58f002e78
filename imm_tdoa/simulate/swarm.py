"""Many emitters described at once."""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np

from imm_tdoa.simulate import _checks
from imm_tdoa.simulate._checks import Vector
from imm_tdoa.simulate.path import Leg, Target
from imm_tdoa.simulate.streams import Streams


@attrs.frozen(kw_only=True)
class Swarm:
    """Emitters of which each is drawn at random (``[[swarms]]``): ``name-1``, ``name-2``, …

    They are drawn from `seed` alone, so that every recording of the scenario has the same ones,
    and each on its own, so that a larger swarm begins with the emitters of a smaller one. All
    intervals ``[low, high]`` are of uniform distributions; one number twice is that number.

    Parameters
    ----------
    name : str
        What their names begin with.
    count : int
        How many there are.
    low_m, high_m : (d,)
        Opposite corners of the box in which they start, m.
    speed_mps : [low, high]
        Horizontal speed, m/s.
    heading_deg : [low, high]
        Direction of the velocity at the start, degrees counter-clockwise from x.
    climb_mps : [low, high]
        Vertical velocity, m/s; in three dimensions only.
    start_s : [low, high]
        When they start, s.
    duration_s : [low, high]
        How long they exist, s.
    turn_rate_dps : [low, high]
        Rate, degrees per second, of a turn during the middle third of the time; the rest is
        straight. Without it all of it is.
    acceleration_psd : float
        Density of white acceleration on top, m²/s³ per axis, drawn anew with each recording.
    seed : int
        Seed that they are drawn from.
    """

    name: str = attrs.field(validator=_checks.name)
    count: int = attrs.field(validator=_checks.whole)
    low_m: Vector = attrs.field(converter=_checks.vector, validator=_checks.is_vector)
    high_m: Vector = attrs.field(converter=_checks.vector, validator=_checks.is_vector)
    speed_mps: Vector = attrs.field(
        converter=_checks.vector, validator=_checks.is_range(_checks.at_least_zero)
    )
    heading_deg: Vector = attrs.field(
        default=(0.0, 360.0), converter=_checks.vector, validator=_checks.is_range()
    )
    climb_mps: Vector = attrs.field(
        default=(0.0, 0.0), converter=_checks.vector, validator=_checks.is_range()
    )
    start_s: Vector = attrs.field(
        default=(0.0, 0.0), converter=_checks.vector, validator=_checks.is_range()
    )
    duration_s: Vector = attrs.field(
        converter=_checks.vector, validator=_checks.is_range(_checks.above_zero)
    )
    turn_rate_dps: Vector = attrs.field(
        default=(0.0, 0.0), converter=_checks.vector, validator=_checks.is_range()
    )
    acceleration_psd: float = attrs.field(default=0.0, validator=_checks.at_least_zero)
    seed: int = attrs.field(default=0, validator=_checks.whole)

    def __attrs_post_init__(self) -> None:
        d = len(self.low_m)
        if len(self.high_m) != d:
            raise ValueError(
                f"high_m: expected as many numbers as in low_m, {d}, got {len(self.high_m)}"
            )
        for i, (low, high) in enumerate(zip(self.low_m, self.high_m, strict=True)):
            if high < low:
                raise ValueError(
                    f"high_m[{i}]: expected at least low_m[{i}], {low:g}, got {high:g}"
                )
        if d < 3 and self.climb_mps != (0.0, 0.0):
            raise ValueError(f"climb_mps: needs 3 dimensions, got {d}")
        if self.count < 1:
            raise ValueError(f"count: expected at least 1, got {self.count}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the emitters."""
        return tuple(f"{self.name}-{i + 1}" for i in range(self.count))

    def targets(self) -> tuple[Target, ...]:
        """Return the emitters."""
        streams = Streams.from_seed(self.seed)
        return tuple(self._one(name, streams) for name in self.names)

    def _one(self, name: str, streams: Streams) -> Target:
        """Draw one emitter, each of its numbers from a stream of its own."""

        def draw(what: str) -> Callable[[float, float], float]:
            return streams.of("swarm", name, what).uniform

        place = streams.of("swarm", name, "position").uniform(self.low_m, self.high_m)
        speed, heading = draw("speed")(*self.speed_mps), draw("heading")(*self.heading_deg)
        level = (speed * np.cos(np.radians(heading)), speed * np.sin(np.radians(heading)))
        climb = [draw("climb")(*self.climb_mps)][: len(place) - 2]
        start, duration = draw("start")(*self.start_s), draw("duration")(*self.duration_s)
        rate = draw("turn")(*self.turn_rate_dps)
        straight = ("constant-velocity", None)
        parts = (straight, ("turn", rate), straight) if rate else (straight,)
        legs = [
            Leg(
                motion=motion,
                duration_s=duration / len(parts),
                turn_rate_dps=turn,
                acceleration_psd=self.acceleration_psd,
            )
            for motion, turn in parts
        ]
        return Target(
            name=name,
            position_m=tuple(place.tolist()),
            velocity_mps=(*level, *climb),
            start_s=start,
            legs=legs,
        )
