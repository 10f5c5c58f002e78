"""The track that records hold."""

from __future__ import annotations

import numpy as np

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
    return Track(
        times=times,
        log_mode_probability=whole[..., at.log_p : at.log_likelihood],
        log_likelihood=whole[..., at.log_likelihood],
        nis=whole[..., at.nis],
        nis_dof=whole[..., at.dof].astype(np.int64),
        mode_log_likelihood=whole[..., at.mode_log_likelihood : at.mode_nis],
        mode_nis=whole[..., at.mode_nis : at.row_weight],
        mode_means=means,
        mode_covariances=covariances,
        row_weight=whole[..., at.row_weight : at.lost],
        lost=feeding.flag(plan, whole, at.lost),
        reopened=feeding.flag(plan, whole, at.reopened),
        bank=bank,
        space=state.space,
        modes=state.modes,
        update="ekf",
        engine="compiled",
        keep=keep,
    )
