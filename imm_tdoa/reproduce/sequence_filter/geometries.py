"""Random geometries: whether the loop gain tells beforehand if the spot shrinks (§6.2)."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.reproduce.sequence_filter import scenario
from imm_tdoa.reproduce.sequence_filter.cases import check_runs
from imm_tdoa.reproduce.sequence_filter.spots import Spots
from imm_tdoa.reproduce.sequence_filter.switches import Switches
from imm_tdoa.stations import Stations

COUNT = 12
SHRUNK = 10.0  # raw over filtered radius from which on a spot counts as shrunk to a point
NEAREST_M, FARTHEST_M = 1000.0, 2500.0  # stations from the middle
REACH_M = 3000.0  # targets from the middle, at most


@attrs.frozen(eq=False)
class Geometry:
    """One geometry, what the loop gain predicts and what came out.

    Attributes
    ----------
    dims, stations : int
        Space dimensions, number of stations.
    kappa : float
        Loop gain.
    spots : Spots
        What came out.
    mean_gain : float
        Mean gain of the filters.
    """

    dims: int
    stations: int
    kappa: float
    spots: Spots
    mean_gain: float

    @property
    def predicted(self) -> bool:
        """Whether the spot should shrink."""
        return self.kappa < 1.0

    @property
    def shrunk(self) -> bool:
        """Whether it did."""
        return self.spots.shrink >= SHRUNK

    @property
    def right(self) -> bool:
        """Whether the prediction came true."""
        return self.predicted == self.shrunk


def draw(number: int, seed: int) -> tuple[Stations, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return random stations and a random place; every third geometry has three dimensions."""
    generator = np.random.default_rng([seed, 200, number])
    dims = 3 if number % 3 == 2 else 2
    count = int(generator.integers(dims + 2, dims + 6))
    away = generator.uniform(NEAREST_M, FARTHEST_M, count)
    direction = generator.standard_normal((count, dims))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    towards = generator.standard_normal(dims)
    place = generator.uniform(0.0, REACH_M) * towards / np.linalg.norm(towards)
    return Stations(away[:, None] * direction), place


def try_one(
    number: int, runs: int = 20, seed: int = 1, switches: Switches | None = None
) -> Geometry:
    """Filter a target that stands in random geometry `number` of a seed."""
    switches = Switches() if switches is None else switches
    stations, place = draw(number, seed)
    truth = scenario.standing(place)
    generator = np.random.default_rng([seed, 201, number])
    values = scenario.measured(stations, truth, check_runs(runs), generator)
    stage = switches.stage(stations)
    result = stage.run(np.arange(float(len(truth))), values)
    return Geometry(
        dims=stations.dims,
        stations=len(stations),
        kappa=float(stage.kappa(place)),
        spots=Spots.of(result, truth),
        mean_gain=float(np.mean(result.gain[:, -scenario.LAST :])),
    )
