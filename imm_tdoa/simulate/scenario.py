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

Further tables: ``[frame]``, ``[clock]``, ``[dropouts]``, ``[outliers]``, ``[height]``; the classes
in `measuring`, `faults` and `path` say what is in them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import attrs

from imm_tdoa.simulate import _checks
from imm_tdoa.simulate.faults import Clock, Dropouts, NoiseLevel, Outliers
from imm_tdoa.simulate.measuring import Frame, HeightReport, Sampling, Station
from imm_tdoa.simulate.path import Target


@attrs.frozen(kw_only=True)
class Scenario:
    """Everything that `simulate` needs; frozen.

    Parameters
    ----------
    title : str
        One line that says what this is.
    notes : str
        Whatever else there is to say; goes into the recording.
    dims : 2 or 3
        Number of space dimensions.
    speed_mps : float
        Speed of the signal, m/s.
    seed : int
        Seed that `simulate` takes where it is given none.
    frame, stations, sampling, noise, clock, dropouts, outliers, height, targets
        The tables of the file; see their classes.

    Raises
    ------
    ValueError
        Vectors that do not have `dims` components, names that repeat, stations that do not
        exist, parts that do not go together.
    """

    title: str = attrs.field(validator=_checks.is_a(str))
    notes: str = attrs.field(default="", validator=_checks.is_a(str))
    dims: int = attrs.field(validator=_checks.one_of(2, 3))
    speed_mps: float = attrs.field(default=299792458.0, validator=_checks.above_zero)
    seed: int = attrs.field(default=0, validator=_checks.whole)
    frame: Frame = attrs.field(default=Frame(), validator=_checks.is_a(Frame))
    stations: tuple[Station, ...] = attrs.field(
        converter=_checks.sequence, validator=_checks.all_are(Station)
    )
    sampling: Sampling = attrs.field(validator=_checks.is_a(Sampling))
    noise: NoiseLevel = attrs.field(validator=_checks.is_a(NoiseLevel))
    clock: Clock = attrs.field(default=Clock(), validator=_checks.is_a(Clock))
    dropouts: Dropouts = attrs.field(default=Dropouts(), validator=_checks.is_a(Dropouts))
    outliers: Outliers = attrs.field(default=Outliers(), validator=_checks.is_a(Outliers))
    height: HeightReport | None = attrs.field(default=None, validator=_checks.is_a(HeightReport))
    targets: tuple[Target, ...] = attrs.field(
        converter=_checks.sequence, validator=_checks.all_are(Target)
    )

    def __attrs_post_init__(self) -> None:
        if len(self.stations) < 2:
            raise ValueError(f"stations: expected at least two, got {len(self.stations)}")
        if not self.targets:
            raise ValueError("targets: expected at least one, got none")
        for kind, items in (("stations", self.stations), ("targets", self.targets)):
            self._check_items(kind, items)
        self._check_apart()
        self._check_stations_exist()
        self._check_measured()

    @property
    def station_names(self) -> tuple[str, ...]:
        """Names of the stations."""
        return tuple(station.name for station in self.stations)

    @property
    def end_s(self) -> float:
        """When the last leg of the last target ends, s."""
        return max(target.end_s for target in self.targets)

    def _check_items(self, kind: str, items: tuple[Any, ...]) -> None:
        names: list[str] = []
        for i, item in enumerate(items):
            if len(item.position_m) != self.dims:
                raise ValueError(
                    f"{kind}[{i}].position_m: expected {self.dims} numbers (dims = {self.dims}), "
                    f"got {len(item.position_m)}"
                )
            if item.name in names:
                raise ValueError(f"{kind}[{i}].name: {item.name!r} appears twice")
            names.append(item.name)

    def _check_apart(self) -> None:
        fixed = sorted((s.position_m, i) for i, s in enumerate(self.stations) if not s.moving)
        for (a, i), (b, j) in pairwise(fixed):
            if a == b:
                raise ValueError(
                    f"stations[{j}].position_m: the same as that of {self.stations[i].name!r}; "
                    f"expected stations apart from each other"
                )

    def _check_stations_exist(self) -> None:
        known = self.station_names
        places = [
            *((f"dropouts.station.{n}", n) for n in self.dropouts.station),
            *((f"outliers.station.{n}", n) for n in self.outliers.station),
            *(
                (f"dropouts.silences[{i}].station", s.station)
                for i, s in enumerate(self.dropouts.silences)
            ),
        ]
        for place, station in places:
            if station not in known:
                raise ValueError(
                    f"{place}: there is no station {station!r}; there are: {', '.join(known)}"
                )

    def _check_measured(self) -> None:
        noise, sampling = self.noise, self.sampling
        if sampling.rows == "toa" and noise.toa_sigma_s is None:
            raise ValueError("noise.toa_sigma_s: missing, where sampling.rows = 'toa'")
        if sampling.range_rate and noise.range_rate_sigma_mps is None:
            raise ValueError(
                "noise.range_rate_sigma_mps: missing, where sampling.range_rate = true"
            )
        if self.height is not None and self.dims != 3:
            raise ValueError("height: a height needs dims = 3")
        if self.end_s < sampling.start_s:
            raise ValueError(
                f"sampling.start_s: expected a time before the last target ends, "
                f"{self.end_s:g} s, got {sampling.start_s:g}"
            )
