"""Looking back: fixed-interval smoothing of a track (ALGORITHMS §9.5).

Backwards over the track, every transition from a mode j to a mode i is one Rauch-Tung-Striebel
step of its own, states of unequal dimension matched by component name as in the filter; the steps
that leave j are merged by how likely each was, given everything that came later.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import attrs
import numpy as np

from imm_tdoa import backward, mixture
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, LinearMotion, Mask
from imm_tdoa.gaussian import predict_covariance
from imm_tdoa.sigma_points import Rule
from imm_tdoa.statespace import StateSpace, apply_lift
from imm_tdoa.track import Track

Method = Literal["pairwise", "kim"]


class _Modes(NamedTuple):
    """All modes at one time: means (..., n_j), covariances, log probabilities (..., r)."""

    x: tuple[Array, ...]
    P: tuple[Array, ...]
    log_p: Array


def smooth(track: Track, method: Method = "pairwise") -> Track:
    """Return the track given all its scans, not only those before each row.

    The pairwise smoother for a bank of models (family of Nadarajah, Tharmarasa, McDonald &
    Kirubarajan, IEEE TAES 48(3):2673-2678, 2012; here for unequal states, ALGORITHMS §9.5). With
    one mode it is Rauch, Tung & Striebel's (1965).

    Parameters
    ----------
    track : Track
        What `IMM.run` made of a recording.
    method : "pairwise" or "kim"
        ``"pairwise"`` asks of every pair of modes what the later scans say of it. ``"kim"`` is
        Kim's approximation (Journal of Econometrics 60:1-22, 1994): the mode before depends on
        the mode after by the chain alone, and every pair ends in the same place. For comparison:
        it can be worse than the filter.

    Returns
    -------
    Track
        `mean`, `covariance`, `mode_means`, `mode_covariances` and `log_mode_probability` given
        all scans, ``smoothed = True``; what tells of the filter's own steps (`log_likelihood`,
        `nis`, ...) as it was. The last row is the filter's.

    Raises
    ------
    ValueError
        An unknown method, or a track that is smoothed already.

    Notes
    -----
    The later scans say the same of mode i's state whichever mode j came before. The ratio of
    what is known of it with them and without them, N(x; x_s, P_s) / N(x; x_p, P_p) with the
    mixed prediction N(x_p, P_p) of mode i, is their likelihood L_i(x). So for each pair

        N(x_k; x_j, P_j) becomes N(x_k; x_j, P_j) times E[L_i(x_k+1) | x_k],
        Pr(j | i) is in proportion to pi_ji mu_j E[L_i(x_k+1) | j, i]:

    a Kalman update by what the future says, and its evidence. For one mode this is the formula of
    Rauch, Tung & Striebel; for several it replaces §9.5's density of the smoothed mean at one
    point, and keeps a pair from being pulled to where only other pairs lead. No prediction of a
    single pair is inverted, so modes that predict without variance are nothing special. The mixed
    prediction is the IMM's, also for a track that another merging strategy made.

    Nonlinear motion is linearised at the filter's estimate, then once more at the smoothed one
    (sigma points over it, for a track made with them; García-Fernández, Svensson & Särkkä, IEEE
    TSP 65(6):1626-1638, 2017). Nothing flows back across a row where the track was re-opened:
    what followed tells of another start. Rows of one instant have one state, that of the last.
    Rows before a target's start stay NaN.
    """
    if method not in ("pairwise", "kim"):
        raise ValueError(f"method: expected 'pairwise' or 'kim', got {method!r}")
    if not isinstance(track, Track):
        raise ValueError(f"track: expected a Track, got {track!r}")
    if track.keep != "all":
        raise ValueError(
            f"track: expected one of all scans, this has keep={track.keep!r}; run with keep='all'"
        )
    if track.smoothed:
        raise ValueError("track: it is smoothed already; smooth the track that the filter made")
    absent: Mask = np.isnan(track.log_likelihood)
    rows = _rows(track, absent)
    dt = np.diff(np.asarray(track.times, dtype=float), axis=-1)
    chain = track.bank.chain(dt)
    flows = ~(absent[..., 1:] | absent[..., :-1] | track.reopened[..., 1:])
    rule: Rule | None = "ukf" if track.update == "ukf" else "ckf" if track.update == "ckf" else None
    step = _Step(track.bank, track.space, rule, method)
    for k in range(len(rows) - 2, -1, -1):
        moves = flows[..., k] & (dt[..., k] > 0.0)
        still = flows[..., k] & ~moves
        here = rows[k]
        if np.any(still):
            rows[k] = _where(still, rows[k + 1], rows[k])
        if np.any(moves):
            back = step(here, rows[k + 1], dt[..., k], chain[..., k, :, :])
            rows[k] = _where(moves, back, rows[k])
    r = len(track.modes)
    x = tuple(np.stack([row.x[j] for row in rows], axis=-2) for j in range(r))
    P = tuple(np.stack([row.P[j] for row in rows], axis=-3) for j in range(r))
    log_p = np.stack([row.log_p for row in rows], axis=-2)
    result = attrs.evolve(
        track,
        mode_means=x,
        mode_covariances=P,
        log_mode_probability=log_p,
        smoothed=True,
    )
    return result.blanked(absent) if np.any(absent) else result


def _rows(track: Track, absent: Mask) -> list[_Modes]:
    """The filter's modes row by row; rows that are not there hold harmless numbers."""
    gone = absent[..., None]
    x = [np.where(gone, 0.0, mean) for mean in track.mode_means]
    P = [np.where(gone[..., None], np.eye(C.shape[-1]), C) for C in track.mode_covariances]
    log_p = np.where(gone, -np.log(len(track.modes)), track.log_mode_probability)
    return [
        _Modes(
            tuple(mean[..., k, :] for mean in x),
            tuple(C[..., k, :, :] for C in P),
            log_p[..., k, :],
        )
        for k in range(absent.shape[-1])
    ]


