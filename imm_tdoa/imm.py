"""The interacting multiple model estimator (Blom & Bar-Shalom 1988; ALGORITHMS §9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import attrs
import numpy as np
from scipy.stats import chi2

from imm_tdoa import _validate, gaussian, initiation, mixture, observation
from imm_tdoa.bank import Bank
from imm_tdoa.contract import AXES, Array, Index, MeasurementModel, MotionModel
from imm_tdoa.scans import Scans
from imm_tdoa.state import State
from imm_tdoa.statespace import StateSpace, apply_lift, lift
from imm_tdoa.track import Track


@attrs.frozen(eq=False)
class IMM:
    """Motion models in parallel on one measurement model, weighed and mixed.

    Parameters
    ----------
    bank : Bank
        The motion models and the chain between them.
    measurement : MeasurementModel
        What is measured; its stations fix the number of space dimensions.
    update : "ekf"
        How a mode takes in a measurement: extended Kalman filter.
    robust : None or "gate"
        ``"gate"``: rows that contradict the bank's prediction are left out, judged by a
        chi-square test of the mixture innovation, row by row with correlations (data snooping),
        and alike in every mode. A row left out never shrinks a covariance.
    gate_probability : float
        Probability that a good row passes the gate.

    Examples
    --------
    >>> imm = IMM(bank, TDOA(stations, toa_sigma=70e-9))
    >>> track = imm.run(times, values)
    """

    bank: Bank = attrs.field(validator=attrs.validators.instance_of(Bank))
    measurement: MeasurementModel
    update: Literal["ekf"] = attrs.field(default="ekf", kw_only=True)
    robust: Literal["gate"] | None = attrs.field(default=None, kw_only=True)
    gate_probability: float = attrs.field(default=0.999, kw_only=True)

    def __attrs_post_init__(self) -> None:
        if isinstance(self.measurement, type) or not isinstance(self.measurement, MeasurementModel):
            raise ValueError(f"measurement: no measurement model: {self.measurement!r}")
        if self.update != "ekf":
            raise ValueError(f"update: expected 'ekf', got {self.update!r}")
        if self.robust not in (None, "gate"):
            raise ValueError(f"robust: expected None or 'gate', got {self.robust!r}")
        if not 0.0 < self.gate_probability < 1.0:
            raise ValueError(
                f"gate_probability: expected a probability between 0 and 1, "
                f"got {self.gate_probability!r}"
            )

    @property
    def space(self) -> StateSpace:
        """How the modes' states fit together."""
        return self.bank.space(self.measurement.dims)

    def start(
        self,
        time: float | Array,
        mean: Any,
        covariance: Any,
        components: Sequence[str] | None = None,
    ) -> State:
        """Return the state before any measurement.

        Parameters
        ----------
        time : float or (...)
            Time, s.
        mean : (..., n)
            Mean of all the bank's components (`space.components`), or of the position only; or
            of the given `components`. What a mode has beyond it comes from the birth law.
        covariance : (..., n, n)
            Covariance of `mean`.
        components : sequence of str, optional
            Names of the components given, positions first.
        """
        space = self.space
        mean = _validate.array("mean", mean, (None, "n"))
        n = mean.shape[-1]
        if components is None:
            if n not in (space.dims, len(space.components)):
                raise ValueError(
                    f"mean: expected {space.dims} components (position) or "
                    f"{len(space.components)} ({', '.join(space.components)}), got {n}"
                )
            components = AXES[:n] if n == space.dims else space.components
        components = tuple(components)
        unknown = [c for c in components if c not in space.components]
        if len(components) != n or unknown or not set(AXES[: space.dims]) <= set(components):
            raise ValueError(
                f"components: expected {n} of {', '.join(space.components)}, the position among "
                f"them, got {components}"
            )
        P = _validate.covariance("covariance", covariance, n)
        batch = np.broadcast_shapes(mean.shape[:-1], P.shape[:-2], np.shape(time))
        mean = np.broadcast_to(mean, (*batch, n))
        P = np.broadcast_to(P, (*batch, n, n))
        parts = [
            apply_lift(lift(components, mode, self.bank.birth_std), mean, P, None)
            for mode in space.modes
        ]
        with np.errstate(divide="ignore"):
            log_p = np.broadcast_to(np.log(self.bank.prior), (*batch, len(self.bank)))
        return State(
            time=_validate.array("time", time),
            means=tuple(x for x, _ in parts),
            covariances=tuple(c for _, c in parts),
            log_mode_probability=log_p,
            log_likelihood=np.zeros(batch),
            nis=np.full(batch, np.nan),
            nis_dof=np.zeros(batch, dtype=np.int64),
            space=space,
            modes=self.bank.names,
        )

    def step(
        self,
        state: State,
        time: float | Array,
        values: Any,
        pairs: Any = None,
        measurement: MeasurementModel | None = None,
    ) -> State:
        """Return the state after a scan: mix, predict, update, weigh (§9.1).

        Parameters
        ----------
        state : State
            What `start` or the last step returned.
        time : float or (...)
            Time of the scan, s; at the state's own time nothing mixes and no mode switches.
        values : (..., m)
            What was measured; NaN is missing.
        pairs : (..., m, 2) int, optional
            Station pairs of this scan's rows, for a measurement of pairs.
        measurement : MeasurementModel, optional
            What was measured this time, where it is not what the IMM was made with.

        Raises
        ------
        ValueError
            A time before the state's, infinite values, a wrong number of rows.
        """
        measurement = self.measurement if measurement is None else measurement
        if pairs is not None:
            measurement = measurement.with_pairs(pairs)
        z = _validate.array("values", values, (None, measurement.size), finite=False)
        time = _validate.array("time", time)
        dt = time - state.time
        if np.any(dt < 0.0):
            raise ValueError(
                f"time: expected a time at or after the state's, {np.max(state.time):g} s, "
                f"got {np.min(time):g} s"
            )
        return self._advance(state, time, dt, self.bank.chain(dt), z, measurement)

    def _advance(
        self,
        state: State,
        time: Array,
        dt: Array,
        chain: Array,
        z: Array,
        measurement: MeasurementModel,
    ) -> State:
        x, P, log_c = mix(state, chain, self.bank.mixing)
        x, P = predict(self.bank.models, x, P, dt, state.space.dims)
        batch = np.broadcast_shapes(log_c.shape[:-1], z.shape[:-1], time.shape)
        state = attrs.evolve(state, time=time, means=x, covariances=P, log_mode_probability=log_c)
        if not np.any(np.isfinite(z)):
            dof = np.zeros(batch, dtype=np.int64)
            return attrs.evolve(state, nis=np.full(batch, np.nan), nis_dof=dof)
        return self._weigh(state, measurement, z, batch)

    def _weigh(
        self, state: State, measurement: MeasurementModel, z: Array, batch: tuple[int, ...]
    ) -> State:
        """Update each mode with the scan `z` and weigh the modes by how well they foresaw it."""
        space, P, log_c = state.space, state.covariances, state.log_mode_probability
        seen = observation.observe(
            measurement, state.means, space.position, space.velocity, state.time, z
        )
        c = np.exp(log_c)
        if self.robust == "gate":
            threshold = float(chi2.ppf(self.gate_probability, 1))
            seen = observation.gated(seen, c, P, threshold)
        seen = observation.without_offsets(seen)
        updates = [
            gaussian.update(xj, Pj, nu, H, R, seen.present)
            for xj, Pj, nu, H, R in zip(state.means, P, seen.nu, seen.H, seen.R, strict=True)
        ]
        log_joint = log_c + np.stack([u.log_likelihood for u in updates], axis=-1)
        log_p, log_L = mixture.normalise(log_joint)
        if not np.all(np.isfinite(log_L)):
            raise ValueError(
                f"values: at time {np.max(state.time):g} s no mode can explain the measurement "
                f"(its likelihood is zero or not a number in every mode)"
            )
        nu, S = observation.mixture_innovation(seen, c, P)
        dof = np.broadcast_to(np.count_nonzero(seen.present, axis=-1), batch)
        white = np.linalg.solve(gaussian.factor(S), nu[..., None])[..., 0]
        nis = np.where(dof > 0, np.einsum("...i,...i->...", white, white), np.nan)
        return attrs.evolve(
            state,
            means=tuple(u.x for u in updates),
            covariances=tuple(u.P for u in updates),
            log_mode_probability=log_p,
            log_likelihood=state.log_likelihood + log_L,
            nis=nis,
            nis_dof=dof,
        )

    def run(
        self,
        times: Any,
        values: Any,
        start: State | None = None,
        pairs: Any = None,
        engine: Literal["auto", "numpy"] = "auto",
    ) -> Track:
        """Track through a whole recording.

        Parameters
        ----------
        times : (T,) or (..., T)
            Times of the scans, s, not decreasing.
        values : (..., T, m)
            Rows of each scan; NaN is missing. Leading axes are targets that share the
            measurement model.
        start : State, optional
            Where to start; then every scan is an update. Without it the track starts from a fix
            made of as many first scans as a position takes (one, where it is complete): the fix
            is row 0 of the track and uses those scans up, updates begin with the next.
        pairs : (T, m, 2) or (..., T, m, 2) int, optional
            Station pairs of each row, where they change from scan to scan.
        engine : "auto" or "numpy"
            What computes; both are NumPy.

        Returns
        -------
        Track
            One row per scan, from the first that has a state. In a batch the rows of a target
            that starts later than others are NaN until then.

        Raises
        ------
        ValueError
            Decreasing times, shapes that do not fit, values that determine no position.
        """
        if engine not in ("auto", "numpy"):
            raise ValueError(f"engine: expected 'auto' or 'numpy', got {engine!r}")
        scans = Scans.checked(self.measurement, times, values, pairs)
        if start is None:
            state, first = initiation.start_from_scans(self, scans)
        else:
            state, first = start, np.full(start.log_likelihood.shape, -1)
            if np.any(scans.times[..., 0] < start.time):
                raise ValueError(
                    f"times: expected times at or after the start's, {np.max(start.time):g} s, "
                    f"got {np.min(scans.times):g} s"
                )
        return self._run(scans, state, first)

    def _run(self, scans: Scans, state: State, first: Index) -> Track:
        """Step through the scans after `first` (...), the last that each target's fix used.

        A target waits for its own start by steps of no length without measurement, which leave
        it as it is.
        """
        begin = int(first.min())
        later = slice(begin + 1, None)
        clock = np.maximum(scans.times[..., later], state.time[..., None])
        dt = np.diff(
            clock, axis=-1, prepend=np.broadcast_to(state.time[..., None], (*clock.shape[:-1], 1))
        )
        chain = self.bank.chain(dt)
        waiting = np.arange(begin + 1, scans.count) <= first[..., None]
        values = np.where(waiting[..., None], np.nan, scans.values[..., later, :])
        states = [state] if begin >= 0 else []
        for k in range(values.shape[-2]):
            state = self._advance(
                state,
                clock[..., k],
                dt[..., k],
                chain[..., k, :, :],
                values[..., k, :],
                scans.measured_at(begin + 1 + k),
            )
            states.append(state)
        rows = slice(max(begin, 0), None)
        track = Track.from_states(states, scans.times[..., rows])
        absent = np.arange(max(begin, 0), scans.count) < first[..., None]
        return track.blanked(absent) if np.any(absent) else track


