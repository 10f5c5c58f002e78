"""How the modes of a bank take in a scan: extended Kalman filter, plain or iterated."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import attrs
import numpy as np

from imm_tdoa import gaussian
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.observation import Observation, predict_each, usable_rows, without_offsets
from imm_tdoa.scans import Scans
from imm_tdoa.sigma_points import roots

STRAIGHT = 1e-2  # an extended update that fits nearly as well as it promised needs no iteration
STILL = 1e-3  # an iteration that moves no component by more posterior sigmas has converged
ITERATIONS = 20
FAR = 25.0  # misfit of every mode, beyond 4 a row, which says that the extended update is lost
HALVINGS = 12  # of a step that makes the fit worse


def extended(
    seen: Observation, x: Sequence[Array], P: Sequence[Array]
) -> tuple[Observation, list[gaussian.Update]]:
    """Update every mode with the scan as linearised in `seen` (ALGORITHMS §4).

    Returns the scan as predicted, shared offsets eliminated, and the modes' updates.

    Parameters
    ----------
    seen : Observation
        The scan linearised at the predictions.
    x, P : sequence of (..., n_j), (..., n_j, n_j)
        The predictions.
    """
    free = without_offsets(seen)
    updates = [
        gaussian.update(xj, Pj, nu, H, R, free.present)
        for xj, Pj, nu, H, R in zip(x, P, free.nu, free.H, free.R, strict=True)
    ]
    return free, updates


def iterated(
    look: Callable[[Sequence[Array]], Observation],
    seen: Observation,
    x: Sequence[Array],
    P: Sequence[Array],
    elsewhere: Callable[[Mask], Sequence[Array] | None] = lambda lost: None,
) -> tuple[Observation, list[gaussian.Update]]:
    """Update every mode by Gauss-Newton on its posterior (Bell & Cathey 1993; §4).

    The scan is linearised where the posterior is, not where the prediction was: with a diffuse
    prediction the two are far apart. A step that makes the fit worse is halved; where the
    iteration does not settle the plain extended update stands.

    Parameters
    ----------
    look : callable
        Gives the scan linearised at other states of the modes, the same rows present.
    seen : Observation
        The scan linearised at the predictions.
    x, P : sequence of (..., n_j), (..., n_j, n_j)
        The predictions.
    elsewhere : callable
        Asked where (...) the extended update misses the scan; may give other states to begin
        from, which are taken where they fit better.

    Returns
    -------
    Observation, list of Update
        The scan as predicted, shared offsets eliminated (its innovations judge the prediction),
        and the modes' updates.
    """

    def extended_at(there: Observation, states: Sequence[Array]) -> list[gaussian.Update]:
        nu = tuple(
            n - np.einsum("...ij,...j->...i", H, xj - a)
            for n, H, xj, a in zip(there.nu, there.H, x, states, strict=True)
        )
        return extended(attrs.evolve(there, nu=nu), x, P)[1]

    free, plain = extended(seen, x, P)
    at: Sequence[Array] = [u.x for u in plain]
    inverse = [_inverse_root(Pj) for Pj in P]
    there = look(at)
    cost = _misfit(there, at, x, inverse)
    bent = [np.abs(c - u.nis) > 1e-3 * u.nis + STRAIGHT for c, u in zip(cost, plain, strict=True)]
    dof = np.count_nonzero(free.present, axis=-1)
    far = np.min(np.stack(cost), axis=0) > FAR + 4.0 * dof
    straight = ~np.any(np.stack(bent), axis=0) & ~far
    if np.all(straight):
        return free, plain
    fixed = elsewhere(far) if np.any(far) else None
    for other in [x] if fixed is None else [x, fixed]:
        away = _misfit(look(other), other, x, inverse)
        better = [far & (b < a) for a, b in zip(cost, away, strict=True)]
        at = [_where(w, o, a) for w, o, a in zip(better, other, at, strict=True)]
        cost = [np.where(w, b, a) for w, a, b in zip(better, cost, away, strict=True)]
    updates, settled = _descend(look, extended_at, at, cost, x, inverse)
    settled &= ~straight
    return free, [
        gaussian.Update(*(_where(settled, a, b) for a, b in zip(new, old, strict=True)))
        for new, old in zip(updates, plain, strict=True)
    ]


def _descend(
    look: Callable[[Sequence[Array]], Observation],
    extended_at: Callable[[Observation, Sequence[Array]], list[gaussian.Update]],
    at: Sequence[Array],
    cost: Sequence[Array],
    x: Sequence[Array],
    inverse: Sequence[Array],
) -> tuple[list[gaussian.Update], Mask]:
    """Gauss-Newton from the states `at`, halving steps that fit worse; and who (...) arrived."""
    there, settled = look(at), np.zeros(cost[0].shape, dtype=bool)
    updates: list[gaussian.Update] = []
    for _ in range(ITERATIONS):
        now_at = extended_at(there, at)
        updates = [
            gaussian.Update(*(_where(settled, a, b) for a, b in zip(old, new, strict=True)))
            for old, new in zip(updates or now_at, now_at, strict=True)
        ]
        step = [u.x - a for u, a in zip(now_at, at, strict=True)]
        moved = [
            np.max(np.abs(d) / _spread(u.P), axis=-1) for d, u in zip(step, now_at, strict=True)
        ]
        settled |= np.max(np.stack(moved), axis=0) < STILL
        if np.all(settled):
            break
        step = [np.where(settled[..., None], 0.0, d) for d in step]
        share = [np.ones(m.shape) for m in moved]
        for _ in range(HALVINGS):
            trial = [a + q[..., None] * d for a, q, d in zip(at, share, step, strict=True)]
            there = look(trial)
            now = _misfit(there, trial, x, inverse)
            worse = [n > c + 1e-9 * (1.0 + c) for n, c in zip(now, cost, strict=True)]
            if not np.any(worse):
                break
            share = [np.where(w, 0.5 * q, q) for w, q in zip(worse, share, strict=True)]
        at = [_where(~w, t, a) for w, t, a in zip(worse, trial, at, strict=True)]
        cost = [np.where(w, c, n) for w, n, c in zip(worse, now, cost, strict=True)]
        there = look(at) if np.any(worse) else there
    return updates, settled


def at_own_fix(
    measurement: MeasurementModel,
    time: float | Array,
    values: Array,
    x: Sequence[Array],
    P: Sequence[Array],
    position: Sequence[Index],
    velocity_std: Array | None,
) -> list[Array] | None:
    """The modes' states (..., n_j) moved to where the scan by itself locates the emitter.

    The rest of each state follows its correlation with the position. None where the scan
    determines no position anywhere in the batch; the prediction where it does not.
    """
    d = measurement.dims
    present = measurement.independent(np.isfinite(values))
    _, present = gaussian.offset_contrast(np.ones(present.shape), present, measurement.offset_group)
    if np.count_nonzero(present, axis=-1).max(initial=0) < d:
        return None
    where, known = _own_fix(measurement, time, values, velocity_std)
    known = known[..., None]
    result = []
    for xj, Pj, p in zip(x, P, position, strict=True):
        away = np.where(known, where - xj[..., p], 0.0)
        W = roots(Pj[..., p[:, None], p])[1]  # a direction known exactly is not moved along
        pull = np.swapaxes(W, -1, -2) @ (W @ away[..., None])
        result.append(xj + (Pj[..., :, p] @ pull)[..., 0])
    return result


def _own_fix(
    measurement: MeasurementModel, time: float | Array, values: Array, velocity_std: Array | None
) -> tuple[Array, Mask]:
    """Where (..., d) each scan by itself locates the emitter, and whether (...) it does."""
    parts = [
        part.pairs
        for part in getattr(measurement, "models", (measurement,))
        if hasattr(part, "pairs")
    ]
    time = np.broadcast_to(time, values.shape[:-1])
    if any(pairs.ndim > 2 for pairs in parts):  # targets with pairs of their own, one by one
        where = np.zeros((*values.shape[:-1], measurement.dims))
        known = np.zeros(values.shape[:-1], dtype=bool)
        full = [np.broadcast_to(p, (*known.shape, *p.shape[-2:])) for p in parts]
        pairs = np.concatenate(full, axis=-2)
        for index in np.ndindex(known.shape):
            if np.any(np.isfinite(values[index])):
                one = measurement.with_pairs(pairs[index])
                where[index], known[index] = _own_fix(one, time[index], values[index], velocity_std)
        return where, known
    scans = Scans(measurement, time[..., None], values[..., None, :])
    fix = fix_scans(scans, moving=velocity_std is not None, velocity_std=velocity_std)
    return fix.position, np.asarray(fix.converged)


def _misfit(
    seen: Observation, at: Sequence[Array], x: Sequence[Array], inverse: Sequence[Array]
) -> list[Array]:
    """Minus twice the log-posterior (...) of each mode at `at`, up to a constant."""
    free, result = without_offsets(seen), []
    for nu, H, R, a, xj, W in zip(free.nu, free.H, free.R, at, x, inverse, strict=True):
        nu, _, R = gaussian.mask_rows(nu, H, R, free.present)
        white = np.linalg.solve(gaussian.factor(R, "noise covariance"), nu[..., None])[..., 0]
        away = np.einsum("...ij,...j->...i", W, a - xj)
        result.append(np.sum(white**2, axis=-1) + np.sum(away**2, axis=-1))
    return result


def _inverse_root(P: Array) -> Array:
    """W (..., n, n) with W' W = P^-1, as far as P is regular; in units of its own deviations."""
    sd = _spread(P)
    w, V = np.linalg.eigh(P / (sd[..., :, None] * sd[..., None, :]))
    root = np.where(w > 1e-13, 1.0 / np.sqrt(np.maximum(w, 1e-13)), 0.0)
    result: Array = root[..., :, None] * np.swapaxes(V, -1, -2) / sd[..., None, :]
    return result