def _where(choose: Mask, a: _Modes, b: _Modes) -> _Modes:
    one, two = choose[..., None], choose[..., None, None]
    return _Modes(
        tuple(np.where(one, x, y) for x, y in zip(a.x, b.x, strict=True)),
        tuple(np.where(two, x, y) for x, y in zip(a.P, b.P, strict=True)),
        np.where(one, a.log_p, b.log_p),
    )


@attrs.frozen(eq=False)
class _Step:
    """One step back for a whole bank."""

    bank: Bank
    space: StateSpace
    rule: Rule | None
    method: Method

    def __call__(self, here: _Modes, later: _Modes, dt: Array, chain: Array) -> _Modes:
        """Return the modes smoothed, from those filtered `here` and those smoothed `later`.

        `dt` (...) s lie between them and `chain` (..., r, r) governs the switches.
        """
        r = len(self.bank)
        with np.errstate(divide="ignore"):
            log_joint = here.log_p[..., :, None] + np.log(chain)
        log_joint = np.swapaxes(log_joint, -1, -2)  # (..., i later, j here)
        pairs, evidence = [], []
        for i in range(r):
            x, P, log_density = self._into(i, here, later, dt, log_joint[..., i, :])
            pairs.append((x, P))
            evidence.append(log_density)
        came_from, _ = mixture.normalise(log_joint + np.stack(evidence, axis=-2))
        share = np.swapaxes(came_from + later.log_p[..., :, None], -1, -2)  # (..., j, i)
        weights, log_p = mixture.normalise(share)
        weight = np.where(np.isfinite(log_p)[..., None], np.exp(weights), np.eye(r))
        means, covariances = [], []
        for j in range(r):
            parts = [
                backward.returned(lift, here.x[j], here.P[j], x[..., j, :], P[..., j, :, :])
                for lift, (x, P) in zip(self.space.lifts[j], pairs, strict=True)
            ]
            mean, covariance = mixture.moments(
                weight[..., j, :],
                np.stack([x for x, _ in parts], axis=-2),
                np.stack([P for _, P in parts], axis=-3),
            )
            means.append(mean)
            covariances.append(covariance)
        return _Modes(tuple(means), tuple(covariances), mixture.normalise(log_p)[0])

    def _into(
        self, i: int, here: _Modes, later: _Modes, dt: Array, log_joint: Array
    ) -> tuple[Array, Array, Array]:
        """Smooth every mode j on its way into mode i, in i's components.

        Returns means (..., r, n_i), covariances, and the log-evidence (..., r) of the later scans
        for each j, up to what all have in common.
        """
        fill = {
            "birth": None,
            "unbiased": (here.x[i], here.P[i]),
            "zero": (np.zeros_like(here.x[i]), np.zeros_like(here.P[i])),
        }[self.bank.mixing]
        r, model, dims = len(self.bank), self.bank.models[i], self.space.dims
        lifted = [apply_lift(self.space.lifts[j][i], here.x[j], here.P[j], fill) for j in range(r)]
        x = np.stack([mean for mean, _ in lifted], axis=-2)
        P = np.stack([covariance for _, covariance in lifted], axis=-3)
        step = np.asarray(dt)[..., None]
        line = backward.linearised(model, x, P, step, dims, self.rule)
        if self.method == "kim":
            return *backward.regressed(x, P, line, later.x[i], later.P[i]), np.zeros_like(log_joint)
        weights, total = mixture.normalise(log_joint)
        weight = np.where(np.isfinite(total)[..., None], np.exp(weights), np.arange(r) == i)
        mixed, M = mixture.moments(weight, x, P)
        ahead = backward.linearised(model, mixed, M, np.asarray(dt), dims, self.rule)
        future = backward.future_of(
            ahead.y, predict_covariance(M, ahead.F, ahead.Q), later.x[i], later.P[i]
        )
        x_s, P_s, log_density = backward.updated(x, P, line, future)
        if not isinstance(model, LinearMotion):
            line = backward.linearised(model, x_s, P_s, step, dims, self.rule)
            y = line.y + np.einsum("...ij,...j->...i", line.F, x - x_s)
            x_s, P_s, log_density = backward.updated(x, P, line._replace(y=y), future)
        return x_s, P_s, log_density
