"""What a study keeps of its estimates: figures of every run, and sums over a chunk's runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imm_tdoa import registry
from imm_tdoa.contract import Array, Mask
from imm_tdoa.study.banks import BankCase
from imm_tdoa.study.filtering import Estimates
from imm_tdoa.study.ways import Form, Ways

SUMMED = ("position_square", "velocity_square", "nees", "mode_probability")


def scored(times: Array, start_given: bool, score_from_s: float | None) -> Mask:
    """Return which scans (T,) or (n, T) count; without a start the first scan is the fix."""
    counts: Mask = np.ones(times.shape, dtype=bool)
    if not start_given:
        counts[..., 0] = False
    if score_from_s is not None:
        counts &= times >= score_from_s
    return counts


def per_run(
    case: BankCase,
    found: Estimates,
    series: Mapping[str, Array],
    ways: Ways,
    times: Array,
    counts: Mask,
) -> dict[str, Array]:
    """Return the figures (n,) of every run; NaN for runs that failed.

    Parameters
    ----------
    case : BankCase
        The estimator.
    found : Estimates
        What it made of the runs.
    series : mapping
        As `over_time` returns it.
    ways : Ways
        The truth.
    times : (T,) or (n, T)
        Times of the scans, s.
    counts : (T,) or (n, T)
        Which scans count.
    """
    counts = np.broadcast_to(counts, found.nis.shape)
    hit = _hits(case, found, ways)
    good = ~found.failed

    def mean(values: Array) -> Array:
        known = counts & np.isfinite(values)
        total = np.sum(np.where(known, values, 0.0), axis=-1)
        count = np.count_nonzero(known, axis=-1)
        return np.where(good & (count > 0), total / np.maximum(count, 1), np.nan)

    taken = counts & np.isfinite(found.nis)
    probability = np.where(counts[..., None], found.mode_probability, 0.0)
    selected = np.argmax(np.nan_to_num(probability).sum(axis=1), axis=-1)
    clock = np.broadcast_to(times, found.nis.shape)
    return {
        "position_mse": mean(series["position_square"]),
        "position_error": mean(np.sqrt(series["position_square"])),
        "velocity_mse": mean(series["velocity_square"]),
        "nees": mean(series["nees"]),
        "nis": np.where(good, np.sum(np.where(taken, found.nis, 0.0), axis=-1), np.nan),
        "nis_dof": np.where(good, np.sum(np.where(taken, found.nis_dof, 0.0), axis=-1), np.nan),
        "log_likelihood": np.where(good, found.log_likelihood, np.nan),
        "mode_hit": mean(hit),
        "recognition_delay_s": np.where(good, _delay(hit, ways, clock), np.nan),
        "failed": found.failed,
        "selected": np.where(good, selected, -1),
    }


def over_time(found: Estimates, ways: Ways) -> dict[str, Array]:
    """Return the quantities that are summed per scan, (n, T), the last one (n, T, r)."""
    error = found.position - ways.position
    off = found.velocity - ways.velocity
    return {
        "position_square": np.sum(error**2, axis=-1),
        "velocity_square": np.sum(off**2, axis=-1),
        "nees": nees(error, found.covariance),
        "mode_probability": found.mode_probability,
    }


def sums(
    found: Estimates, series: Mapping[str, Array], counts: Mask, modes: int
) -> dict[str, Array]:
    """Return count, sum and sum of squares over the runs that did not fail, per scan.

    Parameters
    ----------
    found : Estimates
        What an estimator made of the runs.
    series : mapping
        As `over_time` returns it.
    counts : (T,) or (n, T)
        Which scans count; in mode probabilities all do.
    modes : int
        Number of modes to make room for; what the estimator lacks is NaN.
    """
    result = {}
    counts = np.broadcast_to(counts, found.nis.shape)
    for name, values in series.items():
        if values.ndim == 2:
            values = np.where(counts, values, np.nan)
        values = values[~found.failed]
        known = np.isfinite(values)
        kept = np.where(known, values, 0.0)
        count = known if values.ndim == 2 else known.all(axis=-1)
        total, square = kept.sum(axis=0), (kept**2).sum(axis=0)
        if values.ndim == 3:
            room = [(0, 0), (0, modes - values.shape[-1])]
            total = np.pad(total, room, constant_values=np.nan)
            square = np.pad(square, room, constant_values=np.nan)
        result[f"count_{name}"] = count.sum(axis=0).astype(float)
        result[f"sum_{name}"], result[f"sum2_{name}"] = total, square
    return result


def nees(error: Array, covariance: Array) -> Array:
    """Return e' P^-1 e (n, T) by Cholesky's factor of every P at once; NaN where one has none."""
    d = error.shape[-1]
    L = np.zeros_like(covariance)
    square = np.zeros(error.shape[:-1])
    y = np.zeros_like(error)
    definite = np.ones(square.shape, dtype=bool)
    for i in range(d):
        for j in range(i):
            L[..., i, j] = covariance[..., i, j] - _dot(L[..., i, :j], L[..., j, :j])
            L[..., i, j] /= L[..., j, j]
        pivot = covariance[..., i, i] - _dot(L[..., i, :i], L[..., i, :i])
        definite &= pivot > 0.0
        L[..., i, i] = np.sqrt(np.where(definite, pivot, 1.0))
        y[..., i] = (error[..., i] - _dot(L[..., i, :i], y[..., :i])) / L[..., i, i]
        square += y[..., i] ** 2
    return np.where(definite, square, np.nan)


def _dot(a: Array, b: Array) -> Array:
    """Sum over the last axis, one or two long."""
    result: Array = sum((a[..., k] * b[..., k] for k in range(a.shape[-1])), np.zeros(a.shape[:-1]))
    return result


def matching(case: BankCase, forms: Sequence[Form]) -> Mask:
    """Return which modes are which motion, (F, r): by name, else by model.

    A bank of one mode recognises nothing; none of its modes is any motion.
    """
    models = [registry.name_of(model) for model in case.bank.models]
    if len(models) == 1:
        return np.zeros((len(forms), 1), dtype=bool)
    rows = []
    for form in forms:
        named = [name == form.name for name in case.modes]
        rows.append(named if any(named) else [model == form.model for model in models])
    return np.array(rows, dtype=bool)


def _hits(case: BankCase, found: Estimates, ways: Ways) -> Array:
    """1 where the likeliest mode (n, T) is the true motion, 0 where not, NaN if there is none."""
    match = matching(case, ways.forms)
    known: Mask = np.asarray(match.any(axis=-1))
    probability = np.nan_to_num(found.mode_probability)
    leading = np.argmax(probability, axis=-1)
    hit = match[ways.form, leading].astype(float)
    there = known[ways.form] & np.isfinite(found.mode_probability).all(axis=-1)
    return np.where(there, hit, np.nan)


def _delay(hit: Array, ways: Ways, times: Array) -> Array:
    """Mean time (n,) from a switch of motion until the true one leads, s; NaN without switches.

    A motion that is never recognised counts with all the time it lasted. Motions that the bank
    does not have do not count.
    """
    n, T = hit.shape
    change = np.zeros((n, T), dtype=bool)
    change[:, 1:] = ways.since[:, 1:] > ways.since[:, :-1]
    stretch = np.cumsum(change, axis=-1)
    total, count = np.zeros(n), np.zeros(n)
    for k in range(1, int(stretch.max(initial=0)) + 1):
        inside: Mask = np.asarray(stretch == k)
        exists = inside.any(axis=-1) & ~np.isnan(np.where(inside, hit, 0.0)).any(axis=-1)
        leads = inside & (hit == 1.0)
        ever = leads.any(axis=-1)
        first = np.argmax(leads, axis=-1)
        last = T - 1 - np.argmax(inside[:, ::-1], axis=-1)
        at = np.where(ever, first, last)
        begun = ways.since[np.arange(n), np.argmax(inside, axis=-1)]
        total += np.where(exists, times[np.arange(n), at] - begun, 0.0)
        count += exists
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def put(into: dict[str, Any], values: dict[str, Any]) -> None:
    """Append one bank's arrays to lists by name."""
    for name, array in values.items():
        into.setdefault(name, []).append(array)
