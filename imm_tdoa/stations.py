"""Where the receivers are, at any time, and how well that is known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, Index


@attrs.frozen(eq=False)
class Stations:
    """Receivers, fixed or moving.

    Parameters
    ----------
    positions : (S, d) or (K, S, d)
        Positions, m; d is 1, 2 or 3. With `times`, one row per sample time; NaN where a moving
        station was not sampled.
    velocities : (S, d) or (K, S, d), optional
        Velocities, m/s. Between samples positions follow the cubic Hermite curve through
        positions and velocities, or the straight line where velocities are not given.
    times : (K,), optional
        Sample times of moving stations, s, strictly increasing.
    position_covariance : (S, d, d), optional
        Covariance of each station's position error, m², independent between stations.
    velocity_covariance : (S, d, d), optional
        Covariance of each station's velocity error, (m/s)².
    names : sequence of str, optional
        Station names, for messages and tables; default ``"0" … "S-1"``.

    Raises
    ------
    ValueError
        Wrong shapes, unsorted times, two fixed stations in one place, names that repeat.
    """

    positions: Array
    velocities: Array | None = attrs.field(default=None, kw_only=True)
    times: Array | None = attrs.field(default=None, kw_only=True)
    position_covariance: Array | None = attrs.field(default=None, kw_only=True)
    velocity_covariance: Array | None = attrs.field(default=None, kw_only=True)
    names: tuple[str, ...] = attrs.field(default=(), kw_only=True)
    _sampled: tuple[Index, Index] | None = attrs.field(init=False, repr=False, default=None)

    __repr__ = brief

    def __attrs_post_init__(self) -> None:
        put = self._put
        if self.times is None:
            put("positions", _validate.array("positions", self.positions, ("S", "d")))
        else:
            moving = _validate.array("positions", self.positions, ("K", "S", "d"), finite=False)
            put("positions", moving)
            times = _validate.array("times", self.times, (len(self.positions),))
            if np.any(np.diff(times) <= 0.0):
                k = int(np.argmax(np.diff(times) <= 0.0)) + 1
                raise ValueError(
                    f"times: expected strictly increasing times, times[{k}] = {times[k]:g} s "
                    f"follows {times[k - 1]:g} s"
                )
            put("times", times)
        S, d = self.positions.shape[-2:]
        _validate.dimensions(d)
        if self.velocities is not None:
            velocities = _validate.array(
                "velocities", self.velocities, self.positions.shape, finite=self.times is None
            )
            put("velocities", velocities)
        for name in ("position_covariance", "velocity_covariance"):
            if getattr(self, name) is not None:
                value = _validate.array(name, getattr(self, name), (S, d, d))
                put(name, _validate.covariance(name, value, d))
        put("names", _names(self.names, S))
        if self.times is None:
            self._refuse_coincident()
        else:
            put("_sampled", _neighbours(np.isfinite(self.positions).all(axis=-1)))

    def _put(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _refuse_coincident(self) -> None:
        for i in range(len(self)):
            same = np.all(self.positions[i + 1 :] == self.positions[i], axis=-1)
            if np.any(same):
                j = i + 1 + int(np.argmax(same))
                raise ValueError(
                    f"positions: stations {self.names[i]!r} and {self.names[j]!r} are in the "
                    f"same place {self.positions[i].tolist()}; expected stations apart from "
                    f"each other"
                )

    def __len__(self) -> int:
        return int(self.positions.shape[-2])

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return int(self.positions.shape[-1])

    @property
    def moving(self) -> bool:
        """Whether positions are sampled over time."""
        return self.times is not None

    def at(self, time: float | Array = 0.0) -> tuple[Array, Array]:
        """Return where the stations are, and how fast.

        A moving station is where its sample says at exactly that time, interpolated in between
        where it was sampled on both sides, and NaN (unheard) otherwise. Velocities that were
        never given are zero for fixed stations and the slope of the line for moving ones.

        Parameters
        ----------
        time : float or (...)
            When, s.

        Returns
        -------
        (..., S, d), (..., S, d)
            Positions, m, and velocities, m/s; without the leading axes for fixed stations.
        """
        if self.times is None or self._sampled is None:
            rest = np.zeros_like(self.positions) if self.velocities is None else self.velocities
            return self.positions, rest
        time = np.asarray(time, dtype=float)
        before, after = self._sampled
        last = np.searchsorted(self.times, time, side="right") - 1  # latest sample at or before
        first = np.searchsorted(self.times, time, side="left")  # earliest sample at or after
        K = len(self.times)
        i = np.where((last >= 0)[..., None], before[np.clip(last, 0, K - 1)], -1)
        j = np.where((first < K)[..., None], after[np.clip(first, 0, K - 1)], K)
        heard = (i >= 0) & (j < K)
        i, j = np.where(heard, i, 0), np.where(heard, j, 0)
        return self._interpolate(time[..., None], i, j, heard)

    def _interpolate(self, time: Array, i: Index, j: Index, heard: Any) -> tuple[Array, Array]:
        assert self.times is not None
        station = np.arange(len(self))
        h = self.times[j] - self.times[i]
        same = h == 0.0
        h = np.where(same, 1.0, h)[..., None]
        s = (time - self.times[i])[..., None] / h
        p0, p1 = self.positions[i, station], self.positions[j, station]
        slope = (p1 - p0) / h
        if self.velocities is None:
            position, velocity = (
                p0 + s * (p1 - p0),
                np.where(same[..., None], self._slope(i), slope),
            )
        else:
            v0, v1 = self.velocities[i, station], self.velocities[j, station]
            a, b = h * v0 - (p1 - p0), (p1 - p0) - h * v1
            position = p0 + s * (p1 - p0) + s * (1.0 - s) * ((1.0 - s) * a + s * b)
            velocity = (
                slope + (1.0 - 2.0 * s) * ((1.0 - s) * a + s * b) / h + s * (1.0 - s) * (b - a) / h
            )
        position = np.where(same[..., None], p0, position)
        nan = np.where(heard, 0.0, np.nan)[..., None]
        return position + nan, velocity + nan

    def _slope(self, i: Index) -> Array:
        """Velocity at sample i where only positions are known: slope between its neighbours."""
        assert self.times is not None
        assert self._sampled is not None
        before, after = self._sampled
        K, station = len(self.times), np.arange(len(self))
        low = np.where(i > 0, before[np.clip(i - 1, 0, K - 1), station], -1)
        high = np.where(i < K - 1, after[np.clip(i + 1, 0, K - 1), station], K)
        low, high = np.where(low < 0, i, low), np.where(high >= K, i, high)
        h = self.times[high] - self.times[low]
        rise = self.positions[high, station] - self.positions[low, station]
        result: Array = rise / np.where(h == 0.0, np.inf, h)[..., None]
        return result


def _names(names: Sequence[str], S: int) -> tuple[str, ...]:
    result = tuple(str(n) for n in names) or tuple(str(i) for i in range(S))
    if len(result) != S:
        raise ValueError(f"names: expected {S} names, one per station, got {len(result)}")
    if len(set(result)) != S:
        twice = next(n for n in result if result.count(n) > 1)
        raise ValueError(f"names: the station {twice!r} appears twice")
    return result


def _neighbours(sampled: Any) -> tuple[Index, Index]:
    """For each sample and station: the latest sample at or before, the earliest at or after.

    -1 and K where there is none; shapes (K, S).
    """
    K = len(sampled)
    index = np.arange(K)[:, None]
    before = np.maximum.accumulate(np.where(sampled, index, -1), axis=0)
    after = np.minimum.accumulate(np.where(sampled, index, K)[::-1], axis=0)[::-1]
    return before.astype(np.int64), after.astype(np.int64)


def pair_index(pairs: Any, stations: Stations | int) -> Index:
    """Return station pairs (..., m, 2) as integers [station, reference].

    Parameters
    ----------
    pairs : "reference", "adjacent" or array-like (..., m, 2)
        ``"reference"``: every other station against station 0; ``"adjacent"``: station i against
        station i + 1 (Source B).
    stations : Stations or int
        The stations, or how many there are.

    Raises
    ------
    ValueError
        Not integers, an unknown station, or a station paired with itself.
    """
    S = stations if isinstance(stations, int) else len(stations)
    if isinstance(pairs, str):
        if pairs == "reference":
            return np.array([[i, 0] for i in range(1, S)], dtype=np.int64).reshape(-1, 2)
        if pairs == "adjacent":
            return np.array([[i, i + 1] for i in range(S - 1)], dtype=np.int64).reshape(-1, 2)
        raise ValueError(
            f"pairs: expected 'reference', 'adjacent' or an array (m, 2) of "
            f"[station, reference], got {pairs!r}"
        )
    try:
        index = np.asarray(pairs)
    except ValueError as error:
        raise ValueError(f"pairs: expected an array (..., m, 2), got {pairs!r}") from error
    if index.ndim < 2 or index.shape[-1] != 2:
        raise ValueError(
            f"pairs: expected shape (..., m, 2) of [station, reference], got {index.shape}"
        )
    if index.size and not np.issubdtype(index.dtype, np.integer):
        raise ValueError(f"pairs: expected integers, got {index.dtype}")
    if np.any((index < 0) | (index >= S)):
        bad = int(index[(index < 0) | (index >= S)][0])
        raise ValueError(f"pairs: station {bad} does not exist; there are {S}, numbered from 0")
    if np.any(index[..., 0] == index[..., 1]):
        bad = int(index[..., 0][index[..., 0] == index[..., 1]][0])
        raise ValueError(f"pairs: station {bad} is paired with itself")
    return index.astype(np.int64)
