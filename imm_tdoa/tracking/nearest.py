"""Per-station nearest neighbour, as Source A has it (its eq. 12; ALGORITHMS §5.1, §5.2-6)."""

from __future__ import annotations

from typing import Any, Literal, get_args

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.tracking.gates import innovations
from imm_tdoa.tracking.rows import Association, Prediction, Unlabelled, decided

NoMatch = Literal["drop", "predicted"]


def _gamma(value: Any) -> float:
    return _validate.positive("gamma", value)


def _mu(value: Any) -> float | None:
    return None if value is None else _validate.positive("mu", value)


@attrs.frozen
class Nearest:
    """Each target takes at each station the value nearest its prediction, if near enough.

    Source A, eq. (12): of the values ``tau_l`` of station i, ``l* = argmin |tau_hat_i - tau_l|``
    is the target's if its distance is below ``mu``. Targets and stations do not know of each
    other: two targets may take the same value, and emissions are not kept together. Of equally
    near values the first is taken.

    Parameters
    ----------
    gamma : float
        The gate in standard deviations: ``mu = gamma sqrt(S_ii)``, S the innovation covariance
        of the whole bank.
    mu : float, optional
        The gate as a fixed distance instead, internal units (metres).
    no_match : "drop" or "predicted"
        What a row without a match becomes. ``"drop"``: it is missing. ``"predicted"``: its own
        prediction, as printed in Source A: the estimate stays, but its covariance shrinks as if
        something had been measured (§5.2-6).
    """

    gamma: float = attrs.field(default=4.0, kw_only=True, converter=_gamma)
    mu: float | None = attrs.field(default=None, kw_only=True, converter=_mu)
    no_match: NoMatch = attrs.field(default="drop", kw_only=True)

    def __attrs_post_init__(self) -> None:
        _validate.one_of("no_match", self.no_match, get_args(NoMatch))

    def __call__(self, prediction: Prediction, scan: Unlabelled) -> Association:
        """Return the nearest value of each target and row."""
        mean, S = prediction.bank()
        reach = self._reach(S)
        taken = np.full(mean.shape, -1, dtype=np.int64)
        for block in attrs.evolve(scan, emission=None).blocks(prediction.size):
            i = block.columns[0]
            nu = innovations(block.z, mean[:, [i]], prediction.angular[[i]])[..., 0]
            nearest = np.argmin(np.abs(nu), axis=-1)
            distance = np.take_along_axis(np.abs(nu), nearest[:, None], axis=-1)[:, 0]
            match = prediction.known[:, i] & (distance < reach[:, i])
            taken[:, i] = np.where(match, block.members[nearest, 0], -1)
        result = decided(taken, prediction, scan)
        if self.no_match == "drop":
            return result
        fill = np.isnan(result.values) & prediction.known
        return attrs.evolve(result, values=np.where(fill, mean, result.values))

    def _reach(self, S: Array) -> Array:
        deviation = np.sqrt(np.einsum("...ii->...i", S))
        return self.gamma * deviation if self.mu is None else np.full_like(deviation, self.mu)
