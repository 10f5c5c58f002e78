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
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, gaussian, mixture
from imm_tdoa._brief import brief
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.state import State
from imm_tdoa.testing.histories import Layer, Steps, flat

LIMIT = 200_000


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

    __repr__ = brief

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

    __repr__ = brief


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
    clock = np.concatenate([flat(start.time, batch, 0)[:, None], flat(t, batch, 1)], axis=1)
    dt = np.diff(clock, axis=1)
    if np.any(dt < 0.0):
        raise ValueError("times: expected times that do not decrease, from the start's on")
    steps = Steps(bank, measurement)
    layers = [steps.root(start, batch)]
    for k, scan in enumerate(np.moveaxis(flat(z, batch, 2), 1, 0)):
        layers.append(steps.grow(layers[-1], dt[:, k], clock[:, k + 1], scan))
    log_L = np.stack([_log_sum(layer.log_weight) for layer in layers], axis=1)
    log_L = flat(start.log_likelihood, batch, 0)[:, None] + log_L[:, 1:] - log_L[:, :1]
    filtered = [_estimate(layer.x, layer.P, layer.log_weight, r, 1) for layer in layers[1:]]
    return ExactPosterior(
        times=t,
        filtered=_stacked(filtered, batch),
        smoothed=_stacked(_smoothed(layers, r), batch),
        log_likelihood=log_L.reshape(*batch, T),
        components=space.components,
        modes=bank.names,
    )


def _smoothed(layers: Sequence[Layer], r: int) -> list[Estimate]:
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


def _log_sum(log_weight: Array) -> Array:
    return mixture.normalise(log_weight)[1]
