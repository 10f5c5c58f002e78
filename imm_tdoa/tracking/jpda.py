"""Joint probabilistic data association (JPDA) for banks of modes.

Bar-Shalom & Fortmann, Tracking and Data Association (1988), ch. 9; with several modes as in Chen
& Tugnait, Automatica 37(2):239-249 (2001). Each target is described by the Gaussian of its own
rows y, noise included, in each mode. "Candidate l is the target's" means that y has the
candidate's value where it was measured; "none" leaves y as it is. The mixture over these events
is matched by its moments, station after station, within each group of targets that share values
the clearest station first. The correlation of rows
that share a reference station is kept exactly, and the state follows from y (`soft_update`).
"""

from __future__ import annotations

from typing import Any, get_args

import attrs
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from imm_tdoa import _validate, gaussian, mixture
from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.tracking.gates import Fit, fit, gate_probability, innovations, threshold
from imm_tdoa.tracking.joint import EXACT_UP_TO, Permutations, marginals
from imm_tdoa.tracking.rows import Association, Block, Prediction, Unlabelled


def _probability(value: Any) -> float:
    number = _validate.positive("detection_probability", value)
    if number > 1.0:
        raise ValueError(f"detection_probability: expected at most 1, got {value!r}")
    return number


def _density(value: Any) -> Array:
    density = _validate.array("clutter_density", value)
    if density.ndim > 1 or np.any(density <= 0.0):
        raise ValueError(f"clutter_density: expected densities above 0, got {value!r}")
    return density


