"""Other libraries on the same data: filterpy's IMM and Stone Soup's extended Kalman filter.

filterpy 2.0, at its best: `IMMEstimator` needs members of equal dimension, so each mode is
embedded in the largest one's components. What a mode lacks it forgets in every step and draws
anew from the birth law, F = blkdiag(F_j, 0), Q = blkdiag(Q_j, birth), which is exactly the mixing
rule ``"birth"``. Its extended filter takes its Jacobian as an argument of every update, so
it is no member as it comes; either kind of member here gives it at each step:

* `Extended`: an `ExtendedKalmanFilter` whose update is told h and its Jacobian;
* `Linearised`: a `KalmanFilter` with H set at each step, and z - h(x) + H x as the measurement.

An extended member's `predict` takes no None, so the control is 0. Ranges are computed once for
both. `fastest` times the two and takes the quicker one. Every scan
is complete and at a new time, where its known faults (a missed scan, a second update at one
instant, an outlier: see `imm_tdoa.interop`) do not show.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, IMMEstimator, KalmanFilter

from imm_tdoa.bench.clock import side_by_side
from imm_tdoa.bench.jobs import Job
from imm_tdoa.contract import Array, LinearMotion


class Differences:
    """Range differences against the first station, and their Jacobian, as a user writes them."""

    def __init__(self, stations: Array, n: int) -> None:
        self.stations, self.d = stations, stations.shape[1]
        self.H = np.zeros((len(stations) - 1, n))
        self.h = np.zeros((len(stations) - 1, 1))

    def look(self, x: Array) -> None:
        """Compute both where the state is x (n, 1)."""
        away = x[: self.d, 0] - self.stations
        r = np.sqrt((away * away).sum(axis=1))
        u = away / r[:, None]
        self.h[:, 0] = r[1:] - r[0]
        self.H[:, : self.d] = u[1:] - u[0]


class Extended(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's extended filter as a member of an IMM."""

    seen: Differences

    def update(self, z: Array) -> None:
        """Take in range differences z (m, 1)."""
        super().update(z, self._jacobian, self._predicted)

    def _jacobian(self, x: Array) -> Array:
        self.seen.look(x)
        return self.seen.H

    def _predicted(self, x: Array) -> Array:
        return self.seen.h


class Linearised(KalmanFilter):  # type: ignore[misc]
    """filterpy's Kalman filter, linearised anew at each step."""

    seen: Differences

    def update(self, z: Array) -> None:
        """Take in range differences z (m, 1)."""
        self.seen.look(self.x)
        self.H = self.seen.H
        super().update(z - self.seen.h + self.H @ self.x)


MEMBERS = (Extended, Linearised)


def filterpy_imm(job: Job, member: type[Any]) -> Any:
    """Return filterpy's `IMMEstimator` for a target of the job, at the job's start."""
    imm, state = job.imm, job.start
    bank, space = imm.bank, imm.space
    d, n = space.dims, len(space.components)
    dt = float(job.times[0] - state.time)
    widest = space.lifts[int(np.argmin([len(c) for c in space.modes]))][
        int(np.argmax([len(c) for c in space.modes]))
    ]
    birth = np.zeros(n)
    birth[widest.missing] = widest.birth_variance
    stations = imm.measurement.stations.positions  # type: ignore[attr-defined]
    R = imm.measurement.noise_covariance(np.zeros(d), np.zeros(d), 0.0)
    filters = []
    for j, model in enumerate(bank.models):
        assert isinstance(model, LinearMotion)
        own = len(space.modes[j])
        one = member(dim_x=n, dim_z=imm.measurement.size)
        one.F, one.Q, one.R = np.zeros((n, n)), np.diag(birth), R.copy()
        one.F[:own, :own] = model.transition(dt, d)
        one.Q[:own, :own] = model.process_noise(dt, d)
        one.x, one.P = np.zeros((n, 1)), np.diag(birth)
        one.x[:own, 0] = state.means[j]
        one.P[:own, :own] = state.covariances[j]
        one.seen = Differences(stations, n)
        filters.append(one)
    return IMMEstimator(filters, np.array(state.mode_probability), np.array(bank.chain(dt)))


def columns(job: Job, target: int) -> list[Array]:
    """Return a target's scans as filterpy takes them: range differences (m, 1), m."""
    ranges = job.values[target] * job.imm.measurement.scale
    return [z[:, None] for z in ranges]


