"""Scans as a least-squares problem: residuals, Jacobians and the noise that whitens them.

The unknown theta is the position, or position and velocity at a reference time; scans at other
times see it carried along a straight line. Rows may come from any measurement model. Batches are
flat: there are B fits, and N trial points theta (N, n), of which `fit` (N,) says the fit each
belongs to.
"""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.scans import Scans

ANYWHERE = np.array([0.61803, 1.41421, 2.71828])  # a place that is nobody's station


@attrs.frozen(eq=False)
class Problem:
    """B sets of T scans, each to be explained by one position or one straight motion.

    Attributes
    ----------
    scans : Scans
        Values (B, T, m); times (T,) or (B, T); pairs (T, m, 2), (B, T, m, 2) or None.
    moving : bool
        Whether theta has a velocity, at the last scan's time.
    velocity_std : (d,) or None
        Standard deviation of a zero-mean prior on the velocity, m/s.
    rows : (k,)
        Rows of the measurement model that occur in any scan; the others are cut out.
    z : (B, T, k)
        Their values in internal units.
    present : (B, T, k)
        Which of them count: measured, by stations heard, not repeating others.
    """

    scans: Scans
    moving: bool
    velocity_std: Array | None
    rows: Index
    z: Array
    present: Mask

    @classmethod
    def of(cls, scans: Scans, moving: bool, velocity_std: Array | None) -> Problem:
        """Return the problem that scans with any batch axes pose, the axes made one."""
        T, m = scans.values.shape[-2:]
        values = np.broadcast_to(scans.values, (*scans.batch, T, m)).reshape(-1, T, m)
        times, pairs = scans.times, scans.pairs
        if times.ndim > 1:
            times = np.broadcast_to(times, (*scans.batch, T)).reshape(-1, T)
        if pairs is not None and pairs.ndim > 3:
            pairs = np.broadcast_to(pairs, (*scans.batch, T, m, 2)).reshape(-1, T, m, 2)
        if len(values) == 0:
            raise ValueError("values: expected at least one fix, got a batch of none")
        flat = Scans(scans.measurement, times, values, pairs)
        model, d = flat.together(), scans.measurement.dims
        anywhere = np.broadcast_to(ANYWHERE[:d], (len(values), T, d))
        heard: Mask = np.isfinite(model.predict(anywhere, np.zeros_like(anywhere), times))
        measured: Mask = np.isfinite(values)
        present = np.broadcast_to(model.independent(measured & heard), values.shape)
        rows = np.flatnonzero(present.any(axis=(0, 1)))
        z = (values * scans.measurement.scale)[..., rows]
        return cls(flat, moving, velocity_std, rows, z, present[..., rows])

    @property
    def cut(self) -> Index | slice:
        """Index of `rows`: a slice, which copies nothing, where all are there."""
        whole = len(self.rows) == self.scans.measurement.size
        return slice(None) if whole else self.rows

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return self.scans.measurement.dims

    @property
    def unknowns(self) -> int:
        """Length n of theta."""
        return self.dims * (2 if self.moving else 1)

    def model(self, fit: Index) -> tuple[MeasurementModel, Array]:
        """Return the measurement model with the pairs of each `fit` (N,), and the times."""
        scans = self.scans
        times = scans.times if scans.times.ndim == 1 else scans.times[fit]
        if scans.pairs is None:
            return scans.measurement, times
        pairs = scans.pairs if scans.pairs.ndim == 3 else scans.pairs[fit]
        return scans.measurement.with_pairs(pairs), times

    def part(self, fits: slice) -> Problem:
        """Return the problem of some of the fits."""
        scans = self.scans
        times = scans.times if scans.times.ndim == 1 else scans.times[fits]
        pairs = scans.pairs if scans.pairs is None or scans.pairs.ndim == 3 else scans.pairs[fits]
        scans = Scans(scans.measurement, times, scans.values[fits], pairs)
        return attrs.evolve(self, scans=scans, z=self.z[fits], present=self.present[fits])

    def one_scan(self, scan: Index) -> tuple[MeasurementModel, Array]:
        """Return the model and time (B, 1) of one scan of each fit; (1, 1) where all are alike."""
        scans, B = self.scans, len(self.z)
        alike = scans.times.ndim == 1 and (scans.pairs is None or scans.pairs.ndim == 3)
        fit = np.arange(1 if alike and scans.count == 1 else B)
        times = np.broadcast_to(scans.times, (B, scans.count))[fit, scan[fit]][:, None]
        if scans.pairs is None:
            return scans.measurement, times
        pairs = np.broadcast_to(scans.pairs, (B, *scans.pairs.shape[-3:]))[fit, scan[fit]]
        return scans.measurement.with_pairs(pairs[:, None]), times

    def equations(self) -> Index:
        """Number (B,) of independent rows of each fit."""
        group = self.scans.measurement.offset_group[self.rows]
        return _less_offsets(self.present, group)

    def independent_rows(self, present: Mask) -> Index:
        """Number (...) of independent rows that scans with all rows `present` (..., T, m) have."""
        return _less_offsets(present, self.scans.measurement.offset_group)

    def stations_heard(self) -> tuple[Array, Array]:
        """Centre (B, d) and spread (B,) of the stations that heard something, m."""
        scans, B = self.scans, len(self.z)
        where = scans.together().anchors(scans.times, np.isfinite(scans.values))
        where = where.reshape(B, -1, self.dims)
        known: Mask = np.asarray(np.isfinite(where).all(axis=-1))
        count = np.maximum(np.count_nonzero(known, axis=-1), 1)
        where = np.where(known[..., None], where, 0.0)
        centre = np.sum(where, axis=-2) / count[:, None]
        away = np.where(known[..., None], where - centre[:, None, :], 0.0)
        spread = np.sqrt(np.sum(away**2, axis=(-2, -1)) / count)
        return centre, np.where(spread > 0.0, spread, 1.0)

    def kinematics(self, theta: Array, times: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities (N, T, d) at `times`, and the lever arms (..., T), s."""
        d = self.dims
        lever = times - times[..., -1:]
        place = np.broadcast_to(theta[:, None, :d], (len(theta), lever.shape[-1], d))
        if not self.moving:
            return place, np.zeros_like(place), lever
        speed = np.broadcast_to(theta[:, None, d:], place.shape)
        return place + lever[..., None] * speed, speed, lever


def _less_offsets(present: Mask, group: Index) -> Index:
    """Number (...) of rows `present` (..., T, m), less one per offset that rows of a scan share."""
    count = np.asarray(np.count_nonzero(present, axis=(-2, -1)))
    for g in np.unique(group[group >= 0]):
        shared = np.any(present & (group == g), axis=-1)
        count = count - np.count_nonzero(shared, axis=-1)
    return count


class Whitening(NamedTuple):
    """Matrices W (K, T, k, k) that take raw residuals to uncorrelated ones of unit variance.

    `of` (N,) says which of the K belongs to each trial point. Missing rows and shared offsets
    are gone from what W returns.
    """

    W: Array
    of: Index

    def part(self, which: Index) -> Whitening:
        """Return the matrices of some of the trial points."""
        return Whitening(self.W, self.of[which])

    def __matmul__(self, rows: Array) -> Array:
        """Return W @ rows for rows (N, T, k, j)."""
        W = self.W if len(self.W) == 1 else self.W[self.of]
        result: Array = W @ rows
        return result


def residuals(problem: Problem, theta: Array, fit: Index) -> tuple[Array, Array]:
    """Return raw residuals nu (N, T, k), zero where missing, and d prediction / d theta."""
    model, times = problem.model(fit)
    place, speed, lever = problem.kinematics(theta, times)
    rows, present = problem.cut, problem.present[fit]
    Hp, Hv = (H[..., rows, :] for H in model.jacobian(place, speed, times))
    if problem.moving:
        Hp = np.concatenate([Hp, Hv + lever[..., None, None] * Hp], axis=-1)
    return misfits(problem, theta, fit), np.where(present[..., None], Hp, 0.0)


def misfits(problem: Problem, theta: Array, fit: Index) -> Array:
    """Return raw residuals nu (N, T, k), zero where missing."""
    model, times = problem.model(fit)
    place, speed, _ = problem.kinematics(theta, times)
    rows = problem.cut
    nu = problem.z[fit] - model.predict(place, speed, times)[..., rows]
    angular = problem.scans.measurement.angular[rows]
    if np.any(angular):
        nu = np.where(angular, gaussian.wrap(nu), nu)
    return np.where(problem.present[fit], nu, 0.0)


def noise(problem: Problem, theta: Array, fit: Index) -> Array:
    """Return the noise covariance R at theta: (k, k), (T, k, k) or (N, T, k, k)."""
    model, times = problem.model(fit)
    place, speed, _ = problem.kinematics(theta, times)
    R = model.noise_covariance(place, speed, times)
    return R[..., problem.rows[:, None], problem.rows]


def whitening(problem: Problem, R: Array, fit: Index, weight: Array | None = None) -> Whitening:
    """Return the whitening for noise R at trial points of `fit`.

    `weight` (N, T, k) scales precisions. Where R is the same for all and nothing is missing, one
    matrix serves all trial points.
    """
    N, T, k = len(fit), problem.scans.count, len(problem.rows)
    if weight is not None:
        root = np.sqrt(weight)
        R = R / (root[..., :, None] * root[..., None, :])
    if R.ndim == 4:
        present, of = problem.present[fit], np.arange(N)
    elif np.all(problem.present == problem.present[:1]):
        present, of = problem.present[:1], np.zeros(N, dtype=np.int64)
    else:
        present, of = problem.present, fit
    R = np.broadcast_to(R, (len(present), T, k, k))
    group = problem.scans.measurement.offset_group[problem.rows]
    both = present[..., :, None] & present[..., None, :]
    C, left = gaussian.offset_contrast(np.einsum("...ii->...i", R), present, group)
    R = C @ np.where(both, R, 0.0) @ np.swapaxes(C, -1, -2)
    R = np.where(left[..., :, None] & left[..., None, :], R, np.eye(k))
    inverse = np.linalg.inv(gaussian.factor(R, "noise covariance"))
    return Whitening(np.where(left[..., None], inverse @ C, 0.0), of)


def standardised(problem: Problem, nu: Array, R: Array, fit: Index, weight: Array | None) -> Array:
    """Residuals (N, T, k) over their own standard deviations, shared offsets taken out.

    An offset is estimated as the mean of its rows, each weighted by its precision and `weight`.
    """
    present = problem.present[fit]
    variance = np.broadcast_to(np.einsum("...ii->...i", R), nu.shape)
    precision = np.where(present, (1.0 if weight is None else weight) / variance, 0.0)
    group = problem.scans.measurement.offset_group[problem.rows]
    for g in np.unique(group[group >= 0]):
        w = np.where(group == g, precision, 0.0)
        total = np.sum(w, axis=-1, keepdims=True)
        offset = np.sum(w * nu, axis=-1, keepdims=True) / np.where(total > 0.0, total, 1.0)
        nu = nu - np.where(group == g, offset, 0.0)
    result: Array = np.where(present, nu / np.sqrt(variance), 0.0)
    return result
