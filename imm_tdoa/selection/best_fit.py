"""The initial state that explains all scans best, for any motion model (ALGORITHMS §11)."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Index, Mask, MeasurementModel, MotionModel
from imm_tdoa.imm import IMM
from imm_tdoa.scans import Scans
from imm_tdoa.selection import begin
from imm_tdoa.selection.likelihood import Likelihood, Slope

ITERATIONS = 40
SETTLED = 1e-7  # a full step that would lower -2 log L by less has arrived
STALLED = 0.02  # so has one that promises less than this and fails however short it is cut
SINGULAR = 1e-11  # least eigenvalue of the information, in units of its own diagonal


@attrs.frozen(eq=False)
class MaximumLikelihood:
    """The batch maximum likelihood of one motion model.

    Attributes
    ----------
    state : (..., n)
        Most likely state at the time of the first scan; NaN where the scans determine none.
    covariance : (..., n, n)
        Inverse of the information about it, its Cramér-Rao bound; NaN likewise.
    log_likelihood : (...)
        log p(Z | state) of all scans, the first included, in internal units (metres); NaN where
        there is no maximum.
    rows : (...) int
        Scalar measurements used, n of the BIC: one less than given per unknown shared offset.
    parameters : int
        Components of the state, p of AIC and BIC.
    converged : (...) bool
        Whether `state` is a maximum.
    iterations : int
        Evaluations of the likelihood that it took.
    reason : (...) str
        Why there is no maximum; empty where there is one.
    """

    state: Array
    covariance: Array
    log_likelihood: Array
    rows: Index
    parameters: int
    converged: Mask
    iterations: int
    reason: np.ndarray[Any, np.dtype[np.str_]]

    @property
    def aic(self) -> Array:
        """Akaike's criterion (...), -2 log L + 2 p: the least is the best."""
        return np.asarray(-2.0 * self.log_likelihood + 2.0 * self.parameters)

    @property
    def bic(self) -> Array:
        """Schwarz's criterion (...), -2 log L + p log n: the least is the best."""
        n = np.maximum(self.rows, 1)
        return np.asarray(-2.0 * self.log_likelihood + self.parameters * np.log(n))


def maximum_likelihood(
    model: MotionModel,
    measurement: MeasurementModel,
    times: Any,
    values: Any,
    *,
    pairs: Any = None,
    start: Any = None,
    row_weight: Any = None,
) -> MaximumLikelihood:
    """Find the state at the first scan under which all scans are most likely.

    No prior enters. Without process noise this is nonlinear weighted least squares; with it, the
    likelihood is that of a Kalman filter started at the state without uncertainty (exact for
    linear Gaussian models, extended otherwise). Levenberg-Marquardt, every target of a batch with
    its own damping.

    Parameters
    ----------
    model : MotionModel
        How the emitter moves.
    measurement : MeasurementModel
        What is measured.
    times : (T,) or (..., T)
        Times of the scans, s.
    values : (..., T, m)
        What was measured; NaN is missing.
    pairs : (T, m, 2) or (..., T, m, 2), optional
        Station pairs of each row, where they change from scan to scan.
    start : (..., n) or (K, ..., n), optional
        State or K states at the first scan to begin from; a leading axis more than the scans have
        means several. Default: those that a filter, smoothed, suggests.
    row_weight : (..., T, m), optional
        Share of its information that each row keeps, 0 to 1 (what a robust filter found); 0
        leaves it out.

    Raises
    ------
    ValueError
        Shapes that do not fit; no `start` and no position to start a filter from.
    """
    scans = Scans.checked(measurement, times, values, pairs)
    likelihood = weighted(model, scans, row_weight)
    if start is None:
        track = IMM(Bank([model]), measurement, update="iekf").run(times, values, pairs=pairs)
        starts = begin.initial_states(model, track, 0, scans)
    else:
        starts = _validate.array("start", start, (None, likelihood.unknowns))
        if starts.ndim <= len(scans.batch) + 1:
            starts = starts[None]
    return maximise(likelihood, starts)


def weighted(model: MotionModel, scans: Scans, row_weight: Any = None) -> Likelihood:
    """Return the likelihood of `scans`, rows of weight 0 left out."""
    if row_weight is None:
        return Likelihood(model, scans)
    weight = _validate.array("row_weight", row_weight, (None, *scans.values.shape[-2:]))
    if np.any(weight < 0.0) or np.any(weight > 1.0):
        raise ValueError("row_weight: expected shares of 0 to 1")
    kept = Scans(
        scans.measurement,
        scans.times,
        np.where(weight > 0.0, scans.values, np.nan),
        scans.pairs,
    )
    if np.all((weight == 0.0) | (weight == 1.0)):
        return Likelihood(model, kept)
    return Likelihood(model, kept, np.where(weight > 0.0, weight, 1.0))


