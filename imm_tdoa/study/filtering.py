"""Running one estimator over the runs of a chunk; runs that fail are found and left out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from imm_tdoa import mixture
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.study.banks import BankCase
from imm_tdoa.study.draw import Drawn
from imm_tdoa.study.engines import Engine
from imm_tdoa.study.fixes import Begin, Fixes, each
from imm_tdoa.study.scenarios import Start
from imm_tdoa.track import Track

Also = Callable[[Index, Drawn, Track], None]


class Estimates(NamedTuple):
    """What an estimator made of n runs; NaN before a run's track starts and where it failed.

    Attributes
    ----------
    position, velocity : (n, T, d)
        m and m/s.
    covariance : (n, T, d, d)
        Of the position, m².
    mode_probability : (n, T, r)
        Of each mode.
    nis, nis_dof : (n, T)
        Normalised innovation squared and its degrees of freedom.
    log_likelihood : (n,)
        Of all measurements taken in.
    reason : (n,) str
        Why a run failed; empty where it did not.
    """

    position: Array
    velocity: Array
    covariance: Array
    mode_probability: Array
    nis: Array
    nis_dof: Array
    log_likelihood: Array
    reason: np.ndarray[Any, np.dtype[np.object_]]

    @property
    def failed(self) -> Mask:
        """Which runs (n,) failed."""
        result: Mask = self.reason != ""
        return result


def estimate(
    case: BankCase,
    begin: Begin,
    start: Start | None,
    engine: Engine,
    also: Also | None = None,
) -> Estimates:
    """Run an estimator over all runs of a chunk as batches.

    Runs that cannot be filtered are recorded with the reason and left out.

    Parameters
    ----------
    case : BankCase
        The estimator.
    begin : Begin
        What was measured, and the fixes made of it.
    start : Start, optional
        What the filters are told to start from, in the place of a fix.
    engine : "numpy" or "compiled"
        What computes it.
    also : callable, optional
        Is given the runs' numbers within the chunk, what they measured, and their track.
    """
    drawn = begin.drawn
    n, T = drawn.values.shape[:2]
    d, r = drawn.ways.dims, len(case.bank)

    def unknown(*tail: int) -> Array:
        return np.full((n, T, *tail), np.nan)

    result = Estimates(
        position=unknown(d),
        velocity=unknown(d),
        covariance=unknown(d, d),
        mode_probability=unknown(r),
        nis=unknown(),
        nis_dof=np.zeros((n, T)),
        log_likelihood=np.full(n, np.nan),
        reason=np.full(n, "", dtype=object),
    )
    imm = case.imm(drawn.measurement)
    fixes = begin.of(imm) if start is None else None
    if fixes is not None:
        result.reason[:] = fixes.reason

    def together(runs: Index) -> None:
        part = drawn.part(runs)
        absent = np.zeros((len(runs), T), dtype=bool)
        if fixes is not None:
            mine = fixes.part(runs)
            track = _from_fixes(imm, part, mine, engine)
            absent = np.arange(T) < mine.last[:, None]
        else:
            assert start is not None
            state = told(imm, part, start)
            track = imm.run(part.times, part.values, state, part.pairs, engine, threads=1)
        if also is not None:
            also(runs, part, track.blanked(absent) if np.any(absent) else track)
        probability = track.mode_probability
        for into, values in (
            *zip(result[:3], _combined(track, probability, d), strict=True),
            (result.mode_probability, probability),
            (result.nis, track.nis),
            (result.nis_dof, track.nis_dof),
        ):
            gap = absent.reshape(*absent.shape, *(1,) * (into.ndim - 2))
            into[runs] = np.where(gap, np.nan, values) if np.any(gap) else values
        result.log_likelihood[runs] = track.log_likelihood[..., -1]

    each(together, np.flatnonzero(result.reason == ""), result.reason)
    _refuse_lost(result)
    return result


def _from_fixes(imm: IMM, part: Drawn, fixes: Fixes, engine: Engine) -> Track:
    """Track all runs from their own fixes on, as `IMM.run` does it without a start.

    A run whose fix comes late waits for it by steps of no length without measurement, which
    leave it as it is.
    """
    used = np.arange(part.values.shape[1]) <= fixes.last[:, None]
    values = np.where(used[..., None], np.nan, part.values)
    times = part.times
    if np.any(fixes.last > 0):
        times = np.maximum(times, fixes.time[:, None])
    state = imm.start(fixes.time, fixes.mean, fixes.covariance, fixes.components)
    return imm.run(times, values, state, part.pairs, engine, threads=1)


def _combined(track: Track, probability: Array, d: int) -> tuple[Array, Array, Array]:
    """Position, velocity and the position's covariance, as `state.combine` would have them.

    Of all components together that would take most of a chunk's time.
    """
    space = track.space
    position = [x[..., own] for x, own in zip(track.mode_means, space.position, strict=True)]
    covariance = [
        P[..., own[:, None], own]
        for P, own in zip(track.mode_covariances, space.position, strict=True)
    ]
    mean, P = mixture.moments(probability, np.stack(position, -2), np.stack(covariance, -3))
    velocity = np.zeros((*probability.shape[:-1], d))
    for j, (x, own) in enumerate(zip(track.mode_means, space.velocity, strict=True)):
        if len(own):
            velocity += probability[..., j, None] * x[..., own]
    return mean, velocity, P


def _refuse_lost(found: Estimates) -> None:
    """Record runs that never began, or whose estimates are not finite once they had."""
    whole = (
        np.isfinite(found.position).all(axis=-1)
        & np.isfinite(found.covariance).all(axis=(-2, -1))
        & np.isfinite(found.mode_probability).all(axis=-1)
    )
    begun = np.maximum.accumulate(np.isfinite(found.position).all(axis=-1), axis=-1)
    lost = np.any(begun & ~whole, axis=-1) | ~begun[:, -1] | ~np.isfinite(found.log_likelihood)
    found.reason[lost & (found.reason == "")] = "the estimate is not finite"


def told(imm: IMM, drawn: Drawn, start: Start) -> State:
    """What the filters are told: the truth, with an error of the declared size."""
    d, ways = drawn.ways.dims, drawn.ways
    assert drawn.start is not None
    std = np.full(d, start.position_std_m)
    mean = ways.position[:, 0] + std * drawn.start[:, :d]
    names = imm.space.components[:d]
    moving = imm.space.components[d : 2 * d]
    if start.velocity_std_mps is not None and moving:
        speed = np.full(d, start.velocity_std_mps)
        mean = np.concatenate([mean, ways.velocity[:, 0] + speed * drawn.start[:, d:]], axis=-1)
        std, names = np.concatenate([std, speed]), names + moving
    return imm.start(drawn.times[..., 0], mean, np.diag(std**2), names)
