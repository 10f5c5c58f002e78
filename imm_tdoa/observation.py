"""One scan as the filter sees it: innovations, Jacobians and noise of the rows that count."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

from imm_tdoa import gaussian, mixture
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
    """

    nu: tuple[Array, ...]
    H: tuple[Array, ...]
    R: tuple[Array, ...]
    present: Mask
    group: Index


def observe(
    measurement: MeasurementModel,
    x: Sequence[Array],
    position: Sequence[Index],
    velocity: Sequence[Index],
    time: float | Array,
    values: Array,
) -> Observation:
    """Compare `values` (..., m) at `time` with what each mode's state `x` (..., n_j) predicts.

    Rows that are NaN throughout the batch, or cannot be measured then, are cut out.
    """
    z = values * measurement.scale
    rows = usable_rows(z)
    z, angular = z[..., rows], measurement.angular[rows]
    nus, Hs, Rs = [], [], []
    present: Mask = np.isfinite(z)
    for mean, p, v in zip(x, position, velocity, strict=True):
        place = mean[..., p]
        speed = mean[..., v] if len(v) else np.zeros_like(place)
        nu = z - measurement.predict(place, speed, time)[..., rows]
        Hp, Hv = measurement.jacobian(place, speed, time)
        H = np.zeros((*nu.shape, mean.shape[-1]))
        H[..., p] = Hp[..., rows, :]
        if len(v):
            H[..., v] = Hv[..., rows, :]
        R = measurement.noise_covariance(place, speed, time)
        nus.append(np.where(angular, gaussian.wrap(nu), nu))
        Hs.append(H)
        Rs.append(R[..., rows[:, None], rows])
        present = present & np.isfinite(nu)
    every = np.zeros((*present.shape[:-1], measurement.size), dtype=bool)
    every[..., rows] = present
    present = measurement.independent(every)[..., rows]
    return Observation(tuple(nus), tuple(Hs), tuple(Rs), present, measurement.offset_group[rows])


def usable_rows(values: Array) -> Index:
    """Indices of the rows of `values` (..., m) that are measured anywhere in the batch."""
    return np.flatnonzero(np.isfinite(values).reshape(-1, values.shape[-1]).any(axis=0))


def without_offsets(seen: Observation) -> Observation:
    """Eliminate shared offsets, with the same reference rows in every mode."""
    if np.all(seen.group < 0):
        return seen
    both = seen.present[..., :, None] & seen.present[..., None, :]
    variance = np.einsum("...ii->...i", seen.R[0])
    T, present = gaussian.offset_contrast(variance, seen.present, seen.group)
    Tt = np.swapaxes(T, -1, -2)
    return Observation(
        nu=tuple(
            np.einsum("...ij,...j->...i", T, np.where(seen.present, nu, 0.0)) for nu in seen.nu
        ),
        H=tuple(T @ np.where(seen.present[..., None], H, 0.0) for H in seen.H),
        R=tuple(gaussian.symmetric(T @ np.where(both, R, 0.0) @ Tt) for R in seen.R),
        present=present,
        group=np.full_like(seen.group, -1),
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


def gated(seen: Observation, weight: Array, P: Sequence[Array], threshold: float) -> Observation:
    """Drop the rows that contradict the bank's prediction and each other (`gaussian.snoop`)."""
    nu, S = mixture_innovation(seen, weight, P)
    present = gaussian.snoop(nu, S, seen.present, seen.group, threshold)
    return attrs.evolve(seen, present=present)


def dropped_log_density(
    seen: Observation, kept: Observation, weight: Array, P: Sequence[Array], threshold: float
) -> Array:
    """Log-density (...) of the rows dropped from `seen`, as if they lay on the gate.

    Given the rows kept, k dropped rows of covariance C count as -(k (threshold + log 2 pi) +
    log det C)/2, so that likelihoods of filters that drop different rows compare: dropping good
    rows does not pay. log det C is the difference of the log-determinants of all rows and of
    those kept, shared offsets eliminated from both.
    """

    def size(part: Observation) -> tuple[Array, Array]:
        part = without_offsets(part)
        _, S = mixture_innovation(part, weight, P)
        diagonal = np.einsum("...ii->...i", gaussian.factor(S))
        return 2.0 * np.sum(np.log(diagonal), axis=-1), np.count_nonzero(part.present, axis=-1)

    (log_det, rows), (log_det_kept, rows_kept) = size(seen), size(kept)
    price = (rows - rows_kept) * (threshold + gaussian.LOG_2PI)
    return np.asarray(-0.5 * (price + log_det - log_det_kept))
