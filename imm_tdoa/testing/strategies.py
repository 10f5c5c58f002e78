"""Hypothesis strategies for what models are tried on; for the tests of plug-ins too.

>>> from hypothesis import given
>>> from imm_tdoa.testing.strategies import states, time_steps
>>> @given(states(("x", "y", "vx", "vy")), time_steps())
... def test_energy_stays(x, dt): ...

Values are plain numbers of at most a few decimals (never 1e-300), so that a comparison relative
to their size is meaningful and a failing example is easy to read. Units are SI throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.statespace import KIND_OF
from imm_tdoa.stations import Stations

BOUND = {"position": 1e5, "velocity": 1e3, "acceleration": 50.0, "turn_rate": 0.5}
EXTENT = 1e4

P = ParamSpec("P")
T = TypeVar("T")


def _remembered(make: Callable[P, T]) -> Callable[P, T]:
    """Build each strategy once: hypothesis takes longer to build one than to draw from it."""
    return cast(Callable[P, T], cache(make))


class Kinematics(NamedTuple):
    """Where an emitter is and how it moves, at one time.

    Attributes
    ----------
    position, velocity : (d,)
        m and m/s.
    time : float
        s.
    """

    position: Array
    velocity: Array
    time: float


@_remembered
def numbers(low: float, high: float, decimals: int = 3) -> st.SearchStrategy[float]:
    """Numbers between `low` and `high`, rounded to `decimals`."""
    return st.floats(low, high).map(lambda v: min(max(round(v, decimals) + 0.0, low), high))


def vectors(bounds: Sequence[float], decimals: int = 3) -> st.SearchStrategy[Array]:
    """Vectors (n,) whose component i lies within ±bounds[i]."""
    return _vectors(tuple(bounds), decimals)


@_remembered
def _vectors(bounds: tuple[float, ...], decimals: int) -> st.SearchStrategy[Array]:
    parts = [numbers(-b, b, decimals if b >= 1.0 else decimals + 3) for b in bounds]
    return st.tuples(*parts).map(lambda v: np.array(v, dtype=float))


def time_steps(low: float = 1e-3, high: float = 100.0) -> st.SearchStrategy[float]:
    """Time steps dt, s, above zero: from milliseconds to minutes."""
    return numbers(low, high)


def states(components: Sequence[str]) -> st.SearchStrategy[Array]:
    """States (n,) with these component names, each within what its name lets one expect.

    Positions within ±100 km, velocities ±1000 m/s, accelerations ±50 m/s², turn rates
    ±0.5 rad/s, anything else ±1.
    """
    return vectors([BOUND.get(KIND_OF.get(c, ""), 1.0) for c in components])


@_remembered
def rotations(dims: int) -> st.SearchStrategy[Array]:
    """Rotations (d, d) about the vertical axis, `dims` 2 or 3."""
    if dims not in (2, 3):
        raise ValueError(f"dims: expected 2 or 3 space dimensions, got {dims!r}")
    return numbers(-3.2, 3.2).map(lambda angle: rotation(angle, dims))


def rotation(angle: float, dims: int) -> Array:
    """Return the rotation (d, d) by `angle` (rad) about the vertical axis."""
    R = np.eye(dims)
    R[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return R


@_remembered
def covariances(n: int) -> st.SearchStrategy[Array]:
    """Positive definite matrices (n, n) with variances between 1 and some 10 n."""
    entries = vectors([3.0] * (n * n))
    return entries.map(lambda v: v.reshape(n, n) @ v.reshape(n, n).T + np.eye(n))


@st.composite
def station_arrays(
    draw: st.DrawFn,
    dims: int = 2,
    *,
    low: int = 3,
    high: int = 6,
    moving: bool = False,
    uncertain: bool = False,
) -> Stations:
    """Arrays of `low` to `high` stations within ±10 km, at least 100 m apart.

    Parameters
    ----------
    dims : int
        Space dimensions.
    low, high : int
        Fewest and most stations.
    moving : bool
        Sampled at 0, 10 and 20 s with positions and velocities; otherwise at fixed places, with
        velocities.
    uncertain : bool
        With position and velocity covariances.
    """
    _validate.dimensions(dims)
    grid = st.tuples(*[st.integers(-100, 100)] * dims)
    places = draw(st.lists(grid, min_size=low, max_size=high, unique=True))
    positions = 100.0 * np.array(places, dtype=float)
    S = len(positions)
    settings: dict[str, Any] = {}
    if uncertain:
        settings["position_covariance"] = np.stack([draw(covariances(dims)) for _ in range(S)])
        settings["velocity_covariance"] = np.stack([draw(covariances(dims)) for _ in range(S)])
    if moving:
        times = np.array([0.0, 10.0, 20.0])
        velocities = np.stack([draw(vectors([1.0] * dims)) for _ in range(S)])
        path = positions + times[:, None, None] * velocities
        speeds = np.broadcast_to(velocities, path.shape)
        return Stations(path, velocities=speeds, times=times, **settings)
    velocities = np.stack([draw(vectors([30.0] * dims)) for _ in range(S)])
    return Stations(positions, velocities=velocities, **settings)


@_remembered
def station_pairs(stations: int) -> st.SearchStrategy[Index]:
    """Pairs (m, 2) [station, reference] among `stations`, each once, loops included."""
    pair = st.tuples(*[st.integers(0, stations - 1)] * 2).filter(lambda p: p[0] != p[1])
    many = st.lists(pair, min_size=1, max_size=stations + 1, unique_by=lambda p: frozenset(p))
    return many.map(lambda pairs: np.array(pairs, dtype=np.int64))


@_remembered
def present_rows(size: int, *, low: int = 0) -> st.SearchStrategy[Mask]:
    """Masks (size,) of the rows that arrived, at least `low` of them; every other time all."""
    some = st.tuples(*[st.booleans()] * size).filter(lambda v: sum(v) >= low)
    return st.one_of(st.just((True,) * size), some).map(lambda v: np.array(v, dtype=bool))


def stations_of(model: Any) -> list[Stations]:
    """Return the stations behind a measurement model, those of its members for a stack."""
    members = [s for member in getattr(model, "models", ()) for s in stations_of(member)]
    own = getattr(model, "stations", None)
    return members + ([own] if isinstance(own, Stations) else [])


@st.composite
def kinematics(draw: st.DrawFn, model: Any) -> Kinematics:
    """Emitters that `model` can measure.

    Positions lie around its stations, within twice the array's radius and no closer to a station
    than a hundredth of it; without stations within ±10 km. Velocities are within ±300 m/s. Times
    are those at which the stations (and its `sigma_times`) are given.
    """
    every = stations_of(model)
    time = draw(_times(model, every))
    d = int(model.dims)
    centre, radius, places = np.zeros(d), EXTENT, np.zeros((0, d))
    if every:
        places = np.concatenate([s.at(time)[0] for s in every])
        assume(bool(np.all(np.isfinite(places))))
        centre = np.round(places.mean(axis=0))
        radius = max(float(np.max(np.linalg.norm(places - centre, axis=-1))), 1.0)
    position = centre + draw(vectors([2.0 * radius] * d))
    distance = np.linalg.norm(places - position, axis=-1)
    assume(float(np.min(distance, initial=np.inf)) > 0.01 * radius)
    return Kinematics(position, draw(vectors([300.0] * d)), time)


def _times(model: Any, every: Sequence[Stations]) -> st.SearchStrategy[float]:
    sampled = [s.times for s in every if s.times is not None]
    low = max([0.0] if not sampled else [float(t[0]) for t in sampled])
    high = min([100.0] if not sampled else [float(t[-1]) for t in sampled])
    stamps = _sigma_times(model)
    if stamps:
        common = set.intersection(*stamps)
        fit = sorted(t for t in common if not sampled or low <= t <= high)
        if not fit:
            raise ValueError("sigma_times: at none of these times are all stations known")
        return st.sampled_from(fit)
    if low > high:
        raise ValueError("stations: at no time are all stations known")
    return numbers(low, high)


def _sigma_times(model: Any) -> list[set[float]]:
    own = getattr(model, "sigma_times", None)
    members = [t for member in getattr(model, "models", ()) for t in _sigma_times(member)]
    return members + ([] if own is None else [{float(t) for t in np.asarray(own)}])
