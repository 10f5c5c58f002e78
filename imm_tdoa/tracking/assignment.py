"""Global nearest neighbour: the cheapest one-to-one assignment of rows to targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import attrs
import numpy as np
from scipy.optimize import linear_sum_assignment

from imm_tdoa import _validate
from imm_tdoa.contract import Array, Index
from imm_tdoa.tracking.gates import fit, gate_probability, innovations, threshold
from imm_tdoa.tracking.rows import Association, Block, Prediction, Unlabelled, decided

Over = Literal["station", "scan"]
SWEEPS = 20


def assign(cost: Any, unassigned: Any = 0.0) -> Index:
    """Return the candidate (N,) of each target, -1 being none, at the least total cost.

    Parameters
    ----------
    cost : (N, L)
        What it costs that target n has candidate l; infinity forbids it.
    unassigned : float or (N,)
        What it costs that a target has none.

    Raises
    ------
    ValueError
        NaN or -infinity among the costs, an infinite cost of having none, wrong shapes.
    """
    C = np.array(cost, dtype=float)
    if C.ndim != 2:
        raise ValueError(f"cost: expected shape (N, L), got {C.shape}")
    if np.any(np.isnan(C) | np.isneginf(C)):
        raise ValueError("cost: expected numbers or infinity, got NaN or -infinity")
    N, L = C.shape
    none = _validate.array("unassigned", unassigned)
    if none.shape not in ((), (N,)):
        raise ValueError(f"unassigned: expected one cost or {N} of them, got shape {none.shape}")
    alone = np.where(np.eye(N, dtype=bool), np.broadcast_to(none, (N,))[:, None], np.inf)
    row, column = linear_sum_assignment(np.concatenate([C, alone], axis=1))
    result = np.full(N, -1, dtype=np.int64)
    result[row] = np.where(column < L, column, -1)
    return result


@attrs.frozen
class GlobalNearest:
    """Targets and values are paired one to one, so that all pairs together fit best.

    The cost of a pair is the normalised innovation squared from the prediction of the target's
    whole bank plus log det S, so that targets of different certainty compare. Values outside the
    gate are never taken. A target that takes none pays the price of what it leaves.

    Parameters
    ----------
    over : "scan" or "station"
        ``"station"``: each station by itself. ``"scan"``: all stations together; the cost of a
        target is that of all its rows under their joint covariance, so that rows which
        contradict each other do not go to one target. Each station's pairing is optimal given
        the others' (the many-dimensional assignment itself is NP-hard), begun once with the
        clearest station and once with every station by itself; the cheaper end is kept.
        Where the scan says which values are of one emission, each target takes one emission.
    gate_probability : float
        Probability that a target's own value passes the gate.
    unassigned : float, optional
        Price of one row left, in units of the cost. Default: what the least certain target would
        pay for it on the edge of its gate, so that no value within a gate is left without need.
    """

    over: Over = attrs.field(default="scan", kw_only=True)
    gate_probability: float = attrs.field(default=0.9999, kw_only=True, converter=gate_probability)
    unassigned: float | None = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        _validate.one_of("over", self.over, get_args(Over))
        if self.unassigned is not None:
            _validate.array("unassigned", self.unassigned, ())

    def __call__(self, prediction: Prediction, scan: Unlabelled) -> Association:
        """Return the pairs."""
        taken = np.full((prediction.count, prediction.size), -1, dtype=np.int64)
        if prediction.count == 0:
            return decided(taken, prediction, scan)
        contest = _Contest(prediction, scan, self.gate_probability, self.unassigned)
        alone = contest.alone()
        if self.over == "scan" and len(contest.blocks) > 1:
            ends = [contest.settle(begin) for begin in (contest.one_by_one(), alone)]
            alone = min(ends, key=contest.total)
        for block, choice in zip(contest.blocks, alone, strict=True):
            n = np.flatnonzero(choice >= 0)
            taken[n[:, None], block.columns] = block.members[choice[n]]
        taken[~prediction.known] = -1
        return decided(taken, prediction, scan)


class _Contest:
    """Prices and gates of one scan, and the cost of any choice of candidates.

    A choice is a list with an array (N,) per block: which candidate each target has, -1 none.
    """

    def __init__(
        self,
        prediction: Prediction,
        scan: Unlabelled,
        gate_probability: float,
        unassigned: float | None,
    ) -> None:
        mean, S = prediction.bank()
        self.S, self.known = S, prediction.known
        self.blocks: list[Block] = scan.blocks(prediction.size)
        self.nu, self.price, self.gated, self.cost = [], [], [], []
        for block in self.blocks:
            c = block.columns
            nu = innovations(block.z, mean[:, c], prediction.angular[c])
            seen = fit(nu, S[:, c[:, None], c], self.known[:, c])
            gate = threshold(gate_probability, seen.rows)
            gated = seen.nis <= gate
            if unassigned is None:
                edge = np.where(gated, gate + seen.log_det, -np.inf)
                price = np.max(edge, axis=0, initial=-np.inf)
                price = np.broadcast_to(np.where(np.isfinite(price), price, 0.0), gated.shape)
            else:
                price = unassigned * seen.rows
            self.nu.append(seen.nu)
            self.price.append(price)
            self.gated.append(gated)
            self.cost.append(np.where(gated, seen.nis + seen.log_det - price, np.inf))

    def alone(self) -> list[Index]:
        """Return the best choice at every station by itself."""
        return [assign(cost) for cost in self.cost]

    def one_by_one(self) -> list[Index]:
        """Return the choice made at the clearest station first, each given those before it."""
        choice = [np.full(len(self.S), -1, dtype=np.int64) for _ in self.blocks]
        for b in np.argsort([np.count_nonzero(g) for g in self.gated], kind="stable"):
            choice[b] = self._given(choice, int(b))
        return choice

    def settle(self, choice: Sequence[Index]) -> list[Index]:
        """Improve a choice station by station until nothing changes."""
        choice = list(choice)
        for _ in range(SWEEPS):
            before = list(choice)
            for b in range(len(self.blocks)):
                new = self._given(choice, b)
                if not np.array_equal(new, choice[b]):
                    trial = [*choice[:b], new, *choice[b + 1 :]]
                    if self.total(trial) < self.total(choice):
                        choice = trial
            if all(np.array_equal(a, c) for a, c in zip(before, choice, strict=True)):
                break
        return choice

    def total(self, choice: Sequence[Index]) -> float:
        """Return the cost of all targets together, each by the joint covariance of its rows."""
        nu = self._rows(choice)
        seen = fit(nu[:, None, :], self.S, self.known)
        n = np.arange(len(nu))
        prices = sum(
            float(np.sum(np.where(c >= 0, price[n, c], 0.0)))
            for c, price in zip(choice, self.price, strict=True)
        )
        return float(np.sum(seen.nis + seen.log_det)) - prices

    def _rows(self, choice: Sequence[Index]) -> Array:
        """Innovations (N, m) of what each target has; NaN is nothing."""
        nu = np.full(self.known.shape, np.nan)
        for block, own, c in zip(self.blocks, self.nu, choice, strict=True):
            n = np.flatnonzero(c >= 0)
            nu[n[:, None], block.columns] = own[n, c[n]]
        return np.where(self.known, nu, np.nan)

    def _given(self, choice: Sequence[Index], b: int) -> Index:
        """Return the best choice at single-row block `b`, given the choices at the others."""
        i = int(self.blocks[b].columns[0])
        nu = self._rows(choice)
        nu[:, i] = np.nan
        there = np.isfinite(nu)
        both = there[:, :, None] & there[:, None, :]
        s = np.where(there, self.S[:, :, i], 0.0)
        w = np.linalg.solve(np.where(both, self.S, np.eye(nu.shape[-1])), s[..., None])[..., 0]
        mean = np.sum(w * np.where(there, nu, 0.0), axis=-1)
        variance = self.S[:, i, i] - np.sum(w * s, axis=-1)
        nis = (self.nu[b][..., 0] - mean[:, None]) ** 2 / variance[:, None]
        cost = nis + np.log(variance)[:, None] - self.price[b]
        return assign(np.where(self.gated[b], cost, np.inf))
