"""What a scenario measures with, and when: axes, stations, sampling, reported heights."""

from __future__ import annotations

import attrs

from imm_tdoa.frames import EastNorthUp
from imm_tdoa.simulate import _checks
from imm_tdoa.simulate._checks import Vector
from imm_tdoa.simulate.path import Leg, Target, check_lengths

ROWS = ("toa", "tdoa-reference", "tdoa-adjacent", "tdoa-one-pair")


@attrs.frozen(kw_only=True)
class Frame:
    """Where on the Earth the axes are (``[frame]``).

    Parameters
    ----------
    kind : "local" or "enu"
        Axes anywhere, or east-north-up at an origin.
    origin_lat_deg, origin_lon_deg, origin_height_m : float
        The origin of an ``"enu"`` frame, WGS84, degrees and m.
    """

    kind: str = attrs.field(default="local", validator=_checks.one_of("local", "enu"))
    origin_lat_deg: float | None = attrs.field(default=None, validator=_checks.finite)
    origin_lon_deg: float | None = attrs.field(default=None, validator=_checks.finite)
    origin_height_m: float = attrs.field(default=0.0, validator=_checks.finite)

    def __attrs_post_init__(self) -> None:
        for key in ("origin_lat_deg", "origin_lon_deg"):
            given = getattr(self, key) is not None
            if given != (self.kind == "enu"):
                what = "missing, where kind = 'enu'" if not given else "only where kind = 'enu'"
                raise ValueError(f"{key}: {what}")
        try:
            self.axes()
        except ValueError as error:
            raise ValueError(f"origin_{error}") from error

    def axes(self) -> EastNorthUp | None:
        """Return the frame, or None for local axes."""
        if self.origin_lat_deg is None or self.origin_lon_deg is None:
            return None
        return EastNorthUp(self.origin_lat_deg, self.origin_lon_deg, self.origin_height_m)


@attrs.frozen(kw_only=True)
class Station:
    """A receiver (``[[stations]]``).

    Parameters
    ----------
    name : str
        What tables call it.
    position_m : (d,)
        Position, m; of a moving station that at ``sampling.start_s``.
    velocity_mps : (d,), optional
        Velocity, m/s: the station moves, and its positions are sampled over time.
    legs : sequence of Leg, optional
        How it moves, as a target does; after the last leg on with the velocity it has then.
    """

    name: str = attrs.field(validator=_checks.name)
    position_m: Vector = attrs.field(converter=_checks.vector, validator=_checks.is_vector)
    velocity_mps: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_vector
    )
    legs: tuple[Leg, ...] = attrs.field(
        default=(), converter=_checks.sequence, validator=_checks.all_are(Leg)
    )

    def __attrs_post_init__(self) -> None:
        for i, leg in enumerate(self.legs):
            if leg.acceleration_psd > 0.0:
                raise ValueError(
                    f"legs[{i}].acceleration_psd: a station moves without disturbance, "
                    f"expected 0, got {leg.acceleration_psd:g}"
                )
        check_lengths(self, len(self.position_m))

    @property
    def moving(self) -> bool:
        """Whether it has a velocity or legs."""
        return self.velocity_mps is not None or bool(self.legs)

    def path(self, begin: float, end: float) -> Target:
        """Return its way from `begin` to `end` or longer, s."""
        rest = end - begin - sum(leg.duration_s for leg in self.legs)
        legs = self.legs
        if rest >= 0.0:
            motion = "constant-velocity" if self.moving else "static"
            legs = (*legs, Leg(motion=motion, duration_s=rest + 1.0))
        return Target(
            name=self.name,
            position_m=self.position_m,
            velocity_mps=self.velocity_mps,
            start_s=begin,
            legs=legs,
        )


@attrs.frozen(kw_only=True)
class Sampling:
    """When what is measured (``[sampling]``).

    Parameters
    ----------
    interval_s : float
        Time between scans, s.
    start_s : float
        Time of the first scan, s.
    jitter_s : float
        Each scan comes up to this much later, at random (uniform), s; at most `interval_s`. Each
        target has its own scans, but where differences are not labelled: there all are heard in
        the same ones, or their times would tell them apart.
    rows : str
        ``"toa"``: arrival times of an emission whose own time is unknown. ``"tdoa-reference"``:
        differences against the first station. ``"tdoa-adjacent"``: station i against station
        i + 1. ``"tdoa-one-pair"``: one pair a scan, drawn at random for each target, or for all of
        them where rows are not labelled.
    range_rate : bool
        Whether range rates are measured too: one per arrival time, with an unknown common
        offset, or their differences beside time differences.
    resolution_s : float, optional
        Two emitters' rows of one station (pair) in one scan that are less than this apart, s,
        are one row, the mean of both; of a chain of such rows too. Arrival times are compared
        as they come in, and what is left is a row of the first emission. False alarms are not
        merged. Where rows are not labelled only.
    """

    interval_s: float = attrs.field(validator=_checks.above_zero)
    start_s: float = attrs.field(default=0.0, validator=_checks.finite)
    jitter_s: float = attrs.field(default=0.0, validator=_checks.at_least_zero)
    rows: str = attrs.field(default="tdoa-reference", validator=_checks.one_of(*ROWS))
    range_rate: bool = attrs.field(default=False, validator=_checks.is_a(bool))
    resolution_s: float | None = attrs.field(default=None, validator=_checks.above_zero)

    def __attrs_post_init__(self) -> None:
        if self.jitter_s > self.interval_s:
            raise ValueError(
                f"jitter_s: expected at most interval_s, {self.interval_s:g} s, so that scans "
                f"keep their order, got {self.jitter_s:g}"
            )


@attrs.frozen(kw_only=True)
class HeightReport:
    """The emitter reports its height (``[height]``).

    Parameters
    ----------
    sigma_m : float
        Standard deviation of its normal error, m.
    """

    sigma_m: float = attrs.field(validator=_checks.above_zero)
