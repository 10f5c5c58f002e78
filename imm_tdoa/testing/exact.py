"""The exact posterior of a small problem, by enumeration of all mode histories (ALGORITHMS §9.4).

Given which mode was in force at every scan, a bank is one linear Gaussian model: a Kalman filter
and a Rauch-Tung-Striebel smoother are exact for it. There are r^(T+1) such histories of T scans
(the mode at the start included); weighed by their probability and evidence they are the exact
answer that an IMM approximates. An oracle for tests, written without the IMM's mixing:

>>> oracle = exact_posterior(bank, measurement, imm.start(0.0, mean, covariance), times, values)
>>> oracle.filtered.log_mode_probability, oracle.smoothed.mean, oracle.log_likelihood
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa import _validate, gaussian, mixture
from imm_tdoa.bank import Bank
from imm_tdoa.contract import AXES, Array, Index, MeasurementModel, component_names
from imm_tdoa.state import State

LIMIT = 200_000
SINGULAR = 1e-13  # eigenvalue of a correlation matrix that counts as none, of the largest


@attrs.frozen(eq=False)
class Estimate:
    """What is known at each time.

    Attributes
    ----------
    mean, covariance : (..., T, n), (..., T, n, n)
        Of all the bank's components; a mode without a component says that it is zero, as in a
        `Track`.
    log_mode_probability : (..., T, r)
        Logs of the mode probabilities; -inf is legal.
    """

    mean: Array
    covariance: Array
    log_mode_probability: Array

    @property
    def mode_probability(self) -> Array:
        """Mode probabilities (..., T, r)."""
        result: Array = np.exp(self.log_mode_probability)
        return result


@attrs.frozen(eq=False)
class ExactPosterior:
    """The exact posterior at T scans; made by `exact_posterior`.

    Attributes
    ----------
    times : (T,) or (..., T)
        Times of the scans, s.
    filtered : Estimate
        Given the scans so far.
    smoothed : Estimate
        Given all scans.
    log_likelihood : (..., T)
        Cumulative log-evidence, internal units (metres), that of the start included.
    components, modes : tuple of str
        Names of the state's components and of the modes.
    """

    times: Array
    filtered: Estimate
    smoothed: Estimate
    log_likelihood: Array
    components: tuple[str, ...]
    modes: tuple[str, ...]


class _Layer(NamedTuple):
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


def exact_posterior(
    bank: Bank,
    measurement: MeasurementModel,
    start: State,
    times: Any,
    values: Any,
    *,
    limit: int = LIMIT,
) -> ExactPosterior:
    """Enumerate every history of modes; each is filtered and smoothed on its own.

    Exact where motion and measurement are linear; elsewhere each history is linearised at its own
    estimate (extended Kalman filter).

    Parameters
    ----------
    bank : Bank
        The modes, their chain and birth law.
    measurement : MeasurementModel
        What is measured.
    start : State
        As `IMM.start` makes it: before the first scan, each mode with its own Gaussian.
    times : (T,) or (..., T)
        Times of the scans, s, not decreasing.
    values : (..., T, m)
        Rows of each scan; NaN is missing.
    limit : int
        Most histories to enumerate, those of all targets of a batch together.

    Raises
    ------
    ValueError
        Too many histories; a bank whose mixing rule is not a law of the emitter ("unbiased"
        among unequal states); decreasing times; shapes that do not fit.

    Notes
    -----
    Histories live in the union of the modes' components, zero without variance where a mode has
    no such component. A switch keeps what both modes have and draws the rest from the birth law,
    so from one scan to the next the state is M x + w with w ~ N(0, Q + F B F'), and smoothing
    regresses what a switch discards without any rule of its own.
    """
    z = _validate.array("values", values, (None, "T", measurement.size), finite=False)
    t = _validate.array("times", times, (None, z.shape[-2]))
    T, r = z.shape[-2], len(bank)
    space = bank.space(measurement.dims)
    if T == 0:
        raise ValueError("times: expected at least one scan, got none")
    if not isinstance(start, State) or start.space.modes != space.modes:
        raise ValueError("start: expected a state of this bank's modes, as IMM.start makes it")
    if bank.mixing == "unbiased" and any(m != space.modes[0] for m in space.modes):
        raise ValueError(
            "bank: mixing 'unbiased' takes what a mode lacks from another mode's estimate, which "
            "is no law of the emitter and has no exact posterior; use 'birth' or 'zero'"
        )
    batch = np.broadcast_shapes(start.log_likelihood.shape, z.shape[:-2], t.shape[:-1])
    B = int(np.prod(batch))
    if B * r ** (T + 1) > limit:
        many = f"{B} x " if B > 1 else ""
        raise ValueError(
            f"times: {r} modes over {T} scans have {many}{r}^{T + 1} = {B * r ** (T + 1)} "
            f"histories, expected at most {limit}"
        )
    clock = np.concatenate([_flat(start.time, batch, 0)[:, None], _flat(t, batch, 1)], axis=1)
    dt = np.diff(clock, axis=1)
    if np.any(dt < 0.0):
        raise ValueError("times: expected times that do not decrease, from the start's on")
    steps = _Steps(bank, measurement)
    layers = [steps.root(start, batch)]
    for k, scan in enumerate(np.moveaxis(_flat(z, batch, 2), 1, 0)):
        layers.append(steps.grow(layers[-1], dt[:, k], clock[:, k + 1], scan))
    log_L = np.stack([_log_sum(layer.log_weight) for layer in layers], axis=1)
    log_L = _flat(start.log_likelihood, batch, 0)[:, None] + log_L[:, 1:] - log_L[:, :1]
    filtered = [_estimate(layer.x, layer.P, layer.log_weight, r, 1) for layer in layers[1:]]
    return ExactPosterior(
        times=t,
        filtered=_stacked(filtered, batch),
        smoothed=_stacked(_smoothed(layers, r), batch),
        log_likelihood=log_L.reshape(*batch, T),
        components=space.components,
        modes=bank.names,
    )


class _Steps:
    """One step of every history, in the union of the modes' components."""

    def __init__(self, bank: Bank, measurement: MeasurementModel) -> None:
        space = bank.space(measurement.dims)
        self.bank, self.measurement, self.space = bank, measurement, space
        self.position = _indices(space.components, AXES[: space.dims])
        speed = component_names(space.dims, 1)[space.dims :]
        self.velocity = _indices(space.components, speed if speed[0] in space.components else ())
        self.own = [_indices(space.components, mode) for mode in space.modes]

    def root(self, start: State, batch: tuple[int, ...]) -> _Layer:
        """Return the histories before the first scan: one per mode."""
        r, n = len(self.bank), len(self.space.components)
        B = int(np.prod(batch))
        x, P = np.zeros((B, r, n)), np.zeros((B, r, n, n))
        for j, own in enumerate(self.own):
            x[:, j, own] = _flat(start.means[j], batch, 1)
            P[:, j, own[:, None], own] = _flat(start.covariances[j], batch, 2)
        log_weight = _flat(start.log_mode_probability, batch, 1)
        return _Layer(x, P, log_weight, x, P, np.zeros_like(P))

    def grow(self, layer: _Layer, dt: Array, time: Array, z: Array) -> _Layer:
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
        return _Layer(after.x, after.P, weight, x, P, gain)

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


def _smoothed(layers: Sequence[_Layer], r: int) -> list[Estimate]:
    """Rauch-Tung-Striebel along every complete history, and their mixture at each scan."""
    log_weight = layers[-1].log_weight
    B, leaves = log_weight.shape
    x, P = layers[-1].x, layers[-1].P
    result = [_estimate(x, P, log_weight, r, 1)]
    for here, later in zip(layers[-2:0:-1], layers[:1:-1], strict=True):
        n, nodes = x.shape[-1], later.x.shape[1]
        C = later.gain[:, :, None]
        x = x.reshape(B, nodes, -1, n) - later.x_before[:, :, None]
        P = P.reshape(B, nodes, -1, n, n) - later.P_before[:, :, None]
        x = np.repeat(here.x, r, axis=1)[:, :, None] + np.einsum("...ij,...j->...i", C, x)
        P = np.repeat(here.P, r, axis=1)[:, :, None] + C @ P @ np.swapaxes(C, -1, -2)
        x, P = x.reshape(B, leaves, n), gaussian.symmetric(P).reshape(B, leaves, n, n)
        result.append(_estimate(x, P, log_weight, r, leaves // here.x.shape[1]))
    return result[::-1]


def _estimate(x: Array, P: Array, log_weight: Array, r: int, later: int) -> Estimate:
    """Mixture of histories whose mode at this scan is digit ``h // later % r`` of their number."""
    log_w, _ = mixture.normalise(log_weight)
    mean, covariance = mixture.moments(np.exp(log_w), x, P)
    by_mode = log_w.reshape(len(log_w), -1, r, later)
    log_p = _log_sum(np.moveaxis(by_mode, 2, 1).reshape(len(log_w), r, -1))
    return Estimate(mean, covariance, log_p)


def _stacked(estimates: Sequence[Estimate], batch: tuple[int, ...]) -> Estimate:
    def stacked(arrays: Sequence[Array]) -> Array:
        full = np.stack(arrays, axis=1)
        return full.reshape(*batch, *full.shape[1:])

    return Estimate(
        stacked([e.mean for e in estimates]),
        stacked([e.covariance for e in estimates]),
        stacked([e.log_mode_probability for e in estimates]),
    )


def _pseudo_inverse(P: Array) -> Array:
    """Inverse on the regular subspace of P (..., n, n), judged by its correlations."""
    variance = np.einsum("...ii->...i", P)
    sd = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    scale = sd[..., :, None] * sd[..., None, :]
    result: Array = np.linalg.pinv(P / scale, rcond=SINGULAR, hermitian=True) / scale
    return result


def _log_sum(log_weight: Array) -> Array:
    return mixture.normalise(log_weight)[1]


def _flat(a: Array, batch: tuple[int, ...], trailing: int) -> Array:
    """Return `a` (..., own axes) with its batch axes broadcast to `batch` and made one."""
    own = a.shape[a.ndim - trailing :]
    return np.broadcast_to(a, (*batch, *own)).reshape(-1, *own)


def _indices(components: Sequence[str], wanted: Sequence[str]) -> Index:
    return np.array([components.index(c) for c in wanted], dtype=np.int64)
