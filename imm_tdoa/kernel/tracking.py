"""The track that records hold."""

from __future__ import annotations

from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array
from imm_tdoa.kernel import feeding
from imm_tdoa.kernel.plan import Plan
from imm_tdoa.state import State
from imm_tdoa.track import Track


def track_of(plan: Plan, whole: Array, times: Array, state: State, bank: Bank, keep: str) -> Track:
    """Return the track of records (..., K, size) after scans at `times` (K,) or (..., K)."""
    at = plan.record
    means, covariances = feeding.modes(plan, whole)
    said = feeding.taken(plan, whole)
    return Track(
        times=times,
        log_mode_probability=whole[..., at.log_p : at.log_likelihood],
        log_likelihood=whole[..., at.log_likelihood],
        nis=said.nis,
        nis_dof=said.nis_dof,
        mode_log_likelihood=said.mode_log_likelihood,
        mode_nis=said.mode_nis,
        mode_means=means,
        mode_covariances=covariances,
        row_weight=said.row_weight,
        lost=feeding.flag(plan, whole, at.lost),
        reopened=said.reopened,
        bank=bank,
        space=state.space,
        modes=state.modes,
        update="ekf",
        engine="compiled",
        keep=keep,
    )