def maximise(likelihood: Likelihood, starts: Array) -> MaximumLikelihood:
    """Maximise from the best of the `starts` (K, ..., n), from the others where that fails."""
    batch = np.broadcast_shapes(starts.shape[1:-1], likelihood.scans.batch)
    K, n = len(starts), likelihood.unknowns
    starts = np.broadcast_to(starts.reshape(K, *starts.shape[1:]), (K, *batch, n))
    first = likelihood(starts)
    order = np.argsort(_comparable(first.cost, first.rows), axis=0)
    x, at, converged, iterations = _descend(likelihood, _pick(starts, order[0]))
    if K > 1 and not np.all(converged):
        rest = np.stack([_pick(starts, order[k]) for k in range(1, K)])
        x2, at2, converged2, more = _descend(likelihood, rest)
        iterations += more
        x, converged = np.concatenate([x[None], x2]), np.concatenate([converged[None], converged2])
        at = Slope(*(np.concatenate([a[None], b]) for a, b in zip(at, at2, strict=True)))
        score = _comparable(at.cost, at.rows)
        best = np.argmin(np.where(converged, score, score + 1e12), axis=0)
        x, converged = _pick(x, best), _pick(converged, best)
        at = Slope(*(_pick(a, best) for a in at))
    return _result(likelihood, x, at, converged, iterations)


def _comparable(cost: Array, rows: Index) -> Array:
    """Costs (K, ...) that may be compared: infinite where a start loses rows or explodes."""
    whole = np.isfinite(cost) & (rows == rows.max(axis=0))
    return np.where(whole, cost, np.finfo(float).max / 4)


def _pick(a: Any, index: Index) -> Any:
    """Take `index` (...) of the first axis of `a` (K, ..., *)."""
    expanded = index.reshape(1, *index.shape, *(1,) * (a.ndim - 1 - index.ndim))
    return np.take_along_axis(a, expanded, axis=0)[0]


def _descend(likelihood: Likelihood, x: Array) -> tuple[Array, Slope, Mask, int]:
    """Levenberg-Marquardt from `x` (..., n): a step is taken where it lowers the cost."""
    at = likelihood(x)
    damping = np.full(at.cost.shape, 1e-4)
    done = np.zeros(at.cost.shape, dtype=bool)
    used = 1
    for _ in range(ITERATIONS):
        _, promise = _step(at, np.zeros_like(damping))
        done = done | _arrived(promise, damping) | (damping > 1e12)
        if np.all(done):
            break
        damped, _ = _step(at, damping)
        trial = np.where(done[..., None], x, x + damped)
        there, used = likelihood(trial), used + 1
        better = (there.cost < at.cost) & (there.rows >= at.rows) & ~done
        x = np.where(better[..., None], trial, x)
        at = Slope(*(_where(better, new, old) for new, old in zip(there, at, strict=True)))
        grow = np.where(promise < STALLED, 1e3, 8.0)
        damping = np.where(better, np.maximum(damping * 0.1, 1e-12), damping * grow)
    step, promise = _step(at, np.zeros_like(damping))
    x = np.where((promise < SETTLED)[..., None], x + step, x)
    return x, at, _arrived(promise, damping), used


def _arrived(promise: Array, damping: Array) -> Mask:
    """Whether nothing is left to gain (...); with process noise the slope is nearly exact only."""
    arrived: Mask = (promise < SETTLED) | ((promise < STALLED) & (damping > 1e3))
    return arrived


def _step(at: Slope, damping: Array) -> tuple[Array, Array]:
    """Step d (..., n) of (A + damping diag A) d = g, and by how much it promises to help."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", at.normal), 1e-300))
    A = at.normal / (scale[..., :, None] * scale[..., None, :])
    n = A.shape[-1]
    A = np.where(np.isfinite(A), A, np.eye(n)) + (damping[..., None, None] + 1e-14) * np.eye(n)
    g = np.where(np.isfinite(at.downhill), at.downhill, 0.0) / scale
    d = np.linalg.solve(A, g[..., None])[..., 0]
    return d / scale, np.sum(d * g, axis=-1)


def _where(mask: Mask, a: Any, b: Any) -> Any:
    return np.where(mask.reshape(mask.shape + (1,) * (np.ndim(b) - mask.ndim)), a, b)


def _result(
    likelihood: Likelihood, x: Array, at: Slope, converged: Mask, iterations: int
) -> MaximumLikelihood:
    n = likelihood.unknowns
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", at.normal), 1e-300))
    A = at.normal / (scale[..., :, None] * scale[..., None, :])
    A = np.where(np.isfinite(A), A, 0.0)
    determined = (np.linalg.eigvalsh(A)[..., 0] > SINGULAR) & (at.rows >= n)
    safe = np.where(determined[..., None, None], A, np.eye(n))
    covariance = np.linalg.inv(safe) / (scale[..., :, None] * scale[..., None, :])
    good = determined & converged & np.isfinite(at.cost)
    few = f"{n} unknowns need at least {n} rows"
    reason = np.select(
        [good, at.rows < n, ~determined],
        ["", few, "the scans do not determine the model's whole state"],
        "the search for the maximum did not settle",
    )
    known = determined[..., None]
    return MaximumLikelihood(
        state=np.where(known, x, np.nan),
        covariance=np.where(known[..., None], covariance, np.nan),
        log_likelihood=np.where(good, -0.5 * at.cost, np.nan),
        rows=at.rows,
        parameters=n,
        converged=good,
        iterations=iterations,
        reason=np.asarray(reason, dtype=np.str_),
    )
