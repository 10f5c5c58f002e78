"""Where a track starts when somebody says where: a mean and covariance become every mode's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import AXES, Array
from imm_tdoa.reopening import Trust
from imm_tdoa.state import State, Taken
from imm_tdoa.statespace import apply_lift, lift

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM


def start(
    imm: IMM,
    time: float | Array,
    mean: Any,
    covariance: Any,
    components: Sequence[str] | None = None,
) -> State:
    """Return the state before any measurement; see `IMM.start`."""
    space = imm.space
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
    given = set(components)
    fit = set(AXES[: space.dims]) <= given <= set(space.components)
    if not fit or len(given) != len(components) or len(components) != n:
        raise ValueError(
            f"components: expected {n} of {', '.join(space.components)}, the position among "
            f"them, got {components}"
        )
    P = _validate.covariance("covariance", covariance, n)
    time = _validate.array("time", time)
    batch = _validate.fitting(mean=mean.shape[:-1], covariance=P.shape[:-2], time=time.shape)
    mean = np.broadcast_to(mean, (*batch, n))
    P = np.broadcast_to(P, (*batch, n, n))
    parts = [
        apply_lift(lift(components, mode, imm.bank.birth_std), mean, P, None)
        for mode in space.modes
    ]
    with np.errstate(divide="ignore"):
        log_p = np.broadcast_to(np.log(imm.bank.prior), (*batch, len(imm.bank)))
    means, covariances = tuple(x for x, _ in parts), tuple(c for _, c in parts)
    return State(
        time=time,
        means=means,
        covariances=covariances,
        log_mode_probability=log_p,
        log_likelihood=np.zeros(batch),
        taken=Taken.nothing(batch, len(imm.bank), imm.measurement.size),
        trust=Trust.full(time, means, covariances, log_p),
        space=space,
        modes=imm.bank.names,
    )