@attrs.frozen(eq=False)
class Jpda:
    """Every target takes a share of every value that could be its own.

    Parameters
    ----------
    detection_probability : float
        Probability that a station hears a target in a scan; with emissions, that it is heard.
    clutter_density : float or (m,)
        Expected number of false values of a row per scan and unit of the row (per metre). With
        emissions: their rows are as likely to be false as so many false values together.
    gate_probability : float
        Probability that a target's own value passes the gate: a chi-square test of the
        innovation from the prediction of the whole bank, the same gate for every mode.
    exact_up_to : int
        Up to what size of cluster the sums over joint events are exact
        (`imm_tdoa.tracking.joint.marginals`).
    permutations : "all" or "best"
        ``"all"``: JPDA as published; it draws targets that stay close together to one another.
        ``"best"``: JPDA*, which does not: who is who among targets that share values is decided.

    Notes
    -----
    The likelihood of a value is that of the bank's mixture. With w_j(l) = P_D Lambda_j(l)/lambda,
    w(none) = 1 - P_D P_G and e(l) what the other targets say (`log_extrinsic`, e(none) = 1), a
    mode's likelihood ratio is in every mode the same mixture, w(none) + sum over the gated l of
    w_j(l) e(l); divided by it, its terms are the mode's own association probabilities. A station
    without any value in the scan says nothing, not that it heard nobody.
    """

    detection_probability: float = attrs.field(converter=_probability)
    clutter_density: Array = attrs.field(converter=_density)
    gate_probability: float = attrs.field(default=0.9999, kw_only=True, converter=gate_probability)
    exact_up_to: int = attrs.field(default=EXACT_UP_TO, kw_only=True)
    permutations: Permutations = attrs.field(default="all", kw_only=True)

    def __attrs_post_init__(self) -> None:
        _validate.one_of("permutations", self.permutations, get_args(Permutations))
        if not isinstance(self.exact_up_to, int) or not 1 <= self.exact_up_to <= 16:
            raise ValueError(f"exact_up_to: expected a size from 1 to 16, got {self.exact_up_to!r}")

    def __call__(self, prediction: Prediction, scan: Unlabelled) -> Association:
        """Return every target's share of every value, and what its rows are believed to be."""
        N, r, m = prediction.mean.shape
        if self.clutter_density.ndim and self.clutter_density.shape != (m,):
            raise ValueError(
                f"clutter_density: expected one density or {m} of them, "
                f"got shape {self.clutter_density.shape}"
            )
        belief = _Belief(
            prediction.mean.copy(),
            prediction.covariance.copy(),
            prediction.log_weight.copy(),
            np.zeros((N, r)),
        )
        weight = np.zeros((N, len(scan.values)))
        blocks = scan.blocks(m) if N else []
        every = np.arange(N)
        gated = [self._gated(prediction, belief, every, block) for block in blocks]
        for targets in _groups(gated, N):
            pairs = [np.count_nonzero(g[targets]) for g in gated]
            for b in np.argsort(pairs, kind="stable"):
                own = blocks[b].part(np.flatnonzero(gated[b][targets].any(axis=0)))
                some, beta = self._take_in(prediction, belief, targets, own)
                belief.put(targets, some)
                n, k, q = np.nonzero(_rows_had(prediction, targets, own))
                weight[targets[n], own.members[k, q]] = beta[n, k]
        return Association(
            weight=weight,
            missed=1.0 - _by_row(weight, scan.row, m),
            values=np.full((N, m), np.nan),
            innovation=belief.mean - prediction.mean,
            covariance=belief.covariance,
            log_likelihood_ratio=belief.log_ratio,
        )

    def _gated(self, prediction: Prediction, belief: _Belief, targets: Index, block: Block) -> Mask:
        """Which candidates (n, L) the whole bank of each target finds possible."""
        c = block.columns
        mean, S = mixture.moments(
            np.exp(belief.log_weight), belief.mean[..., c], belief.covariance[..., c[:, None], c]
        )
        known = prediction.known[targets[:, None], c]
        seen = fit(innovations(block.z, mean, prediction.angular[c]), S, known)
        result: Mask = seen.nis <= threshold(self.gate_probability, seen.rows)
        return result

    def _take_in(
        self, prediction: Prediction, belief: _Belief, targets: Index, block: Block
    ) -> tuple[_Belief, Array]:
        """Return some targets' belief after a block, and their shares (n, L) of its candidates."""
        c = block.columns
        before = belief.of(targets)
        S = before.covariance[..., c[:, None], c]
        nu = innovations(block.z, before.mean[..., c], prediction.angular[c])
        seen = fit(nu, S, prediction.known[targets][:, None, c])
        density = np.log(np.broadcast_to(self.clutter_density, (prediction.size,)))[c]
        false = np.sum(np.where(seen.present, density, 0.0), axis=-1)
        log_l = seen.log_density - false + np.log(self.detection_probability)
        gated = self._gated(prediction, before, targets, block)
        log_l = np.where(gated[:, None], log_l, -np.inf)  # (n, r, L)
        log_miss = np.log1p(-self.detection_probability * self.gate_probability)
        joint = np.moveaxis(log_l + before.log_weight[..., None], 1, -1)
        log_detect = mixture.normalise(joint)[1]
        others = marginals(
            log_detect, np.full(len(targets), log_miss), self.exact_up_to, self.permutations
        )
        log_joint = np.concatenate([log_l, np.full((*log_l.shape[:2], 1), log_miss)], axis=-1)
        log_beta, log_ratio = mixture.normalise(log_joint + others.log_extrinsic[:, None])
        log_weight, _ = mixture.normalise(before.log_weight + log_ratio)
        mean, covariance = _matched(before, block, seen, np.exp(log_beta))
        after = _Belief(mean, covariance, log_weight, before.log_ratio + log_ratio)
        return after, others.beta[:, :-1]


@attrs.frozen(eq=False)
class _Belief:
    """What each target's rows are believed to be in each mode, while the stations pass."""

    mean: Array
    covariance: Array
    log_weight: Array
    log_ratio: Array

    def of(self, targets: Index) -> _Belief:
        return _Belief(
            self.mean[targets],
            self.covariance[targets],
            self.log_weight[targets],
            self.log_ratio[targets],
        )

    def put(self, targets: Index, some: _Belief) -> None:
        self.mean[targets] = some.mean
        self.covariance[targets] = some.covariance
        self.log_weight[targets] = some.log_weight
        self.log_ratio[targets] = some.log_ratio


def _groups(gated: list[Mask], N: int) -> list[Index]:
    """Targets that could share a value of any station; groups know nothing of each other."""
    near = np.eye(N, dtype=bool)
    for g in gated:
        near |= (g[:, None, :] & g[None, :, :]).any(axis=-1)
    count, group = connected_components(csr_array(near.astype(np.int8)), directed=False)
    return [np.flatnonzero(group == g) for g in range(count)]


