"""Standard deviations that are fixed, one per row, or sampled over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array


def checked(name: str, sigma: Any, rows: int, times: Any) -> tuple[Array, Array | None]:
    """Return `sigma` as a scalar, (rows,) or (K, rows) array, with its sample times (K,).

    Parameters
    ----------
    name : str
        What the caller calls it.
    sigma : float or array-like
        Positive standard deviations; NaN allowed only in sampled ones, where nothing is measured.
    rows : int
        Number of rows.
    times : (K,) array-like or None
        Sample times, s.
    """
    if times is None:
        value = _validate.array(name, sigma)
        if value.ndim > 1 or (value.ndim == 1 and value.shape != (rows,)):
            raise ValueError(f"{name}: expected one number or {rows} of them, got {value.shape}")
        stamps = None
    else:
        stamps = _validate.array("sigma_times", times, ("K",))
        if np.any(np.diff(stamps) <= 0.0):
            raise ValueError("sigma_times: expected strictly increasing times")
        value = _validate.array(name, sigma, (len(stamps), rows), finite=False)
    if np.any(value <= 0.0):
        raise ValueError(
            f"{name}: expected standard deviations above 0, got {float(np.nanmin(value)):g}"
        )
    return value, stamps


def at(name: str, sigma: Array, times: Array | None, time: float | Array, rows: int) -> Array:
    """Return the standard deviations (..., rows) that hold at `time` (...) s.

    A sampled sigma holds at its sample times only; asking in between is an error.
    """
    if times is not None:
        time = np.asarray(time, dtype=float)
        k = np.clip(np.searchsorted(times, time), 0, len(times) - 1)
        if np.any(times[k] != time):
            missing = np.atleast_1d(time)[np.atleast_1d(times[k] != time)][0]
            raise ValueError(f"{name}: no standard deviation was given for time {missing} s")
        sigma = sigma[k]
    if sigma.ndim and sigma.shape[-1] != rows:
        raise ValueError(f"{name}: expected one number or {rows} of them, got {sigma.shape[-1]}")
    return np.broadcast_to(sigma, (*sigma.shape[:-1], rows))
