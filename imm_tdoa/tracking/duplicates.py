"""Two tracks of one target: which are, and which of them goes."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import attrs
import numpy as np
from scipy.special import chdtri

from imm_tdoa import _validate
from imm_tdoa.contract import AXES, Array, Index, Mask, component_names
from imm_tdoa.state import State
from imm_tdoa.tracking.batches import select
from imm_tdoa.tracking.standing import Standing


@runtime_checkable
class Merging(Protocol):
    """Anything that finds tracks that repeat others."""

    def __call__(self, state: State, standing: Standing, confirmed: Mask, identity: Index) -> Index:
        """Return into which track (N,) each merges, by its place; -1 where it stays."""
        ...


@attrs.frozen
class Duplicates:
    """Tracks that cannot be told apart by position and velocity are one.

    The confirmed one stays, of two on trial the one that explained more since both were there.
    Two confirmed tracks are only merged when one of them is hardly heard any more: two targets
    that fly together are each heard.

    Parameters
    ----------
    probability : float
        Tracks are the same when they differ by less than this share of such differences would
        (a chi-square quantile).
    scans : int
        Scans over which a confirmed track must have been heard in less than half, to be merged.
    age : int
        Scans that tracks on trial must be old to be merged: before, those that began from
        different fixes do not differ by more than they know, and the wrong one may stay.
    """

    probability: float = attrs.field(default=0.2, kw_only=True)
    scans: int = attrs.field(default=6, kw_only=True)
    age: int = attrs.field(default=4, kw_only=True)

    def __attrs_post_init__(self) -> None:
        if not _validate.positive("probability", self.probability) < 1.0:
            raise ValueError(
                f"probability: expected a number between 0 and 1, got {self.probability!r}"
            )
        for name, value in (("scans", self.scans), ("age", self.age)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")

    def __call__(self, state: State, standing: Standing, confirmed: Mask, identity: Index) -> Index:
        """Return into which track (N,) each merges; -1 where it stays."""
        N = len(identity)
        into = np.full(N, -1, dtype=np.int64)
        if N < 2:
            return into
        old = np.flatnonzero(confirmed | (standing.age >= self.age))
        x, P = _kinematics(select(state, old))
        a, b = self._close(x, P)
        a, b = old[a], old[b]
        if not len(a):
            return into
        hits = standing.hits_in(self.scans)
        starving = 2 * hits < np.minimum(standing.chances, self.scans)
        lead = _lead(standing.gains, a, b)
        first = np.where(confirmed[a] == confirmed[b], lead > 0.0, confirmed[a])
        tied = (confirmed[a] == confirmed[b]) & (lead == 0.0)
        first = np.where(tied, identity[a] < identity[b], first)
        better, worse = np.where(first, [a, b], [b, a])
        both = confirmed[better] & confirmed[worse]
        weak = np.where(both & starving[better] & ~starving[worse], better, worse)
        strong = np.where(weak == worse, better, worse)
        merge = np.where(both, starving[weak] & ~starving[strong], ~starving[strong])
        for k in np.argsort(-np.abs(lead), kind="stable"):
            if merge[k] and into[strong[k]] < 0 and into[weak[k]] < 0:
                into[weak[k]] = strong[k]
        return into

    def _close(self, x: Array, P: Array) -> tuple[Index, Index]:
        """Pairs of tracks that cannot be told apart."""
        d2 = chdtri(float(x.shape[-1]), 1.0 - self.probability)
        reach = np.sqrt(np.einsum("nii->ni", P))
        near = np.ones((len(x), len(x)), dtype=bool)
        for i in range(x.shape[-1]):  # no component further apart than the whole may be
            apart = np.abs(x[:, None, i] - x[None, :, i])
            near &= apart**2 <= d2 * (reach[:, None, i] ** 2 + reach[None, :, i] ** 2)
        a, b = np.nonzero(np.triu(near, 1))
        if not len(a):
            return a, b
        delta = x[a] - x[b]
        C = 0.5 * (P[a] + P[b])  # they saw the same rows: their errors are not independent
        C = C + 1e-12 * np.einsum("nii->ni", C)[:, :, None] * np.eye(x.shape[-1])
        close = np.einsum("ni,ni->n", delta, np.linalg.solve(C, delta[..., None])[..., 0]) <= d2
        return a[close], b[close]


def _lead(gains: Array, a: Index, b: Index) -> Array:
    """How much more tracks `a` explained than `b`, in the scans in which both were there."""
    common = np.isfinite(gains[a]) & np.isfinite(gains[b])
    result: Array = np.sum(np.where(common, gains[a] - gains[b], 0.0), axis=1)
    return result


def _kinematics(state: State) -> tuple[Array, Array]:
    """Position and velocity (N, 2d), as far as the bank has one, and their covariance."""
    d = state.space.dims
    names = component_names(d, 1) if component_names(d, 1)[-1] in state.components else AXES[:d]
    i = np.array([state.components.index(n) for n in names])
    return state.mean[:, i], state.covariance[:, i[:, None], i]
