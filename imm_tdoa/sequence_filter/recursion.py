"""The loop of the sequence filter over time: filter, decide, locate, feed back (§6.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.scans import Scans
from imm_tdoa.sequence_filter import scalar, warm
from imm_tdoa.sequence_filter.filtered import FilteredSequence
from imm_tdoa.sequence_filter.loop_gain import process_noise
from imm_tdoa.sequence_filter.response import Response, exact, multiplier, weighing

if TYPE_CHECKING:
    from imm_tdoa.sequence_filter.stage import SequenceFilter


class Loop(NamedTuple):
    """What goes from epoch to epoch, for B runs.

    States and their variances x, P and process noise Q (B, m), last known positions p (B, d),
    the epoch's times (B,), the multiplier alpha (B,). NaN before the first measurement.
    """

    x: Array
    P: Array
    Q: Array
    p: Array
    time: Array
    alpha: Array


class Epoch(NamedTuple):
    """What an epoch of B runs leaves behind; see `FilteredSequence`, in metres."""

    coloured_tdoa: Array
    variance: Array
    gain: Array
    process_noise: Array
    gated: Mask
    measured: Mask
    multiplier: Array
    position: Array
    covariance: Array


class Models(NamedTuple):
    """Models of the differences: the one whose R weighs the fix; the one of exact receivers."""

    fix: MeasurementModel
    exact: MeasurementModel

    def variance(self, times: Array) -> Array:
        """Variance (B, m) of the measured differences at `times` (B,), m²; NaN where unknown."""
        somewhere = np.zeros((len(times), self.exact.dims))
        R = self.exact.noise_covariance(somewhere, somewhere, times)
        heard = np.isfinite(self.exact.predict(somewhere, somewhere, times))
        return np.where(heard, np.einsum("...ii->...i", R), np.nan)

    def carried(self, p: Array, before: Array, now: Array) -> Array:
        """How far the stations' own motion takes the differences (B, m) of a target at p (B, d)."""
        some: Any = self.exact
        if not some.stations.moving:
            return np.zeros((len(p), self.exact.size))
        rest = np.zeros_like(p)
        moved = self.exact.predict(p, rest, now) - self.exact.predict(p, rest, before)
        return np.where(np.isfinite(moved), moved, 0.0)


def filtered(stage: SequenceFilter, scans: Scans) -> FilteredSequence:
    """Run the filters through scans of any batch axes."""
    batch, T, m, d = scans.batch, scans.count, scans.measurement.size, scans.measurement.dims
    scale = scans.measurement.scale
    z = np.broadcast_to(scans.values, (*batch, T, m)).reshape(-1, T, m) * scale
    times = np.broadcast_to(scans.times, (*batch, T)).reshape(-1, T)
    models = Models(weighing(stage), exact(stage.measurement))
    B = len(z)
    nothing = np.full((B, m), np.nan)
    loop = Loop(nothing, nothing, nothing, np.full((B, d), np.nan), times[:, 0], np.ones(B))
    epochs = []
    for k in range(T):
        loop, epoch = _step(stage, models, loop, times[:, k], z[:, k])
        epochs.append(epoch)
    done: dict[str, Any] = {
        name: np.stack(column, axis=1)
        for name, column in zip(Epoch._fields, zip(*epochs, strict=True), strict=True)
    }
    rows = np.where(done["measured"], z, np.nan).reshape(-1, m)
    near = done["position"].reshape(-1, d)
    done["raw_position"] = warm.fixes(models.fix, times.reshape(-1), rows, near).reshape(B, T, d)
    for name, power in (("coloured_tdoa", 1), ("variance", 2), ("process_noise", 2)):
        done[name] = done[name] / scale**power
    shaped = {name: value.reshape(*batch, *value.shape[1:]) for name, value in done.items()}
    return FilteredSequence(times=scans.times, measurement=scans.measurement, **shaped)


def _step(
    stage: SequenceFilter, models: Models, loop: Loop, now: Array, z: Array
) -> tuple[Loop, Epoch]:
    """One epoch: update, gate, fix, process noise for the next (§6.1)."""
    R = np.broadcast_to(models.variance(now), z.shape)
    measured = np.asarray(np.isfinite(z) & np.isfinite(R))
    z = np.where(measured, z, np.nan)
    x = loop.x + models.carried(loop.p, loop.time, now)
    update = scalar.update(x, loop.P + loop.Q, z, R)
    gated = _beyond_gate(stage, update, z, R)
    used = np.where(gated, z, update.x)
    variance = np.where(gated, R, update.P)
    x, P = (used, variance) if stage.reset_on_gate else (update.x, update.P)
    p = warm.fixes(models.fix, now, np.where(measured, used, np.nan), loop.p)
    response = Response.at(stage, p, now, measured)
    alpha = multiplier(stage, response.loop_gain(stage.rule) if stage.automatic else loop.alpha)
    alpha = np.where(np.isfinite(alpha), alpha, loop.alpha)
    begins = measured & np.isnan(loop.x)
    Q = np.where(begins, R, _fed_back(stage, loop, p, response.G, alpha))
    epoch = Epoch(
        coloured_tdoa=used,
        variance=P,
        gain=update.K,
        process_noise=Q,
        gated=gated,
        measured=measured,
        multiplier=alpha,
        position=p,
        covariance=response.covariance(np.where(measured, variance, 0.0)),
    )
    known = np.isfinite(p).all(axis=-1, keepdims=True)
    return Loop(x, P, Q, np.where(known, p, loop.p), now, alpha), epoch


def _beyond_gate(stage: SequenceFilter, update: scalar.Update, z: Array, R: Array) -> Mask:
    """Which measurements (B, m) of running sequences lie further off than the gate allows."""
    by_innovation = stage.test == "innovation"
    running = np.asarray(np.isfinite(update.spread) & np.isfinite(z))
    distance = np.where(running, np.abs(update.nu if by_innovation else z - update.x), 0.0)
    if stage.gate_s is not None:
        return np.asarray(distance > stage.gate_s * stage.speed)
    if stage.gate is None:
        return np.zeros(z.shape, dtype=bool)
    spread = update.spread if by_innovation else np.sqrt(R)
    return np.asarray(running & (distance > stage.gate * spread))


def _fed_back(stage: SequenceFilter, loop: Loop, p: Array, G: Array, alpha: Array) -> Array:
    """Return Q (B, m), m², for the next epoch: from the increment where it is known, else as is."""
    increment = p - loop.p
    moved = np.asarray(np.isfinite(increment).all(axis=-1))
    Q = process_noise(stage.rule, np.where(moved[:, None], increment, 0.0), G)
    Q = np.maximum(alpha[:, None] * Q, (stage.floor * stage.speed) ** 2)
    return np.where(moved[:, None], Q, loop.Q)
