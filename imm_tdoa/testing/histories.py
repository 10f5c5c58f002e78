"""Histories of modes, each with its own Gaussian, grown by one scan after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.bank import Bank
from imm_tdoa.contract import AXES, Array, Index, MeasurementModel, component_names
from imm_tdoa.state import State

SINGULAR = 1e-13  # eigenvalue of a correlation matrix that counts as none, of the largest


class Layer(NamedTuple):
    """All histories up to one scan, h = r^(k+1), the latest mode fastest, in a flat batch B.

    Mean x (B, h, n), covariance P and log weight (B, h); and how they came from the layer
    before: predicted mean, predicted covariance and smoother gain.
    """

    x: Array
    P: Array
    log_weight: Array
    x_before: Array
    P_before: Array
    gain: Array


class Steps:
    """One step of every history, in the union of the modes' components."""

    def __init__(self, bank: Bank, measurement: MeasurementModel) -> None:
        space = bank.space(measurement.dims)
        self.bank, self.measurement, self.space = bank, measurement, space
        self.position = _indices(space.components, AXES[: space.dims])
        speed = component_names(space.dims, 1)[space.dims :]
        self.velocity = _indices(space.components, speed if speed[0] in space.components else ())
        self.own = [_indices(space.components, mode) for mode in space.modes]

    def root(self, start: State, batch: tuple[int, ...]) -> Layer:
        """Return the histories before the first scan: one per mode."""
        r, n = len(self.bank), len(self.space.components)
        B = int(np.prod(batch))
        x, P = np.zeros((B, r, n)), np.zeros((B, r, n, n))
        for j, own in enumerate(self.own):
            x[:, j, own] = flat(start.means[j], batch, 1)
            P[:, j, own[:, None], own] = flat(start.covariances[j], batch, 2)
        log_weight = flat(start.log_mode_probability, batch, 1)
        return Layer(x, P, log_weight, x, P, np.zeros_like(P))

    def grow(self, layer: Layer, dt: Array, time: Array, z: Array) -> Layer:
        """Let every history go on in every mode for `dt` (B,) s and take in the scan z (B, m)."""
        r, (B, h, n) = len(self.bank), layer.x.shape
        moved = np.empty((B, h, r, n)), np.empty((B, h, r, n, n)), np.empty((B, h, r, n, n))
        for i in range(r):
            for j in range(r):
                of = (slice(None), slice(i, None, r), j)
                parts = self._move(layer.x[:, i::r], layer.P[:, i::r], i, j, dt)
                for array, part in zip(moved, parts, strict=True):
                    array[of] = part
        with np.errstate(divide="ignore"):
            chain = np.log(self.bank.chain(dt))
        log_weight = layer.log_weight.reshape(B, h // r, r, 1) + chain[:, None]
        x, P, cross = (a.reshape(B, h * r, *a.shape[3:]) for a in moved)
        gain = cross @ _pseudo_inverse(P)
        after = self._update(x, P, time[:, None], z[:, None])
        weight = log_weight.reshape(B, h * r) + after.log_likelihood
        return Layer(after.x, after.P, weight, x, P, gain)

    def _move(self, x: Array, P: Array, i: int, j: int, dt: Array) -> tuple[Array, Array, Array]:
        """Predict x (B, g, n), P from mode i to mode j; with the cross covariance P M'."""
        model, n, own = self.bank.models[j], x.shape[-1], self.own[j]
        A, E = np.eye(n)[own], np.eye(n)[:, own]
        born = ~np.isin(own, self.own[i])
        A[born] = 0.0
        birth = np.zeros(len(own))
        if self.bank.mixing == "birth":
            lift = self.space.lifts[i][j]
            birth[lift.missing] = lift.birth_variance
        y, step = x @ A.T, dt[:, None]
        F, Q = model.jacobian(y, step), model.process_noise(step, self.space.dims)
        M = E @ F @ A
        noise = E @ (F @ np.diag(birth) @ np.swapaxes(F, -1, -2) + Q) @ E.T
        cross = P @ np.swapaxes(M, -1, -2)
        return model.propagate(y, step) @ E.T, gaussian.symmetric(M @ cross + noise), cross

    def _update(self, x: Array, P: Array, time: Array, z: Array) -> gaussian.Update:
        model, p, v = self.measurement, self.position, self.velocity
        place = x[..., p]
        speed = x[..., v] if len(v) else np.zeros_like(place)
        nu = z * model.scale - model.predict(place, speed, time)
        nu = np.where(model.angular, gaussian.wrap(nu), nu)
        H = np.zeros((*nu.shape, x.shape[-1]))
        Hp, Hv = model.jacobian(place, speed, time)
        H[..., p] = Hp
        if len(v):
            H[..., v] = Hv
        R = model.noise_covariance(place, speed, time)
        present = model.independent(np.isfinite(nu))
        nu, H, R = gaussian.mask_rows(nu, H, R, present)
        variance = np.einsum("...ii->...i", R)
        D, present = gaussian.offset_contrast(variance, present, model.offset_group)
        nu = np.einsum("...ij,...j->...i", D, nu)
        return gaussian.update(x, P, nu, D @ H, D @ R @ np.swapaxes(D, -1, -2), present)


def _pseudo_inverse(P: Array) -> Array:
    """Inverse on the regular subspace of P (..., n, n), judged by its correlations."""
    variance = np.einsum("...ii->...i", P)
    sd = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    scale = sd[..., :, None] * sd[..., None, :]
    result: Array = np.linalg.pinv(P / scale, rcond=SINGULAR, hermitian=True) / scale
    return result


def flat(a: Array, batch: tuple[int, ...], trailing: int) -> Array:
    """Return `a` (..., own axes) with its batch axes broadcast to `batch` and made one."""
    own = a.shape[a.ndim - trailing :]
    return np.broadcast_to(a, (*batch, *own)).reshape(-1, *own)


def _indices(components: Sequence[str], wanted: Sequence[str]) -> Index:
    return np.array([components.index(c) for c in wanted], dtype=np.int64)
