"""What arrived when: the rows of a recording in the order a filter takes them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa import _validate
from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, Index, MeasurementModel


@attrs.frozen(eq=False)
class Scans:
    """Scans of one measurement model; unpacks as ``measurement, times, values, pairs``.

    Attributes
    ----------
    measurement : MeasurementModel
        What is measured.
    times : (T,) or (..., T)
        Times, s, not decreasing.
    values : (..., T, m)
        Rows in the measurement's units; NaN is missing.
    pairs : (T, m, 2) or (..., T, m, 2), optional
        Station pairs of each row, where they change from scan to scan.
    """

    measurement: MeasurementModel
    times: Array
    values: Array
    pairs: Index | None = None

    __repr__ = brief

    @classmethod
    def checked(
        cls, measurement: MeasurementModel, times: Any, values: Any, pairs: Any = None
    ) -> Scans:
        """Return the scans, checked.

        Parameters
        ----------
        measurement, times, values, pairs
            See `Scans`.

        Raises
        ------
        ValueError
            Decreasing times, shapes or batch axes that do not fit, pairs that do not exist.
        """
        times = _validate.array("times", times, (None, "T"))
        T = times.shape[-1]
        if T == 0:
            raise ValueError("times: expected at least one scan, got none")
        back = times[..., 1:] < times[..., :-1]
        if back.any():
            *target, k = (int(i) for i in np.argwhere(back)[0])
            before, after = times[(*target, slice(k, k + 2))]
            raise ValueError(
                f"times: expected times that do not decrease, times[{k + 1}] = {after:g} s "
                f"follows {before:g} s"
            )
        if pairs is not None:
            try:
                pairs = np.asarray(pairs)
            except ValueError as error:
                raise ValueError(f"pairs: expected an array ({T}, m, 2), got {pairs!r}") from error
            if pairs.ndim < 3 or pairs.shape[-3] != T or pairs.shape[-1] != 2:
                raise ValueError(f"pairs: expected shape ({T}, m, 2), got {pairs.shape}")
            measurement.with_pairs(pairs)  # refuses what is wrong in any scan
            measurement = measurement.with_pairs(pairs[..., 0, :, :])
        shape = (None, T, measurement.size)
        values = _validate.array("values", values, shape, finite=False, copy=False)
        batch = _fit("times", times.shape[:-1], values.shape[:-2])
        if pairs is not None and _fit("pairs", pairs.shape[:-3], batch) != batch:
            raise ValueError(
                f"pairs: of {pairs.shape[:-3]} targets, but times and values are of {batch}"
            )
        return cls(measurement, times, values, pairs)

    def __iter__(self) -> Iterator[Any]:
        return iter((self.measurement, self.times, self.values, self.pairs))

    @property
    def count(self) -> int:
        """Number of scans T."""
        return int(self.times.shape[-1])

    @property
    def batch(self) -> tuple[int, ...]:
        """Batch axes: targets that share the measurement model."""
        own = self.values.shape[:-2]
        return own if self.times.ndim == 1 else np.broadcast_shapes(own, self.times.shape[:-1])

    def measured_at(self, k: int) -> MeasurementModel:
        """Return the measurement model of one scan, with its pairs.

        Parameters
        ----------
        k : int
            Which scan.
        """
        if self.pairs is None:
            return self.measurement
        return self.measurement.with_pairs(self.pairs[..., k, :, :])

    def part(self, scans: slice) -> Scans:
        """Return some of the scans.

        Parameters
        ----------
        scans : slice
            Which ones.
        """
        pairs = None if self.pairs is None else self.pairs[..., scans, :, :]
        return Scans(self.measurement, self.times[..., scans], self.values[..., scans, :], pairs)

    def together(self) -> MeasurementModel:
        """Return the measurement model of all scans at once, its pairs with a time axis."""
        return self.measurement if self.pairs is None else self.measurement.with_pairs(self.pairs)

    def apart(self) -> Scans:
        """Return every scan by itself: as many targets, of one scan each, in one batch axis."""
        every, pairs = (*self.batch, self.count), self.pairs
        times, values = _apart(self.times, every, 0), _apart(self.values, every, 1)
        return Scans(
            self.measurement, times, values, None if pairs is None else _apart(pairs, every, 2)
        )

    def of_target(self, index: tuple[int, ...]) -> Scans:
        """Return the scans of one target of the batch.

        Parameters
        ----------
        index : tuple of int
            Which one, a number for each batch axis.
        """
        times = np.broadcast_to(self.times, (*self.batch, self.count))[index]
        values = np.broadcast_to(self.values, (*self.batch, *self.values.shape[-2:]))[index]
        pairs = self.pairs
        if pairs is not None and pairs.ndim > 3:
            pairs = np.broadcast_to(pairs, (*self.batch, *pairs.shape[-3:]))[index]
        return Scans(self.measurement, times, values, pairs)


def _apart(a: NDArray[Any], every: tuple[int, ...], trailing: int) -> NDArray[Any]:
    own = a.shape[a.ndim - trailing :]
    return np.broadcast_to(a, (*every, *own)).reshape(-1, 1, *own)


def _fit(name: str, own: tuple[int, ...], values: tuple[int, ...]) -> tuple[int, ...]:
    if own in ((), values):
        return values
    try:
        return np.broadcast_shapes(own, values)
    except ValueError:
        raise ValueError(f"{name}: batch axes {own} do not fit those of values, {values}") from None
