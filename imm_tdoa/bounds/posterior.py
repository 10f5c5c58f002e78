"""A whole track: the posterior Cramér-Rao bound for a given sequence of motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.bounds import diffuse
from imm_tdoa.bounds.course import Course, column_names
from imm_tdoa.bounds.diffuse import Knowledge
from imm_tdoa.bounds.mean import mean_error
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.locate.normal import inverse
from imm_tdoa.statespace import lift


@attrs.frozen(eq=False)
class PosteriorBound:
    """The least covariance a tracker can have after each scan; see `pcrlb`.

    Attributes
    ----------
    times : (T,) or (..., T)
        Times, s.
    covariance : (..., T, n, n)
        Bound on the covariance of the state after each scan. A variance of which nothing is known
        yet is infinite; components that the mode in force lacks, and covariances with what is
        unknown, are NaN.
    components : tuple of str
        Names of the n components, positions first.
    modes : tuple of T str
        The mode in force at each time.
    dims : int
        Number of space dimensions d.
    """

    times: Array
    covariance: Array
    components: tuple[str, ...]
    modes: tuple[str, ...]
    dims: int

    @property
    def position_covariance(self) -> Array:
        """Bound on the covariance of the position (..., T, d, d), m²."""
        return self.covariance[..., : self.dims, : self.dims]

    @property
    def position_rms(self) -> Array:
        """Bound on the root-mean-square position error (..., T), m."""
        result: Array = np.sqrt(np.einsum("...ii->...", self.position_covariance))
        return result

    @property
    def position_mean(self) -> Array:
        """Mean position error (..., T), m, of a Gaussian error that attains the bound."""
        return mean_error(self.position_covariance)


def pcrlb(
    models: Any,
    measurement: MeasurementModel,
    times: Any,
    trajectory: Any,
    *,
    modes: Sequence[int | str] | None = None,
    covariance: Any = None,
    components: Sequence[str] | None = None,
    present: Any = None,
    pairs: Any = None,
    axis: int | tuple[int, ...] | None = None,
) -> PosteriorBound:
    """Posterior Cramér-Rao bound of a track, given which motion was when (ALGORITHMS §10 a).

    For each scan in turn, with P the bound after the last (Tichavský, Muravchik & Nehorai 1998),

        P ← F P F' + Q,    P ← (P^-1 + E[H' R^-1 H])^-1,

    in covariance form: nothing is inverted that may be singular, so that Q = 0, a start of which
    nothing is known and scans too poor for a position are exact. A tracker that must find out
    the motion cannot do better than this bound, which is told it.

    By default each trajectory is bounded by itself: the bound of the initial state, carried
    forward, for estimators without bias there. With `axis` the information is averaged over
    trajectories, and the bound holds for the mean square error over them, whatever the
    estimator's bias, if they are drawn from the models and the `covariance`.

    Parameters
    ----------
    models : Bank, MotionModel or sequence of MotionModel
        The motion, or those that `modes` chooses from. Of a bank the models and the birth law
        count, not its chain or its mixing rule.
    measurement : MeasurementModel
        What is measured.
    times : (T,) or (..., T)
        Times of the scans, s, not decreasing.
    trajectory : (..., T, c)
        True states at these times: the position; or position and velocity; or these and the
        acceleration; or all of the models' components. Velocities are needed where they are
        measured, and every component of a model that is not linear.
    modes : (T,) int or str, optional
        Index or name of the mode in force over the step that ends at each time; the first is the
        mode at the start. On a change components are matched by name: those that end are
        dropped, those that begin have the birth law (§9.3). Not needed with a single model.
    covariance : (c, c) or (..., c, c), optional
        What is known at the first of the times, before its scan: of the position, of all of the
        models' components, or of `components`. A variance of ``inf``, its covariances zero,
        means nothing; what is not named has the birth law. Default: nothing of the position, so
        that the first scan is a fix.
    components : sequence of str, optional
        Names of the columns of `trajectory`, or of `covariance`, where they are others.
    present : (T, m) or (..., T, m), optional
        Rows that arrive: booleans, or the values themselves, NaN missing. Default all.
    pairs : (T, m, 2) or (..., T, m, 2) int, optional
        Station pairs of each row, where they change from scan to scan.
    axis : int or tuple of int, optional
        Batch axes of `trajectory` to average the information over; times must not vary along
        them. Of a model that is not linear the spread of its Jacobians counts too.

    Returns
    -------
    PosteriorBound
        Bounds after every scan.

    Raises
    ------
    ValueError
        Arguments that do not fit; no `modes` for several models; components that are needed and
        not given; Jacobians that vary over the average where process noise is singular.

    Notes
    -----
    Where the sequence of modes is random, the mean of `PosteriorBound.covariance` over sequences
    drawn from the chain is what tracking papers usually plot.

    Examples
    --------
    >>> bound = pcrlb(bank, measurement, times, trajectory, modes=["static"] * 5 + ["turn"] * 9)
    >>> bound.position_rms, bound.position_mean
    """
    course = Course.checked(
        models,
        measurement,
        times,
        trajectory,
        modes=modes,
        components=components,
        present=present,
        pairs=pairs,
        axis=axis,
    )
    space, clock = course.space, course.times()
    known = _start(course, covariance, components)
    information = course.information()
    n = len(space.components)
    bounds = []
    for k, j in enumerate(course.sequence):
        if k:
            known = diffuse.lifted(known, space.lifts[course.sequence[k - 1]][j])
            known = _move(course, known, k, clock[..., k] - clock[..., k - 1])
        known = diffuse.inform(known, _rows(course, information[..., k, :, :], j))
        own, union = space.to_union[j].source, space.to_union[j].target
        P = diffuse.covariance(known)
        C = np.full((*P.shape[:-2], n, n), np.nan)
        C[..., union[:, None], union] = P[..., own[:, None], own]
        bounds.append(C)
    return PosteriorBound(
        times=clock,
        covariance=np.stack(np.broadcast_arrays(*bounds), axis=-3),
        components=space.components,
        modes=tuple(course.bank.names[j] for j in course.sequence),
        dims=space.dims,
    )


def _start(course: Course, covariance: Any, components: Sequence[str] | None) -> Knowledge:
    """Return what is known before the first scan, in the components of the first mode."""
    space = course.space
    if covariance is None:
        covariance = np.diag(np.full(space.dims, np.inf))
    try:
        P = np.array(covariance, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"covariance: expected numbers, got {covariance!r}") from error
    if P.ndim < 2 or P.shape[-1] != P.shape[-2]:
        raise ValueError(f"covariance: expected shape (..., c, c), got {P.shape}")
    names = column_names("covariance", P.shape[-1], space, components)
    flat = np.isposinf(np.einsum("...ii->...i", P))
    P[flat[..., None] & np.eye(len(names), dtype=bool)] = 0.0
    if np.any(P[flat] != 0.0) or np.any(np.swapaxes(P, -1, -2)[flat] != 0.0):
        raise ValueError("covariance: expected zeros beside an infinite variance")
    P = _validate.covariance("covariance", P, len(names))
    D = np.where(flat[..., None, :], np.eye(len(names)), 0.0)
    first = space.modes[course.sequence[0]]
    return diffuse.lifted(Knowledge(P, D), lift(names, first, course.bank.birth_std))


def _move(course: Course, known: Knowledge, k: int, dt: Array) -> Knowledge:
    """Return what is known a step later, before scan k."""
    j = course.sequence[k]
    model, space, times = course.bank.models[j], course.space, course.scans.times
    x = course.columns(space.modes[j])[..., k - 1, :]
    F = model.jacobian(x, times[..., k] - times[..., k - 1])
    Q = model.process_noise(dt, space.dims)
    if course.axes:
        F, spread = _averaged(course, j, F, Q)
        if spread is not None:
            known = diffuse.inform(known, diffuse.rows(spread))
    return diffuse.predict(known, F, Q)


def _averaged(course: Course, j: int, F: Array, Q: Array) -> tuple[Array, Array | None]:
    """Return E[F], and what the spread of F says about the state before the step.

    With F = E[F] + G the recursion's D11 = E[F' Q^-1 F] is E[F]' Q^-1 E[F] + E[G' Q^-1 G].
    """
    full = np.broadcast_to(F, (*course.batch, *F.shape[-2:]))
    axes = tuple(a - 2 for a in course.axes)
    if not np.any(np.ptp(full, axis=axes)):
        return np.min(full, axis=axes), None
    weight, regular = inverse(Q)
    if not np.all(regular):
        raise ValueError(
            f"axis: the Jacobians of {course.bank.names[j]} vary over the trajectories, and their "
            f"average needs process noise in every component; bound each trajectory by itself "
            f"(axis=None)"
        )
    along = tuple(a % full.ndim for a in axes)
    G = full - np.mean(full, axis=axes, keepdims=True)
    weight = weight if weight.ndim == 2 else np.expand_dims(weight, along)
    spread = np.mean(np.swapaxes(G, -1, -2) @ weight @ G, axis=axes)
    return np.mean(full, axis=axes), spread


def _rows(course: Course, information: Array, j: int) -> Array:
    """Return rows (..., m, n_j) of unit noise that say of mode j's state what the scan says."""
    space = course.space
    at = np.concatenate([space.position[j], space.velocity[j]])
    part = information[..., : len(at), : len(at)]
    H = np.zeros((*part.shape[:-1], len(space.modes[j])))
    H[..., at] = diffuse.rows(part)
    return H
