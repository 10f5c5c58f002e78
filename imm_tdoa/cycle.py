"""One cycle of the IMM: mix, predict, update, weigh (Blom & Bar-Shalom 1988; ALGORITHMS §9.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import attrs
import numpy as np
import scipy

from imm_tdoa import gaussian, initiation, mixture, observation, robust, update
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.mixing import Hypotheses, Merging, hypotheses, merge
from imm_tdoa.observation import Observation
from imm_tdoa.prediction import predict
from imm_tdoa.reopening import choose, widen
from imm_tdoa.sigma_points import Rule
from imm_tdoa.state import State, Taken

UpdateRule = Literal["ekf", "iekf", "ukf", "ckf"]
RobustRule = Literal["gate", "student-t"]
UPDATES: tuple[str, ...] = get_args(UpdateRule)
ROBUST: tuple[str, ...] = get_args(RobustRule)


@attrs.frozen(eq=False)
class Cycle:
    """How a bank takes in one scan; the parameters are those of `imm_tdoa.imm.IMM`."""

    bank: Bank
    update: UpdateRule
    merging: Merging
    robust: RobustRule | None
    gate_probability: float
    degrees_of_freedom: float
    reopen_after: int

    @property
    def rule(self) -> Rule | None:
        """The sigma points, where the update is made of some."""
        return self.update if self.update == "ukf" or self.update == "ckf" else None

    def __call__(
        self,
        state: State,
        time: Array,
        dt: Array,
        chain: Array,
        z: Array,
        measurement: MeasurementModel,
    ) -> State:
        """Return the state after the scan `z` (..., m) at `time` (...), `dt` after the last."""
        predicted = self._predict(state, dt, chain)
        opens = state.trust.opens
        if np.any(opens):
            predicted = self._reopen(state, predicted, time)
        batch = np.broadcast_shapes(predicted.log_weight.shape[:-1], z.shape[:-1], time.shape)
        state = attrs.evolve(
            state,
            time=time,
            log_likelihood=np.broadcast_to(state.log_likelihood, batch),
        )
        taken = Taken.nothing(batch, len(state.modes), measurement.size)
        taken = attrs.evolve(taken, reopened=np.broadcast_to(opens, batch))
        if np.any(np.isfinite(z)):
            return self._weigh(state, predicted, taken, z, measurement)
        means, Ps, log_c = merge(
            predicted, predicted.means, predicted.covariances, predicted.log_weight
        )
        return attrs.evolve(
            state, means=means, covariances=Ps, log_mode_probability=log_c, taken=taken
        )

    def _predict(self, state: State, dt: Array, chain: Array) -> Hypotheses:
        mixed = hypotheses(state, chain, dt > 0.0, self.bank.mixing, self.merging)
        predictions = [
            predict(self.bank.models[j], x, P, dt, state.space.dims, self.rule)
            for j, x, P in zip(mixed.mode, mixed.means, mixed.covariances, strict=True)
        ]
        return attrs.evolve(
            mixed,
            means=tuple(p.x for p in predictions),
            covariances=tuple(p.P for p in predictions),
        )

    def _reopen(self, state: State, predicted: Hypotheses, time: Array) -> Hypotheses:
        """Predict lost targets from when they were last trusted, widened by the birth law."""
        trust = state.trust
        gap = np.where(trust.opens, time - trust.since, 0.0)
        last = attrs.evolve(
            state,
            means=trust.means,
            covariances=trust.covariances,
            log_mode_probability=trust.log_mode_probability,
        )
        anew = self._predict(last, gap, self.bank.chain(gap))
        wide = widen(anew.covariances, anew.mode, state.space, self.bank.birth_std, gap)
        pairs = zip(anew.means, predicted.means, strict=True)
        return attrs.evolve(
            predicted,
            means=tuple(choose(trust.opens, a, b, 1) for a, b in pairs),
            covariances=tuple(
                choose(trust.opens, a, b, 2)
                for a, b in zip(wide, predicted.covariances, strict=True)
            ),
            log_weight=choose(trust.opens, anew.log_weight, predicted.log_weight, 1),
        )

    def _weigh(
        self,
        state: State,
        predicted: Hypotheses,
        taken: Taken,
        z: Array,
        measurement: MeasurementModel,
    ) -> State:
        """Update each hypothesis with the scan and weigh it by how well it foresaw it."""
        x, P, log_c = predicted.means, predicted.covariances, predicted.log_weight
        position = [state.space.position[j] for j in predicted.mode]
        velocity = [state.space.velocity[j] for j in predicted.mode]

        def look(states: Sequence[Array]) -> Observation:
            return observation.observe(
                measurement, states, position, velocity, state.time, z, P, self.rule
            )

        seen = look(x)
        weight = np.exp(log_c)
        reading = robust.plainly(seen)
        if self.robust is not None:
            judged = observation.with_sources(
                seen, measurement, x[0], position[0], velocity[0], state.time, z
            )
            if self.robust == "gate":
                if self.update == "iekf":
                    judged = update.curvature(
                        measurement, x, P, position, velocity, state.time, z, judged
                    )
                threshold = scipy.special.chdtri(1.0, 1.0 - self.gate_probability)
                reading = robust.gate(judged, log_c, P, threshold)
            else:
                reading = robust.student_t(judged, log_c, P, self.degrees_of_freedom)
            seen = reading(seen)
        rows = observation.usable_rows(z)
        if self.update == "iekf":

            def elsewhere(lost: Mask) -> list[Array] | None:
                whole = (reading.row_weight > 0.5) & lost[..., None]
                kept = np.full((*lost.shape, z.shape[-1]), np.nan)
                kept[..., rows] = np.where(whole, z[..., rows], np.nan)
                std = initiation.velocity_std(self.bank, state.space)
                return update.at_own_fix(measurement, state.time, kept, x, P, position, std)

            seen, updates = update.iterated(
                lambda states: reading(look(states)), seen, x, P, elsewhere
            )
        else:
            seen, updates = update.extended(seen, x, P)
        log_l = np.stack([u.log_likelihood for u in updates], axis=-1)
        means, covariances, log_joint = merge(
            predicted, [u.x for u in updates], [u.P for u in updates], log_c + log_l
        )
        log_p, log_L = mixture.normalise(log_joint)
        unexplained = ~np.isfinite(log_L)
        if np.any(unexplained):
            when = np.broadcast_to(state.time, unexplained.shape)[unexplained][0]
            raise ValueError(
                f"values: at time {when:g} s no mode can explain the measurement "
                f"(its likelihood is zero or not a number in every mode)"
            )
        nu, S = observation.mixture_innovation(seen, weight, P)
        dof = np.broadcast_to(np.count_nonzero(seen.present, axis=-1), log_L.shape)
        white = np.linalg.solve(gaussian.innovation_factor(S), nu[..., None])[..., 0]
        row_weight = np.array(taken.row_weight)
        row_weight[..., rows] = reading.row_weight
        mode_log_l, mode_nis = _by_mode(predicted, log_l, np.stack([u.nis for u in updates], -1))
        empty = dof == 0
        taken = attrs.evolve(
            taken,
            nis=np.where(empty, np.nan, np.einsum("...i,...i->...", white, white)),
            nis_dof=dof,
            mode_log_likelihood=mode_log_l + reading.price[..., None],
            mode_nis=np.where(empty[..., None], np.nan, mode_nis),
            row_weight=row_weight,
        )
        batch = log_L.shape
        heard = np.broadcast_to(reading.pieces > 0, batch)
        rejected = np.broadcast_to(reading.rejected, batch)
        trust = state.trust
        if self.robust is not None:
            trust = trust.after(
                heard, rejected, self.reopen_after, state.time, means, covariances, log_p
            )
        return attrs.evolve(
            state,
            means=means,
            covariances=covariances,
            log_mode_probability=log_p,
            log_likelihood=state.log_likelihood + log_L + reading.price,
            taken=taken,
            trust=trust,
        )


def _by_mode(predicted: Hypotheses, log_l: Array, nis: Array) -> tuple[Array, Array]:
    """Log-likelihood and NIS (..., r) of each mode, averaged over the hypotheses that are its."""
    r = max(predicted.mode) + 1
    if len(predicted.mode) == r:
        return log_l, nis
    logs, means = [], []
    for j in range(r):
        own = [h for h, mode in enumerate(predicted.mode) if mode == j]
        share, total = mixture.normalise(predicted.log_weight[..., own])
        first = np.where(np.arange(len(own)) == 0, 0.0, -np.inf)
        share = np.where(np.isfinite(total)[..., None], share, first)
        logs.append(mixture.normalise(share + log_l[..., own])[1])
        means.append(np.sum(np.exp(share) * nis[..., own], axis=-1))
    return np.stack(logs, axis=-1), np.stack(means, axis=-1)
