"""The two ways to say how strongly a motion is disturbed, shared by the polynomial models."""

from __future__ import annotations

from math import factorial

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array


def exactly_one(model: str, psd: float | None, std: float | None) -> None:
    """Refuse a model that is given both `psd` and `std`, or neither, or a bad one."""
    if (psd is None) == (std is None):
        raise ValueError(
            f"{model}: give exactly one of psd (continuous white noise) and std (piecewise "
            f"constant), got psd={psd!r}, std={std!r}"
        )
    _validate.non_negative("psd" if std is None else "std", psd if std is None else std)  # type: ignore[arg-type]


def polynomial_transition(dt: float | Array, dims: int, order: int) -> Array:
    """F (..., n, n) of a chain of `order` integrators per axis: F_ab = dt^(b-a) / (b-a)!."""
    dt = _validate.time_step(dt)
    f = np.zeros((*dt.shape, order + 1, order + 1))
    for a in range(order + 1):
        for b in range(a, order + 1):
            f[..., a, b] = dt ** (b - a) / factorial(b - a)
    return blocked(f, dims)


def continuous(dt: float | Array, dims: int, order: int, psd: float) -> Array:
    """Q (..., n, n) of white noise of density `psd` driving the highest derivative (§2).

    Q_ab = psd dt^(A+B+1) / ((A+B+1) A! B!), A = order - a, B = order - b. It composes:
    Q(s + t) = F(t) Q(s) F(t)' + Q(t).
    """
    dt = _validate.time_step(dt)
    q = np.zeros((*dt.shape, order + 1, order + 1))
    for a in range(order + 1):
        for b in range(order + 1):
            A, B = order - a, order - b
            q[..., a, b] = psd * dt ** (A + B + 1) / ((A + B + 1) * factorial(A) * factorial(B))
    return blocked(q, dims)


def piecewise_constant(dt: float | Array, dims: int, g: Array, std: float) -> Array:
    """Q (..., n, n) = std² g g' of a disturbance held constant over each step (§2).

    It does not compose over time: with a variable step use `continuous`.
    """
    return blocked(std**2 * g[..., :, None] * g[..., None, :], dims)


def blocked(per_axis: Array, dims: int) -> Array:
    """Return a per-axis matrix (..., k, k) as the state's (..., k d, k d): kron(per_axis, I_d)."""
    dims = _validate.dimensions(dims)
    k = per_axis.shape[-1]
    full = np.einsum("...ab,ij->...aibj", per_axis, np.eye(dims))
    result: Array = full.reshape(*per_axis.shape[:-2], k * dims, k * dims)
    return result
