"""Means, variances and covariances of runs that come in chunks, without keeping the runs."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array


@attrs.frozen(eq=False)
class Moments:
    """Sample moments of one quantity, NaN left out.

    Merging two gives what one sample of both would (Pebay, Sandia report SAND2008-6212); the
    order of merging decides the last bits, so merge in the order of the runs.

    Attributes
    ----------
    count, mean : (...)
        Size and mean; the mean of nothing is 0.
    second, third : (...)
        Sums of squared and cubed distances from the mean.
    """

    count: Array
    mean: Array
    second: Array
    third: Array

    @classmethod
    def of(cls, values: Any) -> Moments:
        """Return the moments of `values` (..., n) over their last axis."""
        x = np.asarray(values, dtype=float)
        known = ~np.isnan(x)
        count = np.count_nonzero(known, axis=-1).astype(float)
        mean = np.sum(np.where(known, x, 0.0), axis=-1) / np.maximum(count, 1.0)
        off = np.where(known, x - mean[..., None], 0.0)
        return cls(count, mean, np.sum(off**2, axis=-1), np.sum(off**3, axis=-1))

    def merged(self, other: Moments) -> Moments:
        """Return the moments of both samples together."""
        na, nb = self.count, other.count
        n = np.maximum(na + nb, 1.0)
        d = other.mean - self.mean
        second = self.second + other.second + d**2 * na * nb / n
        third = (
            self.third
            + other.third
            + d**3 * na * nb * (na - nb) / n**2
            + 3.0 * d * (na * other.second - nb * self.second) / n
        )
        return Moments(na + nb, self.mean + d * nb / n, second, third)

    @property
    def average(self) -> Array:
        """Mean (...), NaN where there is no sample."""
        return np.where(self.count > 0, self.mean, np.nan)

    @property
    def variance(self) -> Array:
        """Variance (...) dividing by count - 1, NaN for fewer than two."""
        return np.where(self.count > 1, self.second / np.maximum(self.count - 1.0, 1.0), np.nan)

    @property
    def skewness(self) -> Array:
        """Adjusted Fisher-Pearson skewness (...), NaN for fewer than three or no spread."""
        n = np.where(self.count > 2, self.count, np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            g = (self.third / n) / (self.second / n) ** 1.5
            return np.asarray(g * np.sqrt(n * (n - 1.0)) / (n - 2.0))

    @property
    def effective(self) -> Array:
        """How many equal runs would carry as much (...): (sum x)^2 / sum x^2.

        Of squared errors: few where a handful of runs make up most of their sum.
        """
        n = self.count
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray((n * self.mean) ** 2 / (self.second + n * self.mean**2))


@attrs.frozen(eq=False)
class Joint:
    """Moments of two quantities over the runs in which both are known.

    Attributes
    ----------
    count, mean_x, mean_y : (...)
        Size and means.
    xx, yy, xy : (...)
        Sums of products of the distances from the means.
    """

    count: Array
    mean_x: Array
    mean_y: Array
    xx: Array
    yy: Array
    xy: Array

    @classmethod
    def of(cls, x: Any, y: Any) -> Joint:
        """Return the joint moments of `x` and `y` (..., n) over their last axis."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        known = ~(np.isnan(x) | np.isnan(y))
        count = np.count_nonzero(known, axis=-1).astype(float)
        mean_x, mean_y = (
            np.sum(np.where(known, v, 0.0), axis=-1) / np.maximum(count, 1.0) for v in (x, y)
        )
        u = np.where(known, x - mean_x[..., None], 0.0)
        v = np.where(known, y - mean_y[..., None], 0.0)
        sums = (np.sum(w, axis=-1) for w in (u * u, v * v, u * v))
        return cls(count, mean_x, mean_y, *sums)

    @classmethod
    def pairs(cls, values: Any) -> Joint:
        """Return the joint moments (B, B) of every two rows of `values` (B, n)."""
        x = np.asarray(values, dtype=float)
        return cls.of(x[:, None], x[None, :])

    def merged(self, other: Joint) -> Joint:
        """Return the moments of both samples together."""
        na, nb = self.count, other.count
        n = np.maximum(na + nb, 1.0)
        dx, dy = other.mean_x - self.mean_x, other.mean_y - self.mean_y
        weight = na * nb / n
        return Joint(
            na + nb,
            self.mean_x + dx * nb / n,
            self.mean_y + dy * nb / n,
            self.xx + other.xx + dx**2 * weight,
            self.yy + other.yy + dy**2 * weight,
            self.xy + other.xy + dx * dy * weight,
        )

    def _per_dof(self, total: Array) -> Array:
        return np.where(self.count > 1, total / np.maximum(self.count - 1.0, 1.0), np.nan)

    @property
    def mean(self) -> tuple[Array, Array]:
        """Both means (...), NaN where there is no sample."""
        known = self.count > 0
        return np.where(known, self.mean_x, np.nan), np.where(known, self.mean_y, np.nan)

    @property
    def variance(self) -> tuple[Array, Array]:
        """Both variances (...)."""
        return self._per_dof(self.xx), self._per_dof(self.yy)

    @property
    def covariance(self) -> Array:
        """Covariance (...)."""
        return self._per_dof(self.xy)

    @property
    def difference_variance(self) -> Array:
        """Variance (...) of x - y."""
        return self._per_dof(np.maximum(self.xx + self.yy - 2.0 * self.xy, 0.0))
