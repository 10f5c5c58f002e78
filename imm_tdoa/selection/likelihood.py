"""How likely a whole recording is under one motion model that starts at a known state.

The Kalman filter of a model that starts at x0 without uncertainty gives log p(Z | x0) as a sum
over prediction errors (Schweppe 1965); the derivative of its estimate by x0, carried along by
X <- F (I - K H) X, gives the slope -H X of those errors. For a linear Gaussian model both are
exact, process noise or not; without process noise they are those of nonlinear least squares.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa import gaussian, observation, prediction
from imm_tdoa.contract import Array, Index, MotionModel
from imm_tdoa.observation import Observation
from imm_tdoa.scans import Scans
from imm_tdoa.statespace import state_space


class Slope(NamedTuple):
    """Minus twice the log-likelihood around an initial state x0 (..., n).

    Attributes
    ----------
    cost : (...)
        -2 log p(Z | x0); not finite where x0 is impossible.
    normal : (..., n, n)
        Information about x0 in the scans, the sum of (H X)' S^-1 (H X).
    downhill : (..., n)
        Sum of (H X)' S^-1 nu; the Gauss-Newton step d solves ``normal d = downhill``.
    rows : (...) int
        Scalar rows used, shared offsets eliminated.
    """

    cost: Array
    normal: Array
    downhill: Array
    rows: Index


@attrs.frozen(eq=False)
class Likelihood:
    """The likelihood of scans under a motion model, as a function of the state at the first scan.

    Attributes
    ----------
    model : MotionModel
        How the emitter moves; its process noise counts.
    scans : Scans
        Values (..., T, m); NaN is missing.
    weight : (..., T, m), optional
        Share of its information that each row keeps, above 0: its noise variance is divided by
        it. None: all of it.
    """

    model: MotionModel
    scans: Scans
    weight: Array | None = None
    position: Index = attrs.field(init=False)
    velocity: Index = attrs.field(init=False)
    unknowns: int = attrs.field(init=False)
    noiseless: bool = attrs.field(init=False)

    def __attrs_post_init__(self) -> None:
        dims = self.scans.measurement.dims
        space = state_space([self.model], ["model"], dims, {})
        Q = self.model.process_noise(np.diff(self.scans.times), dims)
        for name, value in (
            ("position", space.position[0]),
            ("velocity", space.velocity[0]),
            ("unknowns", len(space.components)),
            ("noiseless", not np.any(Q) and getattr(self.model, "composes", True)),
        ):
            object.__setattr__(self, name, value)

    def __call__(self, x0: Array) -> Slope:
        """Return cost and slope at the initial states `x0` (..., n)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._straight(x0) if self.noiseless else self._filtered(x0)

    def _straight(self, x0: Array) -> Slope:
        """Without process noise all scans follow from x0 directly: time is one more batch axis."""
        scans = self.scans
        after = scans.times - scans.times[..., :1]
        X = self.model.jacobian(x0[..., None, :], after)
        x = self.model.propagate(x0[..., None, :], after)
        seen = self._look(scans.together(), x, scans.times, scans.values, self.weight)
        part = _whitened(seen, X, None)
        return Slope(
            cost=part.cost.sum(axis=-1),
            normal=np.einsum("...tri,...trj->...ij", part.HX, part.HX),
            downhill=np.einsum("...tri,...tr->...i", part.HX, part.nu),
            rows=part.rows.sum(axis=-1),
        )

    def _filtered(self, x0: Array) -> Slope:
        """Step a Kalman filter that starts at x0 without uncertainty through the scans."""
        scans, n = self.scans, self.unknowns
        dims = scans.measurement.dims
        batch = np.broadcast_shapes(x0.shape[:-1], scans.batch)
        x, P = np.broadcast_to(x0, (*batch, n)), np.zeros((*batch, n, n))
        X = np.broadcast_to(np.eye(n), (*batch, n, n))
        cost, rows = np.zeros(batch), np.zeros(batch, dtype=np.int64)
        normal, downhill = np.zeros((*batch, n, n)), np.zeros((*batch, n))
        for k in range(scans.count):
            if k > 0:
                dt = scans.times[..., k] - scans.times[..., k - 1]
                X = self.model.jacobian(x, dt) @ X
                x, P, _ = prediction.predict(self.model, x, P, dt, dims)
            z = scans.values[..., k, :]
            if not np.any(np.isfinite(z)):
                continue
            weight = None if self.weight is None else self.weight[..., k, :]
            seen = self._look(scans.measured_at(k), x, scans.times[..., k], z, weight)
            part = _whitened(seen, X, P)
            cost, rows = cost + part.cost, rows + part.rows
            normal = normal + _t(part.HX) @ part.HX
            downhill = downhill + np.einsum("...ri,...r->...i", part.HX, part.nu)
            x, X = x + (part.G @ part.nu[..., None])[..., 0], X - part.G @ part.HX
            I_KH, K = np.eye(n) - part.K @ part.H, part.K
            P = gaussian.symmetric(I_KH @ P @ _t(I_KH) + K @ part.R @ _t(K))
        return Slope(cost, normal, downhill, rows)

    def _look(
        self, measurement: object, x: Array, time: Array, z: Array, weight: Array | None
    ) -> Observation:
        seen = observation.observe(
            measurement,  # type: ignore[arg-type]
            [x],
            [self.position],
            [self.velocity],
            time,
            z,
        )
        if weight is not None:
            share = np.sqrt(weight[..., observation.usable_rows(z)])
            R = seen.R[0] / (share[..., :, None] * share[..., None, :])
            seen = attrs.evolve(seen, R=(R,))
        return observation.without_offsets(seen)


class _Part(NamedTuple):
    """One scan in units of its innovation covariance S = L L'.

    `nu` is L^-1 nu, `HX` is L^-1 H X; the gain is K = G L^-1.
    """

    nu: Array
    HX: Array
    G: Array
    K: Array
    H: Array
    R: Array
    cost: Array
    rows: Index


def _whitened(seen: Observation, X: Array, P: Array | None) -> _Part:
    """Whiten a scan against predictions of covariance `P` (None: certain ones) and slope `X`."""
    nu, H, R = gaussian.mask_rows(seen.nu[0], seen.H[0], seen.R[0], seen.present)
    HP = np.zeros_like(H) if P is None else H @ P
    L = gaussian.factor(gaussian.symmetric(HP @ _t(H) + R))
    blocks = [nu[..., None], H @ X] if P is None else [nu[..., None], H @ X, HP]
    white = np.asarray(np.linalg.solve(L, np.concatenate(blocks, axis=-1)), dtype=np.float64)
    n = X.shape[-1]
    w, G = white[..., 0], _t(white[..., n + 1 :])
    K = G if P is None else _t(np.linalg.solve(_t(L), _t(G)))
    rows = np.count_nonzero(seen.present, axis=-1)
    log_det = 2.0 * np.sum(np.log(np.einsum("...ii->...i", L)), axis=-1)
    cost = np.einsum("...r,...r->...", w, w) + log_det + rows * gaussian.LOG_2PI
    return _Part(w, white[..., 1 : n + 1], G, K, H, R, cost, np.asarray(rows))


def _t(matrix: Any) -> Array:
    result: Array = np.swapaxes(matrix, -1, -2)
    return result
