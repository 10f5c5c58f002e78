"""One scan as the filter sees it: innovations, Jacobians and noise of the rows that count."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

from imm_tdoa import gaussian, mixture, sigma_points
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel


@attrs.frozen(eq=False)
class Observation:
    """A scan against several predicted states (the modes of a bank).

    Attributes
    ----------
    nu : tuple of (..., m)
        Innovation per mode, internal units, angular rows wrapped.
    H : tuple of (..., m, n_j)
        Jacobian per mode in the mode's own state.
    R : tuple of (..., m, m)
        Noise covariance per mode.
    present : (..., m)
        Rows that count, the same in every mode: likelihoods of different rows do not compare.
    group : (m,)
        Offset group of each row; -1: none.
    directions, source_variance : (..., m, k), (..., k), optional
        How independent errors enter the rows, and their variances (`error_sources`).
    """

    nu: tuple[Array, ...]
    H: tuple[Array, ...]
    R: tuple[Array, ...]
    present: Mask
    group: Index
    directions: Array | None = None
    source_variance: Array | None = None


def observe(
    measurement: MeasurementModel,
    x: Sequence[Array],
    position: Sequence[Index],
    velocity: Sequence[Index],
    time: float | Array,
    values: Array,
    P: Sequence[Array] | None = None,
    rule: sigma_points.Rule | None = None,
) -> Observation:
    """Compare `values` (..., m) at `time` with what each mode's state `x` (..., n_j) predicts.

    Rows that are NaN throughout the batch, or cannot be measured then, are cut out. With a `rule`
    the measurement is linearised over the sigma points of N(x, `P`), what the line misses being
    noise; without one at `x`.
    """
    z = values * measurement.scale
    rows = usable_rows(z)
    z, angular = z[..., rows], measurement.angular[rows]
    nus, Hs, Rs = [], [], []
    present: Mask = np.isfinite(z)
    for j, (mean, p, v) in enumerate(zip(x, position, velocity, strict=True)):
        place, speed = kinematics(mean, p, v)
        R = measurement.noise_covariance(place, speed, time)[..., rows[:, None], rows]
        if rule is None or P is None:
            h = measurement.predict(place, speed, time)[..., rows]
            Hp, Hv = measurement.jacobian(place, speed, time)
            H = np.zeros((*h.shape, mean.shape[-1]))
            H[..., p] = Hp[..., rows, :]
            if len(v):
                H[..., v] = Hv[..., rows, :]
        else:
            h, H, rest = _over_points(measurement, mean, P[j], p, v, time, rows, rule)
            R = R + rest
        constants = getattr(measurement, "constant_errors", None)
        if constants is not None:  # the state's last components, which enter the rows linearly
            A = constants(place, speed, time)[..., rows, :]
            k = A.shape[-1]
            H[..., -k:] += A
            h = h + np.einsum("...ij,...j->...i", A, mean[..., -k:])
        nu = z - h
        nus.append(np.where(angular, gaussian.wrap(nu), nu))
        Hs.append(H)
        Rs.append(R)
        present = present & np.isfinite(nu)
    every = np.zeros((*present.shape[:-1], measurement.size), dtype=bool)
    every[..., rows] = present
    present = measurement.independent(every)[..., rows]
    return Observation(tuple(nus), tuple(Hs), tuple(Rs), present, measurement.offset_group[rows])


def with_sources(
    seen: Observation,
    measurement: MeasurementModel,
    x: Array,
    position: Index,
    velocity: Index,
    time: float | Array,
    values: Array,
) -> Observation:
    """Return `seen` with the sources of error of its rows, at the state `x` (..., n)."""
    D, variance = measurement.error_sources(*kinematics(x, position, velocity), time)
    rows = usable_rows(values)
    return attrs.evolve(seen, directions=D[..., rows, :], source_variance=variance)


def kinematics(x: Array, position: Index, velocity: Index) -> tuple[Array, Array]:
    """Position and velocity (..., d) in states (..., n); a mode without velocity stands still."""
    place = x[..., position]
    return place, x[..., velocity] if len(velocity) else np.zeros_like(place)


def predict_each(
    measurement: MeasurementModel, position: Array, velocity: Array, time: float | Array
) -> Array:
    """Predicted rows (..., k, m) at several places (..., k, d) of each target at its own time."""
    k = position.shape[-2]
    each = [measurement.predict(position[..., i, :], velocity[..., i, :], time) for i in range(k)]
    return np.stack(each, axis=-2)


def _over_points(
    measurement: MeasurementModel,
    x: Array,
    P: Array,
    position: Index,
    velocity: Index,
    time: float | Array,
    rows: Index,
    rule: sigma_points.Rule,
) -> tuple[Array, Array, Array]:
    """Mean, slope and remaining covariance of the rows over N(x, P); NaN where not measured."""
    angular = measurement.angular[rows]

    def rows_at(states: Array) -> Array:
        return predict_each(measurement, *kinematics(states, position, velocity), time)[..., rows]

    def apart(a: Array, b: Array) -> Array:
        away = a - b
        return np.where(angular, gaussian.wrap(away), away)

    here = np.isfinite(rows_at(x[..., None, :]))
    line = sigma_points.fit(lambda s: np.where(here, rows_at(s), 0.0), x, P, rule, apart)
    return np.where(here[..., 0, :], line.y, np.nan), line.H, line.rest


def usable_rows(values: Array) -> Index:
    """Indices of the rows of `values` (..., m) that are measured anywhere in the batch."""
    return np.flatnonzero(np.isfinite(values).reshape(-1, values.shape[-1]).any(axis=0))


def without_offsets(seen: Observation) -> Observation:
    """Eliminate shared offsets, with the same reference rows in every mode."""
    if np.all(seen.group < 0):
        return seen
    variance = np.einsum("...ii->...i", seen.R[0])
    T, present = gaussian.offset_contrast(variance, seen.present, seen.group)
    return attrs.evolve(combined(seen, T, present), group=np.full_like(seen.group, -1))


def combined(seen: Observation, T: Array, present: Mask) -> Observation:
    """Return the observation of the combinations `T` (..., m, m) of its present rows."""
    both = seen.present[..., :, None] & seen.present[..., None, :]
    Tt = np.swapaxes(T, -1, -2)
    return attrs.evolve(
        seen,
        nu=tuple(
            np.einsum("...ij,...j->...i", T, np.where(seen.present, nu, 0.0)) for nu in seen.nu
        ),
        H=tuple(T @ np.where(seen.present[..., None], H, 0.0) for H in seen.H),
        R=tuple(gaussian.symmetric(T @ np.where(both, R, 0.0) @ Tt) for R in seen.R),
        directions=None
        if seen.directions is None
        else T @ np.where(seen.present[..., None], seen.directions, 0.0),
        present=present,
    )


def mixture_innovation(seen: Observation, weight: Array, P: Sequence[Array]) -> tuple[Array, Array]:
    """Mean (..., m) and covariance (..., m, m) of the innovation of the whole bank.

    `weight` (..., r) are the predicted mode probabilities; missing rows are neutral.
    """
    nus, Ss = [], []
    for nu, H, R, cov in zip(seen.nu, seen.H, seen.R, P, strict=True):
        nu, H, R = gaussian.mask_rows(nu, H, R, seen.present)
        nus.append(nu)
        Ss.append(H @ cov @ np.swapaxes(H, -1, -2) + R)
    return mixture.moments(weight, np.stack(nus, axis=-2), np.stack(Ss, axis=-3))
