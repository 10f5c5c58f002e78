"""Derivatives by finite differences with Richardson extrapolation, and how well they are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imm_tdoa.contract import Array

LEVELS = 4
EPS = float(np.finfo(float).eps)


def derivative(
    f: Callable[[Array], Array],
    x: Array,
    step: Array,
    *,
    subtract: Callable[[Array, Array], Array] = np.subtract,
    one_sided: bool = False,
) -> tuple[Array, Array]:
    """Return d f / d x (m, n) at `x` and a bound on its error (m, n).

    Differences over steps h, h/2, h/4, ... are extrapolated to zero (Ridders 1982); each entry
    is the extrapolation that changed least, and the bound is that change and the round-off. For
    central differences it is never more than a thousandth of the row's largest derivative: where
    `f` jumps, the derivative is as large as the jump over the step, and no excuse for a Jacobian
    that does not know it.

    Parameters
    ----------
    f : callable
        From (n,) to (m,).
    x : (n,)
        Where.
    step : (n,)
        Largest step of each component.
    subtract : callable
        Difference of two values of `f`; for angles, one that wraps.
    one_sided : bool
        Look forward only: ``f(x + h) - f(x)``.
    """
    columns = [_column(f, x, j, float(step[j]), subtract, one_sided) for j in range(len(x))]
    best, error, noise = (np.stack(part, axis=-1) for part in zip(*columns, strict=True))
    if one_sided:
        return best, error
    largest = np.max(np.abs(best), axis=-1, keepdims=True)
    return best, np.minimum(error, noise + 1e-3 * largest)


def _column(
    f: Callable[[Array], Array],
    x: Array,
    j: int,
    h: float,
    subtract: Callable[[Array, Array], Array],
    one_sided: bool,
) -> tuple[Array, Array, Array]:
    """Return one column, a bound on its error and the part of it that is round-off."""
    base = 2.0 if one_sided else 4.0
    table: list[list[Array]] = []
    best = error = noise = np.zeros(0)
    for k in range(LEVELS):
        high, low = np.array(x), np.array(x)
        high[j] += h / 2**k
        if not one_sided:
            low[j] -= h / 2**k
        above, below = np.asarray(f(high), dtype=float), np.asarray(f(low), dtype=float)
        width = high[j] - low[j]
        row = [subtract(above, below) / width]
        noise = 4.0 * EPS * np.maximum(np.abs(above), np.abs(below)) / width
        for m in range(1, k + 1):
            gain = (row[m - 1] - table[-1][m - 1]) / (base**m - 1.0)
            row.append(row[m - 1] + gain)
            change = np.maximum(np.abs(gain), np.abs(row[m] - table[-1][m - 1])) + noise
            if not error.size:
                best, error = row[m], change
            better = change < error
            best, error = np.where(better, row[m], best), np.where(better, change, error)
        table.append(row)
    return best, error, noise