def follow(job: Job, targets: int, member: type[Any]) -> None:
    """Track the first targets of the job by filterpy."""
    for target in range(targets):
        imm = filterpy_imm(job, member)
        for z in columns(job, target):
            imm.predict(0)
            imm.update(z)


def fastest(job: Job) -> type[Any]:
    """Return the quicker of the two kinds of members on this machine."""
    tasks = {kind.__name__: partial(follow, job, 1, kind) for kind in MEMBERS}
    spent = side_by_side(tasks, 5)
    return min(MEMBERS, key=lambda kind: spent[kind.__name__].low)


def disagreement(job: Job, targets: int, member: type[Any], **how: Any) -> float:
    """Return by how much filterpy's answers differ from ours, at most.

    Of the combined mean and of the covariance of its position, in standard deviations of the
    estimate, and of the mode probabilities. The rest of the covariance is not compared: ours says
    that a static emitter has no velocity, the embedded one that nothing is known of it.
    """
    track = job.first(targets).run(**how)
    d = job.imm.space.dims
    worst = 0.0
    for target in range(targets):
        imm = filterpy_imm(job, member)
        for k, z in enumerate(columns(job, target)):
            imm.predict(0)
            imm.update(z)
            std = np.sqrt(np.diag(imm.P))
            P = track.position_covariance[target, k] - imm.P[:d, :d]
            worst = max(
                worst,
                float(np.max(np.abs(track.mean[target, k] - imm.x[:, 0]) / std)),
                float(np.max(np.abs(P) / np.outer(std[:d], std[:d]))),
                float(np.max(np.abs(track.mode_probability[target, k] - imm.mu))),
            )
    return worst


def has_stone_soup() -> bool:
    """Whether Stone Soup is installed (extra ``bench``)."""
    return find_spec("stonesoup") is not None


class StoneSoup:
    """Stone Soup's extended Kalman filter with one constant-velocity model, in 2-D.

    Its state is x, vx, y, vy, with time stamps; a measurement of differences is a class of ours,
    for it ships with none.
    """

    def __init__(self, job: Job, psd: float) -> None:
        from stonesoup.base import Property
        from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
        from stonesoup.models.transition.linear import (
            CombinedLinearGaussianTransitionModel,
            ConstantVelocity,
        )
        from stonesoup.predictor.kalman import ExtendedKalmanPredictor
        from stonesoup.types.array import StateVector
        from stonesoup.updater.kalman import ExtendedKalmanUpdater

        class RangeDifferences(NonLinearGaussianMeasurement):  # type: ignore[misc]
            seen: Differences = Property()

            @property
            def ndim_meas(self) -> int:
                return len(self.seen.h)

            def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
                self.seen.look(np.asarray(state.state_vector)[[0, 2]])
                return StateVector(self.seen.h)

            def jacobian(self, state: Any, **kwargs: Any) -> Array:
                self.seen.look(np.asarray(state.state_vector)[[0, 2]])
                return self.seen.H[:, [0, 2, 1, 3]]

        seen = Differences(job.imm.measurement.stations.positions, 4)  # type: ignore[attr-defined]
        R = job.imm.measurement.noise_covariance(np.zeros(2), np.zeros(2), 0.0)
        self.measurement = RangeDifferences(ndim_state=4, mapping=(0, 2), noise_covar=R, seen=seen)
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(psd)] * 2)
        self.predictor = ExtendedKalmanPredictor(motion)
        self.updater = ExtendedKalmanUpdater(self.measurement)
        self.order = [0, 2, 1, 3]  # ours to theirs, and back
        self.job = job

    def follow(self, targets: int) -> Array:
        """Track the first targets of the job; return the last means (targets, 4)."""
        from stonesoup.types.detection import Detection
        from stonesoup.types.hypothesis import SingleHypothesis
        from stonesoup.types.state import GaussianState

        job, order, zero = self.job, self.order, datetime(2000, 1, 1)
        x, P = job.start.means[0][order], job.start.covariances[0][np.ix_(order, order)]
        clock = [zero + timedelta(seconds=t) for t in job.times.tolist()]
        last = []
        for target in range(targets):
            state = GaussianState(x[:, None], P, timestamp=zero)
            for time, z in zip(clock, columns(job, target), strict=True):
                prediction = self.predictor.predict(state, timestamp=time)
                heard = Detection(z, timestamp=time, measurement_model=self.measurement)
                state = self.updater.update(SingleHypothesis(prediction, heard))
            last.append(np.asarray(state.state_vector, dtype=float)[order, 0])
        return np.array(last)
