"""Where a search for the most likely initial state may begin: what a filter made of the scans."""

from __future__ import annotations

import numpy as np

from imm_tdoa import prediction
from imm_tdoa.contract import AXES, PREFIX, Array, MotionModel
from imm_tdoa.scans import Scans
from imm_tdoa.track import Track

NEAR = 10  # rows of the polynomial that describes the beginning alone


def initial_states(model: MotionModel, track: Track, mode: int, scans: Scans) -> Array:
    """Return states (3, ..., n) of `model` at the first scan to begin from.

    The mode's own estimate smoothed back to the first scan, and polynomials through the track's
    combined positions, all of them and the first few.

    Parameters
    ----------
    model : MotionModel
        Mode number `mode` of `track`.
    track : Track
        What a bank of models without switching made of the scans, or of more scans before them.
    scans : Scans
        The scans; the track ends with the last of them.
    """
    components = track.space.modes[mode]
    count = min(track.mean.shape[-2], scans.count)
    batch = track.mean.shape[:-2]
    times = np.broadcast_to(track.times, (*batch, track.times.shape[-1]))[..., -count:]
    first = np.broadcast_to(scans.times, (*batch, scans.count))[..., 0]
    smoothed = _smoothed(
        model,
        track.mode_means[mode][..., -count:, :],
        track.mode_covariances[mode][..., -count:, :, :],
        times,
        first,
        track.space.dims,
    )
    position = track.position[..., -count:, :]
    after = times - first[..., None]
    near = [_polynomial(components, position[..., :k, :], after[..., :k]) for k in (count, NEAR)]
    return np.stack([smoothed, *near])


def _smoothed(
    model: MotionModel, mean: Array, covariance: Array, times: Array, first: Array, dims: int
) -> Array:
    """Estimate (..., n) at `first`: Rauch-Tung-Striebel back to the track's first row, and on.

    Rows that are NaN (a target that has not started) are passed over.
    """
    n = mean.shape[-1]
    x, time = mean[..., -1, :], times[..., -1]
    for k in range(mean.shape[-2] - 2, -1, -1):
        here = np.asarray(np.isfinite(mean[..., k, :]).all(axis=-1))
        dt = time - np.where(here, times[..., k], time)
        P = np.where(here[..., None, None], covariance[..., k, :, :], np.eye(n))
        before = np.where(here[..., None], mean[..., k, :], x)
        ahead = prediction.predict(model, before, P, dt, dims)
        scale = np.sqrt(np.maximum(np.einsum("...ii->...i", ahead.P), 1e-300))
        A = ahead.P / (scale[..., :, None] * scale[..., None, :])
        pull = np.linalg.pinv(A, rcond=1e-12, hermitian=True) @ ((x - ahead.x) / scale)[..., None]
        smooth = before + (ahead.cross / scale[..., None, :] @ pull)[..., 0]
        x = np.where(here[..., None], smooth, x)
        time = np.where(here, times[..., k], time)
    return _back(model, x, np.maximum(time - first, 0.0))


def _back(model: MotionModel, x: Array, dt: Array) -> Array:
    """Return the state (..., n) that the model takes to `x` in `dt` (...) s, by Newton's method."""
    start = np.array(x)
    for _ in range(4):
        F = model.jacobian(start, dt)
        away = x - model.propagate(start, dt)
        start = start + np.linalg.solve(F, away[..., None])[..., 0]
    usable = np.isfinite(start).all(axis=-1, keepdims=True)
    return np.where(usable, start, x)


def _polynomial(components: tuple[str, ...], position: Array, after: Array) -> Array:
    """Fit (..., n) of positions (..., T, d) at `after` (..., T) s of the order that there is."""
    known = np.asarray(np.isfinite(position).all(axis=-1))
    span = np.maximum(np.max(np.where(known, after, 0.0), axis=-1, keepdims=True), 1e-9)
    order = max(k for k in range(3) if PREFIX[k] + AXES[0] in components)
    t = after / span
    V = np.where(known[..., None], np.stack([t**k for k in range(order + 1)], axis=-1), 0.0)
    y = np.where(known[..., None], position, 0.0)
    c = np.linalg.pinv(V) @ y  # (..., order + 1, d), in units of the span
    x = np.zeros((*position.shape[:-2], len(components)))
    for k in range(order + 1):
        value = c[..., k, :] / span**k * (1.0, 1.0, 2.0)[k]
        for i in range(position.shape[-1]):
            x[..., components.index(PREFIX[k] + AXES[i])] = value[..., i]
    return x
