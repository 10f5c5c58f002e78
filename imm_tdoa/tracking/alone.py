"""Each target for itself: the likeliest of the rows that fit it together."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.tracking.gates import innovations, threshold
from imm_tdoa.tracking.rows import Association, Prediction, Unlabelled, decided

SEEDS = 12  # values of the first row that are tried, the nearest ones


def likeliest(
    prediction: Prediction,
    scan: Unlabelled,
    density: Array,
    detection_probability: float,
    gate_probability: float = 0.9999,
) -> Association:
    """Return for each target the rows that it has most likely, whoever else takes them.

    A young track's rows are uncertain together, not one by one: once one is known, the others
    are. Every value of one row that passes the gate is tried (and none); the other rows follow
    one after another, each given those before it. The best total counts.

    Parameters
    ----------
    prediction : Prediction
        What each target is expected to be measured as.
    scan : Unlabelled
        The rows, without emissions.
    density : (m,)
        Density of false values of each row.
    detection_probability, gate_probability : float
        Of a row of a target, and of it passing the gate.
    """
    mean, S = prediction.bank()
    N, m = mean.shape
    own = {
        int(i): np.flatnonzero((scan.row == i) & np.isfinite(scan.values))
        for i in np.unique(scan.row[np.isfinite(scan.values)])
    }
    taken = np.full((N, m), -1, dtype=np.int64)
    if N == 0 or not own:
        return decided(taken, prediction, scan)
    order = sorted(own, key=lambda i: len(own[i]))
    hit = np.log(detection_probability) - np.log(density) - 0.5 * np.log(2.0 * np.pi)
    miss = float(np.log1p(-min(detection_probability, 0.999)))
    gate = float(threshold(gate_probability, np.array([1]))[0])
    chain = _Chain(prediction, scan, own, order, hit, miss, gate)
    best = np.full(N, -np.inf)
    first = order[0]
    away = np.abs(
        innovations(scan.values[own[first]][:, None], mean[:, [first]], chain.angle(first))
    )
    nearest = np.argsort(away[..., 0], axis=1, kind="stable")[:, :SEEDS]
    for k in range(nearest.shape[1] + 1):
        seed = own[first][nearest[:, k]] if k < nearest.shape[1] else np.full(N, -1)
        members, total = chain(mean, S, seed)
        better = total > best
        taken = np.where(better[:, None], members, taken)
        best = np.where(better, total, best)
    taken[~prediction.known] = -1
    return decided(taken, prediction, scan)


class _Chain:
    """Rows taken one after another, each given those before it."""

    def __init__(
        self,
        prediction: Prediction,
        scan: Unlabelled,
        own: dict[int, Index],
        order: list[int],
        hit: Array,
        miss: float,
        gate: float,
    ) -> None:
        self.known, self.angular = prediction.known, prediction.angular
        self.scan, self.own, self.order = scan, own, order
        self.hit, self.miss, self.gate = hit, miss, gate

    def angle(self, i: int) -> Mask:
        result: Mask = self.angular[[i]]
        return result

    def __call__(self, mean: Array, S: Array, seed: Index) -> tuple[Index, Array]:
        """Members (N, m) and log-ratio (N,) with value `seed` (N,) of the first row; -1 none."""
        N, m = mean.shape
        n = np.arange(N)
        members = np.full((N, m), -1, dtype=np.int64)
        total = np.zeros(N)
        for i in self.order:
            k = self.own[i]
            nu = innovations(self.scan.values[k][:, None], mean[:, [i]], self.angle(i))[..., 0]
            variance = S[:, i, i]
            if i == self.order[0]:
                choice = np.argmax(k[None] == seed[:, None], axis=1)
                free = seed >= 0
            else:
                choice = np.argmin(np.abs(nu), axis=1)
                free = np.ones(N, dtype=bool)
            v = nu[n, choice]
            nis = v**2 / variance
            take = free & (nis <= self.gate) & self.known[:, i]
            gain = self.hit[i] - 0.5 * (nis + np.log(variance))
            take &= (gain > self.miss) | (i == self.order[0])
            members[take, i] = k[choice[take]]
            total += np.where(take, gain, np.where(self.known[:, i], self.miss, 0.0))
            w = np.where(take[:, None], S[:, :, i] / variance[:, None], 0.0)
            mean = mean + w * v[:, None]
            S = S - w[:, :, None] * S[:, None, i, :]
            floor = 1e-9 * variance
            S[n, i, i] = np.maximum(S[n, i, i], floor)
        return members, total
