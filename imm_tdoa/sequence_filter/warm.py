"""Fixes that begin where the last one was, for many runs at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from imm_tdoa.contract import Array, Index, Mask, MeasurementModel
from imm_tdoa.geometry import ranges
from imm_tdoa.locate import fix_scans
from imm_tdoa.scans import Scans
from imm_tdoa.sequence_filter.loop_gain import pseudo_inverse

TOGETHER = 4000  # fixes at a time; bounds the memory of long recordings
STEPS = 6  # undamped steps that are tried
SETTLED = 1e-10  # length of the last of them over the distance to the stations
NEARBY = 0.1  # how far they may lead over the distance to the nearest station


def fixes(model: MeasurementModel, times: Array, z: Array, near: Array) -> Array:
    """Locate from each of N sets of range differences by weighted least squares.

    An epoch's fix lies beside the last one, where Gauss-Newton needs no damping and settles in a
    few steps; what does not settle there goes to `locate.fix_scans`, which searches.

    Parameters
    ----------
    model : MeasurementModel
        Of the differences; its R weighs them.
    times : (N,)
        When, s.
    z : (N, m)
        Range differences, m; NaN is missing.
    near : (N, d)
        Where to begin; NaN where nothing is known.

    Returns
    -------
    (N, d)
        Positions, m; NaN where the rows determine none.
    """
    position = np.full(near.shape, np.nan)
    enough = np.asarray(np.count_nonzero(np.isfinite(z), axis=-1) >= near.shape[-1])
    begun = np.asarray(np.isfinite(near).all(axis=-1))
    for rows in _parts(enough & begun):
        position[rows] = _nearby(model, times[rows], z[rows], near[rows])
    for rows in _parts(enough & begun & np.isnan(position).any(axis=-1)):
        position[rows] = _located(model, times[rows], z[rows], near[rows])
    for rows in _parts(enough & np.isnan(position).any(axis=-1)):
        position[rows] = _located(model, times[rows], z[rows], None)
    return position


def _parts(which: Mask) -> list[Index]:
    """Indices of what is wanted, so many together."""
    rows = np.flatnonzero(which)
    return [rows[k : k + TOGETHER] for k in range(0, len(rows), TOGETHER)]


def _nearby(model: MeasurementModel, times: Array, z: Array, near: Array) -> Array:
    """Positions (N, d) where undamped steps from `near` settle beside it; NaN elsewhere."""
    some: Any = model
    stations = some.stations.at(times)[0]
    p, rest = near, np.zeros_like(near)
    settled = np.zeros(len(near), dtype=bool)
    for _ in range(STEPS):
        h, G = model.predict(p, rest, times), model.jacobian(p, rest, times)[0]
        present = np.asarray(np.isfinite(z) & np.isfinite(h))
        inverse = pseudo_inverse(G, model.noise_covariance(p, rest, times), present)
        step = np.einsum("ndm,nm->nd", inverse, np.where(present, z - h, 0.0))
        p = p + step
        length = np.linalg.norm(step, axis=-1)
        away = ranges(p, stations)[0]
        settled = np.asarray(length <= SETTLED * np.nanmax(away, axis=-1, initial=0.0))
        if np.all(settled | np.isnan(length)):
            break
    nearest = np.nanmin(ranges(near, stations)[0], axis=-1, initial=np.inf)
    beside = np.linalg.norm(p - near, axis=-1) <= NEARBY * nearest
    return np.where((settled & beside)[:, None], p, np.nan)


def _located(model: MeasurementModel, times: Array, z: Array, near: Array | None) -> Array:
    """Positions (N, d) by damped iteration from `near`, or by search; NaN where there is none."""
    same = np.all(times == times[0])
    values = z[:, None, :] / model.scale
    scans = Scans(model, times[:1] if same else times[:, None], values)
    fix = fix_scans(scans, initial=near)
    return np.where(fix.converged[:, None], fix.position, np.nan)
