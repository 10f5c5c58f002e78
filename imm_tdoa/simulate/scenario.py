"""A scenario: stations, targets and errors, and how a TOML file spells them.

::

    title = "A vessel that leaves the quay"
    dims = 2

    [[stations]]
    name = "north"
    position_m = [0.0, 12000.0]          # + velocity_mps, legs: a station that moves

    [sampling]
    interval_s = 2.0
    rows = "tdoa-reference"

    [noise]
    toa_sigma_s = 70e-9

    [[targets]]
    name = "vessel"
    position_m = [1500.0, -400.0]

    [[targets.legs]]
    motion = "static"
    duration_s = 60.0

    [[targets.legs]]
    motion = "constant-acceleration"
    duration_s = 30.0
    end_velocity_mps = [8.0, 3.0]

Further tables: ``[frame]``, ``[clock]``, ``[detection]``, ``[clutter]``, ``[dropouts]``,
``[outliers]``, ``[height]``, and ``[[swarms]]`` of many targets; the classes in `measuring`,
`detection`, `faults`, `path` and `swarm` say what is in them.
"""

from __future__ import annotations

from functools import cached_property

import attrs

from imm_tdoa.simulate import _checks, consistency
from imm_tdoa.simulate.detection import Clutter, Detection
from imm_tdoa.simulate.faults import Clock, Dropouts, NoiseLevel, Outliers
from imm_tdoa.simulate.measuring import Frame, HeightReport, Sampling, Station
from imm_tdoa.simulate.path import Target
from imm_tdoa.simulate.swarm import Swarm


@attrs.frozen(kw_only=True)
class Scenario:
    """Everything that `simulate` needs; frozen.

    Parameters
    ----------
    title : str
        One line that says what this is.
    notes : str
        Whatever else there is to say; goes into the recording.
    track_with : str
        Options of ``imm-tdoa track`` that suit its targets, such as ``--bank ship``; a hint.
    dims : 2 or 3
        Number of space dimensions.
    speed_mps : float
        Speed of the signal, m/s.
    seed : int
        Seed that `simulate` takes where it is given none.
    labelled : bool
        Whether the recording says which row is whose.
    frame, stations, sampling, noise, clock, detection, clutter, dropouts, outliers, height,
    targets, swarms
        The tables of the file; see their classes.

    Raises
    ------
    ValueError
        Vectors that do not have `dims` components, names that repeat, stations that do not
        exist, parts that do not go together.
    """

    title: str = attrs.field(validator=_checks.is_a(str))
    notes: str = attrs.field(default="", validator=_checks.is_a(str))
    track_with: str = attrs.field(default="", validator=_checks.is_a(str))
    dims: int = attrs.field(validator=_checks.one_of(2, 3))
    speed_mps: float = attrs.field(default=299792458.0, validator=_checks.above_zero)
    seed: int = attrs.field(default=0, validator=_checks.whole)
    labelled: bool = attrs.field(default=True, validator=_checks.is_a(bool))
    frame: Frame = attrs.field(default=Frame(), validator=_checks.is_a(Frame))
    stations: tuple[Station, ...] = attrs.field(
        converter=_checks.sequence, validator=_checks.all_are(Station)
    )
    sampling: Sampling = attrs.field(validator=_checks.is_a(Sampling))
    noise: NoiseLevel = attrs.field(validator=_checks.is_a(NoiseLevel))
    clock: Clock = attrs.field(default=Clock(), validator=_checks.is_a(Clock))
    detection: Detection = attrs.field(default=Detection(), validator=_checks.is_a(Detection))
    clutter: Clutter = attrs.field(default=Clutter(), validator=_checks.is_a(Clutter))
    dropouts: Dropouts = attrs.field(default=Dropouts(), validator=_checks.is_a(Dropouts))
    outliers: Outliers = attrs.field(default=Outliers(), validator=_checks.is_a(Outliers))
    height: HeightReport | None = attrs.field(default=None, validator=_checks.is_a(HeightReport))
    targets: tuple[Target, ...] = attrs.field(
        default=(), converter=_checks.sequence, validator=_checks.all_are(Target)
    )
    swarms: tuple[Swarm, ...] = attrs.field(
        default=(), converter=_checks.sequence, validator=_checks.all_are(Swarm)
    )

    def __attrs_post_init__(self) -> None:
        consistency.check(self)

    @cached_property
    def emitters(self) -> tuple[Target, ...]:
        """The targets, and those of the swarms."""
        return (*self.targets, *(target for swarm in self.swarms for target in swarm.targets()))

    @property
    def common_scans(self) -> bool:
        """Whether all emitters are heard at the same moments and by the same pair."""
        return not self.labelled and self.sampling.rows != "toa"

    @property
    def station_names(self) -> tuple[str, ...]:
        """Names of the stations."""
        return tuple(station.name for station in self.stations)

    @property
    def end_s(self) -> float:
        """When the last leg of the last target ends, s."""
        return max(target.end_s for target in self.emitters)
