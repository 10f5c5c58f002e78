"""Where emitters and the values of their rows can be at all, and how many values are nobody's."""

from __future__ import annotations

from itertools import combinations

import attrs
import numpy as np

from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.tracking.rows import Unlabelled

FAR = (1e3, 1e4)  # times the spread of the stations: what does not grow between them is bounded
REGION = 20.0  # times the spread of the stations: how wide the emitters are expected to be
SLACK = 8.0  # standard deviations beyond the bounds that a value may lie
MEMORY = 0.1  # weight of the newest scan in the running mean of false values
FEWEST = 0.05  # false values per row and scan that are always allowed for


def bounds(measurement: MeasurementModel, time: float) -> tuple[Array, Array]:
    """Return the least and greatest value (m,) of each row, noise included; infinite if unknown.

    A difference of ranges is at most the distance of its stations, wherever the emitter is, and
    reaches it beyond them on their line. Rows that depend on the velocity have no known bounds.
    """
    d, m = measurement.dims, measurement.size
    s = measurement.anchors(time, np.ones(m, dtype=bool)).reshape(-1, d)
    s = np.unique(s[np.isfinite(s).all(axis=-1)], axis=0)
    low, high = np.full(m, -np.inf), np.full(m, np.inf)
    if len(s) < 2:
        return low, high
    ends = np.array(list(combinations(range(len(s)), 2)))
    along = s[ends[:, 1]] - s[ends[:, 0]]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    spread = float(np.sqrt(np.mean(np.sum((s - s.mean(axis=0)) ** 2, axis=-1))))
    seen = []
    for far in FAR:
        places = np.concatenate(
            [s[ends[:, 0]] - far * spread * along, s[ends[:, 1]] + far * spread * along]
        )
        rows = measurement.predict(places, np.zeros_like(places), time)
        seen.append((rows.min(axis=0), rows.max(axis=0)))
    centre = s.mean(axis=0)
    slope = measurement.jacobian(centre + 0.37 * spread, np.zeros(d), time)[1]
    sigma = np.sqrt(np.diag(measurement.noise_covariance(centre, np.zeros(d), time)))
    (a, b), (c, e) = seen
    with np.errstate(invalid="ignore"):
        still = (np.abs(c - a) + np.abs(e - b) <= 1e-3 * (b - a)) & (e > c) & ~slope.any(axis=-1)
    still &= ~measurement.angular & (measurement.offset_group < 0) & np.isfinite(sigma)
    slack = SLACK * np.where(still, sigma, 0.0)
    return np.where(still, c - slack, low), np.where(still, e + slack, high)


def extent(measurement: MeasurementModel, time: float) -> float:
    """Width of the region in which emitters are expected, m."""
    d = measurement.dims
    s = measurement.anchors(time, np.ones(measurement.size, dtype=bool)).reshape(-1, d)
    s = s[np.isfinite(s).all(axis=-1)]
    spread = float(np.sqrt(np.mean(np.sum((s - s.mean(axis=0)) ** 2, axis=-1)))) if len(s) else 1.0
    return REGION * max(spread, 1.0)


@attrs.frozen(eq=False)
class Clutter:
    """How dense values are that belong to no confirmed target, learnt scan by scan.

    Attributes
    ----------
    count : (m,)
        Running mean of their number per scan.
    span : (m,)
        Width of the range of each row, in its unit: between its bounds, or as far as values
        were seen to reach.
    scans : (m,)
        Scans that had any value of the row.
    """

    count: Array
    span: Array
    scans: Array

    @classmethod
    def none(cls, size: int) -> Clutter:
        """Nothing is known yet."""
        return cls(np.zeros(size), np.zeros(size), np.zeros(size))

    @property
    def density(self) -> Array:
        """Expected number of false values per unit of each row (m,) and scan."""
        result: Array = np.maximum(self.count, FEWEST) / np.where(self.span > 0.0, self.span, 1.0)
        return result

    def seeing(self, scan: Unlabelled, low: Array, high: Array) -> Clutter:
        """Return it with a first guess for rows never heard before: all values are nobody's."""
        count, reach = _of_rows(scan, np.ones(len(scan.values)), len(low))
        bounded = np.isfinite(high - low)
        span = np.where(bounded, high - low, np.maximum(self.span, 2.0 * reach))
        new = (self.scans == 0) & (count > 0)
        return Clutter(np.where(new, count, self.count), span, self.scans)

    def after(self, scan: Unlabelled, unclaimed: Array) -> Clutter:
        """Return it after a scan of which `unclaimed` (K,) says how far values are nobody's."""
        size = len(self.count)
        heard = _of_rows(scan, np.ones(len(scan.values)), size)[0] > 0
        count, _ = _of_rows(scan, unclaimed, size)
        weight = np.maximum(MEMORY, 1.0 / (1.0 + self.scans))
        learnt = self.count + weight * (count - self.count)
        return Clutter(np.where(heard, learnt, self.count), self.span, self.scans + heard)


def _of_rows(scan: Unlabelled, weight: Array, size: int) -> tuple[Array, Array]:
    """Sum of weights (m,) of the values of each row, and the width (m,) they reach over."""
    there: Mask = np.isfinite(scan.values)
    row, value = scan.row[there], scan.values[there]
    count = np.bincount(row, weights=weight[there], minlength=size)[:size]
    low, high = np.full(size, np.inf), np.full(size, -np.inf)
    np.minimum.at(low, row, value)
    np.maximum.at(high, row, value)
    return count.astype(float), np.where(high > low, high - low, 0.0)
