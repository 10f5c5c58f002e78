"""The Gaussian-sum filter (Alspach & Sorenson 1972; ALGORITHMS §7.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import attrs
import numpy as np

from imm_tdoa import _validate, mixture
from imm_tdoa._validate import fitting, refuse_backwards
from imm_tdoa.contract import AXES, Array, MeasurementModel, MotionModel
from imm_tdoa.cycle import UPDATES, UpdateRule
from imm_tdoa.gaussian_sum.state import SumState, padded
from imm_tdoa.gaussian_sum.track import SumTrack
from imm_tdoa.mixture import Distance, Mixture
from imm_tdoa.observation import Observation, observe
from imm_tdoa.prediction import predict
from imm_tdoa.registry import name_of
from imm_tdoa.scans import Scans
from imm_tdoa.sigma_points import Rule
from imm_tdoa.statespace import StateSpace, apply_lift, lift, state_space
from imm_tdoa.update import extended, iterated


@attrs.frozen(eq=False)
class GaussianSum:
    """Many Kalman filters on one motion model, each begun at a hypothesis of its own.

    Parameters
    ----------
    motion : MotionModel
        How the emitter moves.
    measurement : MeasurementModel
        What is measured; its stations fix the number of space dimensions.
    update : "ekf", "iekf", "ukf" or "ckf"
        How a component predicts and takes in a measurement, as in `imm_tdoa.IMM`.
    merge_distance : float or None
        Components closer than this are merged after each scan (`imm_tdoa.mixture.merge`): metres
        between their positions with `merge_by` ``"euclidean"``, sigmas times the root of their
        share of the weight with ``"mahalanobis"``. None: never.
    merge_by : "euclidean" or "mahalanobis"
        What the distance is.
    prune_below : float
        Components with less weight are dropped after each scan, the heaviest excepted.
    birth_std : mapping, optional
        Standard deviations, by kind or name as in `imm_tdoa.Bank`, of what hypotheses of the
        position alone leave open (``{"velocity": 10.0}``).

    Raises
    ------
    ValueError
        No motion or measurement model, an unknown rule, a distance or weight out of range.

    Examples
    --------
    >>> gs = GaussianSum(Static(psd=0.0), TDOA(stations, toa_sigma=70e-9))
    >>> start = gaussian_sum.hyperbola(gs.measurement, times[0], values[0], reach=50e3)
    >>> track = gs.run(times[1:], values[1:], gs.start(times[0], *start))
    """

    motion: MotionModel
    measurement: MeasurementModel
    update: UpdateRule = attrs.field(default="ekf", kw_only=True)
    merge_distance: float | None = attrs.field(default=None, kw_only=True)
    merge_by: Distance = attrs.field(default="euclidean", kw_only=True)
    prune_below: float = attrs.field(default=1e-5, kw_only=True)
    birth_std: Mapping[str, float] = attrs.field(factory=dict, kw_only=True)
    space: StateSpace = attrs.field(init=False, repr=False)

    def __attrs_post_init__(self) -> None:
        for name, kind in (("motion", MotionModel), ("measurement", MeasurementModel)):
            model = getattr(self, name)
            if isinstance(model, type) or not isinstance(model, kind):
                raise ValueError(f"{name}: no {name} model: {model!r}")
        _validate.one_of("update", self.update, UPDATES)
        if self.merge_distance is not None:
            _validate.positive("merge_distance", self.merge_distance)
        _validate.one_of("merge_by", self.merge_by, get_args(Distance))
        if not _validate.non_negative("prune_below", self.prune_below) < 1.0:
            raise ValueError(
                f"prune_below: expected a weight, 0 to less than 1, got {self.prune_below!r}"
            )
        for kind_name, std in self.birth_std.items():
            _validate.non_negative(f"birth_std[{kind_name!r}]", std)
        space = state_space([self.motion], [name_of(self.motion)], self.measurement.dims, {})
        object.__setattr__(self, "space", space)

    def start(
        self, time: float | Array, means: Any, covariances: Any, weights: Any = None
    ) -> SumState:
        """Return the sum before any measurement that is to come.

        Parameters
        ----------
        time : float or (...)
            Time, s.
        means : (..., N, n) or (..., N, d)
            A state per hypothesis, or a position; what the motion has beyond it follows from
            `birth_std`, mean zero.
        covariances : (..., N, n, n) or (..., N, d, d)
            Covariance of each.
        weights : (..., N), optional
            Weights, made to sum to one; zero is an empty slot. Default equal.

        Raises
        ------
        ValueError
            Shapes that do not fit, numbers that are not finite, a covariance that is none,
            negative weights, or a sum of zero.
        """
        components, d = self.space.components, self.space.dims
        x = _validate.array("means", means, (None, "N", "n"))
        N, n = x.shape[-2:]
        if N == 0:
            raise ValueError("means: expected at least one hypothesis, got none")
        if n not in (d, len(components)):
            raise ValueError(
                f"means: expected {len(components)} components ({', '.join(components)}) or "
                f"{d} (position), got {n}"
            )
        P = _validate.covariance("covariances", covariances, n)
        w = _validate.array("weights", np.ones(N) if weights is None else weights, (None, N))
        if np.any(w < 0.0) or not np.all(np.any(w > 0.0, axis=-1)):
            raise ValueError("weights: expected weights of at least 0, not all of them 0")
        time = _validate.array("time", time)
        batch = fitting(
            means=x.shape[:-2], covariances=P.shape[:-3], weights=w.shape[:-1], time=time.shape
        )
        x = np.broadcast_to(x, (*batch, N, n))
        P = np.broadcast_to(P, (*batch, N, n, n))
        if n < len(components):
            x, P = apply_lift(lift(AXES[:d], components, self.birth_std), x, P, None)
        with np.errstate(divide="ignore"):
            log_w, _ = mixture.normalise(np.broadcast_to(np.log(w), (*batch, N)))
        start = padded(Mixture(log_w, x, P))
        return SumState(
            time=time,
            means=start.x,
            covariances=start.P,
            log_weight=start.log_weight,
            log_likelihood=np.zeros(batch),
            nis=np.full((*batch, N), np.nan),
            nis_dof=np.zeros(batch, dtype=np.int64),
            space=self.space,
        )

    def step(
        self, state: SumState, time: float | Array, values: Any, pairs: Any = None
    ) -> SumState:
        """Return the sum after a scan: predict, update, weigh, merge, prune (§7.1-5, 6).

        Parameters
        ----------
        state : SumState
            What `start` or the last step returned.
        time : float or (...)
            Time of the scan, s, not before the state's.
        values : (..., m)
            What was measured; NaN is missing.
        pairs : (..., m, 2) int, optional
            Station pairs of this scan's rows, for a measurement of pairs.

        Raises
        ------
        ValueError
            A time before the state's, infinite values, a wrong number of rows, a scan that is
            impossible under every component.
        """
        self._refuse_foreign("state", state)
        measurement = self.measurement
        if pairs is not None:
            measurement = measurement.with_pairs(pairs)
        z = _validate.array("values", values, (None, measurement.size), finite=False)
        time = _validate.array("time", time)
        fitting(state=state.log_likelihood.shape, time=time.shape, values=z.shape[:-1])
        refuse_backwards("time", "state", state.time, time)
        return self._step(state, time, z, _for_each(measurement, pairs))

    def run(self, times: Any, values: Any, start: SumState, pairs: Any = None) -> SumTrack:
        """Take in a whole recording.

        Parameters
        ----------
        times : (T,) or (..., T)
            Times of the scans, s, not decreasing, none before the start's.
        values : (..., T, m)
            Rows of each scan; NaN is missing. Leading axes are targets, or Monte-Carlo runs.
        start : SumState
            Where to start; every scan is an update.
        pairs : (T, m, 2) or (..., T, m, 2) int, optional
            Station pairs of each row, where they change from scan to scan.

        Raises
        ------
        ValueError
            Decreasing times, shapes that do not fit, and what `step` refuses.
        """
        scans = Scans.checked(self.measurement, times, values, pairs)
        self._refuse_foreign("start", start)
        fitting(start=start.log_likelihood.shape, times_and_values=scans.batch)
        refuse_backwards("times", "start", start.time, scans.times[..., 0])
        states, state = [], start
        for k in range(scans.count):
            scan_pairs = None if scans.pairs is None else scans.pairs[..., k, :, :]
            measured = _for_each(scans.measured_at(k), scan_pairs)
            state = self._step(state, scans.times[..., k], scans.values[..., k, :], measured)
            states.append(state)
        return SumTrack.from_states(states, scans.times)

    def _refuse_foreign(self, name: str, state: SumState) -> None:
        if not isinstance(state, SumState) or state.components != self.space.components:
            raise ValueError(
                f"{name}: expected a state of this motion's components, as GaussianSum.start "
                f"makes it"
            )

    def _step(
        self, state: SumState, time: Array, z: Array, measurement: MeasurementModel
    ) -> SumState:
        """Take in a scan `z` (..., m); `measurement` has an axis for the components."""
        dt = np.asarray(time - state.time)[..., None]
        x, P, _ = predict(
            self.motion, state.means, state.covariances, dt, self.space.dims, self._rule
        )
        batch = np.broadcast_shapes(state.log_likelihood.shape, z.shape[:-1], time.shape)
        N, n = x.shape[-2:]
        x, P = np.broadcast_to(x, (*batch, N, n)), np.broadcast_to(P, (*batch, N, n, n))
        log_w = np.broadcast_to(state.log_weight, (*batch, N))
        log_l, nis = np.zeros(log_w.shape), np.full(log_w.shape, np.nan)
        dof = np.zeros(batch, dtype=np.int64)
        if np.any(np.isfinite(z)):
            x, P, log_l, nis, dof = self._take_in(x, P, time, z, measurement)
        log_w, log_L = mixture.normalise(log_w + log_l)
        if not np.all(np.isfinite(log_L)):
            raise ValueError(
                f"values: at time {np.max(time):g} s no component can explain the measurement "
                f"(its likelihood is zero or not a number in every one)"
            )
        nis = np.where(np.isneginf(log_w) | (dof == 0)[..., None], np.nan, nis)
        left = padded(self._reduce(Mixture(log_w, x, P)))
        return attrs.evolve(
            state,
            time=time,
            means=left.x,
            covariances=left.P,
            log_weight=left.log_weight,
            log_likelihood=state.log_likelihood + log_L,
            nis=nis,
            nis_dof=np.broadcast_to(dof, batch),
        )

    def _take_in(
        self, x: Array, P: Array, time: Array, z: Array, measurement: MeasurementModel
    ) -> tuple[Array, Array, Array, Array, Any]:
        """Update every component; return also log-likelihoods, NIS (..., N) and rows (...)."""
        clock, rows = time[..., None], z[..., None, :]

        def look(states: Any) -> Observation:
            p, v = self.space.position, self.space.velocity
            seen = observe(measurement, states, p, v, clock, rows, [P], self._rule)
            # A row that one component cannot foresee counts in none: likelihoods must compare.
            every = np.all(seen.present, axis=-2, keepdims=True)
            return attrs.evolve(seen, present=np.broadcast_to(every, seen.present.shape))

        seen = look([x])
        free, (updated,) = extended(seen, [x], [P])
        nis = updated.nis  # judges the prediction, however the update is made
        if self.update == "iekf":
            _, (updated,) = iterated(look, seen, [x], [P])
        dof = np.count_nonzero(free.present[..., 0, :], axis=-1)
        return updated.x, updated.P, updated.log_likelihood, nis, dof

    @property
    def _rule(self) -> Rule | None:
        return self.update if self.update == "ukf" or self.update == "ckf" else None

    def _reduce(self, sum_: Mixture) -> Mixture:
        if self.merge_distance is not None:
            position = self.space.position[0]
            sum_ = mixture.merge(sum_, self.merge_distance, self.merge_by, position)
        return sum_._replace(log_weight=mixture.prune(sum_.log_weight, self.prune_below))


def _for_each(measurement: MeasurementModel, pairs: Any) -> MeasurementModel:
    """Return the measurement with an axis for the components, where its pairs have batch axes."""
    if pairs is None or np.ndim(pairs) == 2:
        return measurement
    return measurement.with_pairs(np.asarray(pairs)[..., None, :, :])