def curvature(
    measurement: MeasurementModel,
    x: Sequence[Array],
    P: Sequence[Array],
    position: Sequence[Index],
    velocity: Sequence[Index],
    time: float | Array,
    values: Array,
    seen: Observation,
) -> Observation:
    """Return `seen` with the second-order terms of each mode's prediction, for a fair gate.

    Along each axis of the predicted position's spread the measurement bends by
    b = (h(x + s) + h(x - s))/2 - h(x): to second order the innovation's mean shifts by the sum
    of b and its covariance grows by 2 b b'. A row that is only far down a curve is no outlier.
    """
    rows = usable_rows(values)
    nus, Rs = [], []
    for xj, Pj, p, v, nu, R in zip(x, P, position, velocity, seen.nu, seen.R, strict=True):
        w, V = np.linalg.eigh(Pj[..., p[:, None], p])
        reach = np.swapaxes(np.sqrt(np.maximum(w, 0.0))[..., None, :] * V, -1, -2)
        place = xj[..., None, p]
        speed = xj[..., None, v] if len(v) else np.zeros_like(place)
        there = np.concatenate([place, place + reach, place - reach], axis=-2)
        speeds = np.broadcast_to(speed, there.shape)
        h = predict_each(measurement, there, speeds, time)[..., rows]
        d = len(p)
        bend = 0.5 * (h[..., 1 : d + 1, :] + h[..., d + 1 :, :]) - h[..., :1, :]
        nus.append(nu - np.sum(bend, axis=-2))
        Rs.append(R + 2.0 * np.einsum("...di,...dj->...ij", bend, bend))
    return attrs.evolve(seen, nu=tuple(nus), R=tuple(Rs))


def _spread(P: Array) -> Array:
    variance = np.einsum("...ii->...i", P)
    result: Array = np.sqrt(np.where(variance > 0.0, variance, np.inf))
    return result


def _where(mask: Mask, new: Array, old: Array) -> Array:
    result: Array = np.where(mask.reshape(mask.shape + (1,) * (new.ndim - mask.ndim)), new, old)
    return result