def mix(
    state: State, chain: Array, mixing: str
) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
    """Mix the modes before prediction (§9.1 steps 1 and 2), states matched by component (§9.3).

    Parameters
    ----------
    state : State
        The modes after the last scan.
    chain : (..., r, r)
        Transition probabilities over the step; rows sum to one.
    mixing : "birth", "unbiased" or "zero"
        What fills the components a mode lacks.

    Returns
    -------
    means, covariances : tuple of (..., n_j), (..., n_j, n_j)
        Each mode's mixed initial condition.
    log_probability : (..., r)
        Predicted mode probabilities. A mode that cannot be reached keeps its own state and has
        probability zero.
    """
    r = len(state.modes)
    if r == 1:
        return state.means, state.covariances, state.log_mode_probability
    with np.errstate(divide="ignore"):
        log_joint = state.log_mode_probability[..., :, None] + np.log(chain)
    weights, log_c = mixture.normalise(np.swapaxes(log_joint, -1, -2))  # (..., target, source)
    reachable = np.isfinite(log_c)[..., None]
    weight = np.where(reachable, np.exp(weights), np.eye(r))
    means, covariances = [], []
    for j in range(r):
        fill = {
            "birth": None,
            "unbiased": (state.means[j], state.covariances[j]),
            "zero": (np.zeros_like(state.means[j]), np.zeros_like(state.covariances[j])),
        }[mixing]
        parts = [
            apply_lift(state.space.lifts[i][j], state.means[i], state.covariances[i], fill)
            for i in range(r)
        ]
        x, P = mixture.moments(
            weight[..., j, :],
            np.stack([x for x, _ in parts], axis=-2),
            np.stack([P for _, P in parts], axis=-3),
        )
        means.append(x)
        covariances.append(P)
    return tuple(means), tuple(covariances), log_c


def predict(
    models: Sequence[MotionModel],
    means: Sequence[Array],
    covariances: Sequence[Array],
    dt: Array,
    dims: int,
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Predict every mode by `dt` (...) with its own model (§9.1 step 3)."""
    x = tuple(model.propagate(mean, dt) for model, mean in zip(models, means, strict=True))
    P = tuple(
        gaussian.predict_covariance(cov, model.jacobian(mean, dt), model.process_noise(dt, dims))
        for model, mean, cov in zip(models, means, covariances, strict=True)
    )
    return x, P
