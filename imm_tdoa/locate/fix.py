"""A fix: a position from one or several epochs, and how far it can be trusted."""

from __future__ import annotations

import attrs

from imm_tdoa._brief import brief
from imm_tdoa.contract import Array, Index, Mask


@attrs.frozen(eq=False)
class Fix:
    """A position, with what a user must know before believing it.

    Attributes
    ----------
    position : (..., d)
        Position, m; NaN where the measurements determine none.
    velocity : (..., d) or None
        Velocity, m/s, where the measurement carries it; NaN where the position is.
    covariance : (..., n, n)
        Covariance of position, and of velocity behind it; NaN where they are not determined.
    converged : (...) bool
        Whether the iteration reached a minimum that the geometry determines.
    iterations : (...) int
        Iterations used.
    chi2 : (...)
        Weighted sum of squared residuals; in a robust fit with its weights.
    dof : (...) int
        Its degrees of freedom: rows less unknowns; chi2 says nothing where this is 0.
    mirror : (..., d) or None
        Another position that explains the measurements as well (within 9 of chi2), as two
        crossing hyperbolas or a straight array have; NaN in a batch where there is none.
    weight : (..., T, m) or None
        Weight between 0 and 1 that a robust fit gave each row: each arrival where the arrivals
        were judged, then each range rate; otherwise each difference.
    """

    position: Array
    velocity: Array | None
    covariance: Array
    converged: Mask
    iterations: Index
    chi2: Array
    dof: Index
    mirror: Array | None = None
    weight: Array | None = None

    __repr__ = brief

    @property
    def ambiguous(self) -> bool:
        """Whether a mirror solution exists (anywhere in a batch)."""
        return self.mirror is not None