def _rows_had(prediction: Prediction, targets: Index, block: Block) -> Mask:
    """Which of a candidate's numbers (n, L, q) a target would have as its rows."""
    known = prediction.known[targets][:, None, block.columns]
    result: Mask = known & (block.members >= 0)
    return result


def _by_row(weight: Array, row: Index, size: int) -> Array:
    """Sum weights (N, K) over the values of each row (N, m); at most 1, rounding or not."""
    total = np.zeros((len(weight), size))
    for i in range(size):
        total[:, i] = weight[:, row == i].sum(axis=1)
    return np.minimum(total, 1.0)


def _matched(belief: _Belief, block: Block, seen: Fit, beta: Array) -> tuple[Array, Array]:
    """Moments (N, r, m), (N, r, m, m) of the rows over the events of a block.

    `beta` (N, r, L + 1) are the events' probabilities in each mode, the last column "none".
    """
    S, c = belief.covariance, block.columns
    some, none = beta[..., :-1], beta[..., -1]
    if len(c) == 1:
        gain = S[..., c] / S[..., c, c][..., None, :]
        step = gain[..., None, :, 0] * seen.nu  # (N, r, L, m)
        left = S - gain * S[..., None, c[0], :]
        left = _exact_zero(left, c)
        spread = np.sum(some, axis=-1)[..., None, None] * left
    else:
        both = seen.present[..., :, None] & seen.present[..., None, :]
        inner = np.where(both, S[..., None, c[:, None], c], np.eye(len(c)))
        across = np.where(seen.present[..., :, None], S[..., None, c, :], 0.0)
        gain = np.swapaxes(np.linalg.solve(inner, across), -1, -2)  # (N, r, L, m, q)
        step = np.einsum("...mq,...q->...m", gain, seen.nu)
        lefts = S[..., None, :, :] - gain @ across
        spread = np.einsum("...l,...lab->...ab", some, lefts)
    mean = np.einsum("...l,...la->...a", some, step)
    second = np.einsum("...l,...la,...lb->...ab", some, step, step)
    covariance = none[..., None, None] * S + spread + second
    covariance = covariance - mean[..., :, None] * mean[..., None, :]
    return belief.mean + mean, gaussian.symmetric(covariance)


def _exact_zero(left: Array, column: Any) -> Array:
    """Nothing is left of the variance of a row that is known; rounding must not make it less."""
    left = left.copy()
    left[..., column, :] = 0.0
    left[..., :, column] = 0.0
    return left


def soft_update(
    x: Array, P: Array, H: Array, R: Array, innovation: Array, covariance: Array
) -> tuple[Array, Array]:
    """Return a state's mean (..., n) and covariance (..., n, n) given its rows' moments.

    With the gain K of an ordinary update, x + K innovation and P - K (S - covariance) K', in the
    Joseph form that stays positive semi-definite. With one row this is the update of probabilistic
    data association, its combined innovation and its spread of the innovations; with rows that
    are known, covariance 0, the Kalman update; with rows that nothing was learnt of, covariance
    S = H P H' + R and innovation 0, no update.

    Parameters
    ----------
    x, P : (..., n), (..., n, n)
        Predicted mean and covariance of a mode.
    H : (..., m, n)
        Jacobian of the rows.
    R : (..., m, m)
        Noise covariance of the rows.
    innovation, covariance : (..., m), (..., m, m)
        What the rows were less the prediction, and what is left of their covariance
        (`Association.innovation`, `Association.covariance`).
    """
    HP = H @ P
    S = gaussian.symmetric(HP @ np.swapaxes(H, -1, -2) + R)
    L = gaussian.factor(S)
    A = np.linalg.solve(L, HP)
    K = np.swapaxes(np.linalg.solve(np.swapaxes(L, -1, -2), A), -1, -2)
    I_KH = np.eye(P.shape[-1]) - K @ H
    Kt = np.swapaxes(K, -1, -2)
    after = I_KH @ P @ np.swapaxes(I_KH, -1, -2) + K @ (R + covariance) @ Kt
    return x + np.einsum("...ij,...j->...i", K, innovation), gaussian.symmetric(after)
