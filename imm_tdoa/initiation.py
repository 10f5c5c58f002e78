"""Where a track starts when nobody says where: from as many first scans as a position takes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs
import numpy as np
import scipy

from imm_tdoa import gaussian, observation
from imm_tdoa.contract import AXES, Array, Index, Mask, component_names
from imm_tdoa.locate.fix import Fix
from imm_tdoa.locate.gauss_newton import fix_scans
from imm_tdoa.scans import Scans
from imm_tdoa.state import State
from imm_tdoa.statespace import StateSpace, lift

if TYPE_CHECKING:
    from imm_tdoa.bank import Bank
    from imm_tdoa.imm import IMM

CONTRADICTION = 0.999  # a fix whose chi2 lies beyond this quantile is not begun from
BENDING = 1.5  # largest curvature of the measurement over the fix's own spread, in sigmas
WINDOW = 40  # most scans gathered for one fix


def start_from_scans(imm: IMM, scans: Scans) -> tuple[State, Index]:
    """Return the state at each target's fix and the last scan (...) that the fix used.

    A scan that determines a position by itself is used alone. Where rows come a few at a time,
    the latest scans are gathered, explained by a straight motion whose velocity has the bank's
    birth law, until they determine a position well enough for an extended Kalman filter to go
    on from. Scans that contradict each other, or that two places explain equally well, are
    waited on; but of two places that are mirror images in the plane of receivers on the ground
    the upper one is taken.

    Parameters
    ----------
    imm : IMM
        What is to be started.
    scans : Scans
        What arrived, the first first.

    Raises
    ------
    ValueError
        No run of scans determines a position.
    """
    space = imm.space
    d = space.dims
    names = component_names(d, 1)[d:]
    birth_std = velocity_std(imm.bank, space)
    moving = birth_std is not None
    n = 2 * d if moving else d
    mean, covariance = np.zeros((*scans.batch, n)), np.zeros((*scans.batch, n, n))
    last = np.zeros(scans.batch, dtype=np.int64)
    ready = np.zeros(scans.batch, dtype=bool)
    if not np.isnan(scans.values[..., 0, :]).all():
        opening = scans.part(slice(0, 1))
        if np.any(_rows(opening) >= d):
            fix = _fix(opening, moving, birth_std)
            ready = _usable(opening, fix, spare=0)
            mean, covariance = _estimate(fix)
    for index in np.ndindex(scans.batch):
        if not ready[index]:
            fix, k = _gather(scans.of_target(index), moving, birth_std)
            mean[index], covariance[index] = _estimate(fix)
            last[index] = k
    times = np.broadcast_to(scans.times, (*scans.batch, scans.count))
    time = np.take_along_axis(times, last[..., None], axis=-1)[..., 0]
    components = (*AXES[:d], *names) if moving else AXES[:d]
    if np.all(last == last.flat[0]) and scans.times.ndim == 1:
        time = scans.times[last.flat[0]]
    return imm.start(time, mean, covariance, components), last


def velocity_std(bank: Bank, space: StateSpace) -> Array | None:
    """Standard deviations (d,) of the birth law's velocity, m/s; None where nothing moves.

    Parameters
    ----------
    bank : Bank
        Whose birth law.
    space : StateSpace
        Its components in d dimensions.
    """
    names = component_names(space.dims, 1)
    if names[-1] not in space.components:
        return None
    return np.sqrt(lift(names[: space.dims], names, bank.birth_std).birth_variance)


def _gather(scans: Scans, moving: bool, velocity_std: Array | None) -> tuple[Fix, int]:
    """Return the first usable fix of one target from successive scans, and the last it used."""
    d = scans.measurement.dims
    rows = _rows(scans)
    why = f"{int(rows.sum())} rows, of which {d} unknowns need at least {d}"
    for k in range(scans.count):
        if rows[k] == 0:
            continue
        for first in _windows(rows[: k + 1], d):
            window = scans.part(slice(first, k + 1))
            fix = _above_ground(window, _fix(window, moving, velocity_std), velocity_std)
            if _usable(window, fix, spare=0 if first == k else 1):
                return fix, k
            why = _reason(window, fix)
    raise ValueError(
        f"values: no run of up to {WINDOW} scans determines a position to start from ({why}); "
        f"give start=IMM.start(time, mean, covariance)"
    )


def _windows(rows: Index, d: int) -> list[int]:
    """First scans of the windows to try, ending at the last: just enough rows, then the most."""
    total = np.cumsum(rows[::-1])
    alone = [len(rows) - 1] if rows[-1] >= d else []
    enough = int(np.searchsorted(total, d + 1)) + 1
    if enough > min(len(rows), WINDOW):
        return alone
    longest = max(len(rows) - WINDOW, 0)
    return list(dict.fromkeys([*alone, len(rows) - enough, longest]))


def _above_ground(scans: Scans, fix: Fix, velocity_std: Array | None) -> Fix:
    """Settle a fix (one target) whose rival is its mirror image in the stations' plane.

    Receivers on the ground cannot tell above from below; emitters are above. Other rivals stay.
    """
    if fix.mirror is None or scans.measurement.dims < 3:
        return fix
    where = scans.together().anchors(scans.times, np.isfinite(scans.values)).reshape(-1, 3)
    where = where[np.isfinite(where).all(axis=-1)]
    centre = where.mean(axis=0)
    normal = np.linalg.svd(where - centre)[2][-1]
    apart = fix.position - fix.mirror
    across = abs(normal @ apart)
    middle = abs(normal @ (0.5 * (fix.position + fix.mirror) - centre))
    if across < 0.9 * np.linalg.norm(apart) or middle > 0.1 * across or abs(normal[2]) < 0.7:
        return fix
    if apart[2] > 0.0:
        return attrs.evolve(fix, mirror=None)
    return fix_scans(
        scans, moving=fix.velocity is not None, velocity_std=velocity_std, initial=fix.mirror
    )


def _fix(scans: Scans, moving: bool, velocity_std: Array | None) -> Fix:
    return fix_scans(scans, moving=moving, velocity_std=velocity_std)


def _rows(scans: Scans) -> Index:
    """Number of usable rows (..., T) per scan: present, less one per shared offset."""
    present = np.isfinite(scans.values)
    present = scans.together().independent(present)
    group = scans.measurement.offset_group
    rows: Index = np.count_nonzero(present, axis=-1)
    for g in np.unique(group[group >= 0]):
        rows = rows - np.any(present & (group == g), axis=-1)
    return rows


def _usable(scans: Scans, fix: Fix, spare: int) -> Mask:
    """Whether a filter may begin at the fix (...): determined, uncontradicted, unrivalled."""
    enough = np.asarray(fix.converged) & (fix.dof >= spare)
    agrees = (fix.dof == 0) | (
        fix.chi2 <= scipy.special.chdtri(np.maximum(fix.dof, 1), 1.0 - CONTRADICTION)
    )
    alone = True if fix.mirror is None else np.isnan(fix.mirror).all(axis=-1)
    good = enough & agrees & alone
    if np.any(good):
        good = good & (_bending(scans, fix) <= BENDING)
    return np.asarray(good)


def _bending(scans: Scans, fix: Fix) -> Array:
    """Second-order term (...) of the last scan over one sigma of the fix, in sigmas of the scan.

    Beyond about one the measurement is not straight over the fix's uncertainty and an extended
    Kalman filter would be misled. The whole scan is judged by its covariance, shared offsets
    eliminated, so that it does not matter which station is the reference.
    """
    d = scans.measurement.dims
    known = np.asarray(np.isfinite(fix.covariance).all(axis=(-2, -1)))
    P = np.where(known[..., None, None], fix.covariance, np.eye(fix.covariance.shape[-1]))
    w, V = np.linalg.eigh(P[..., :d, :d])
    reach = (np.sqrt(np.maximum(w, 0.0))[..., None, :] * V).swapaxes(-1, -2)  # (..., d, d)
    place = np.where(known[..., None], fix.position, 0.0)[..., None, :]
    speed = np.zeros_like(place) if fix.velocity is None else fix.velocity[..., None, :]
    at = scans.part(slice(-1, None))
    measurement, time = at.measurement, at.times[..., -1:]
    if at.pairs is not None:
        measurement = measurement.with_pairs(at.pairs)  # its time axis serves the d directions

    def values(shift: Array) -> Array:
        p = place + shift
        return measurement.predict(p, np.broadcast_to(speed, p.shape), time)

    bend = 0.5 * (values(reach) + values(-reach)) - values(np.zeros((1, d)))  # (..., d, m)
    heard = np.isfinite(at.values) & np.isfinite(bend).all(axis=-2, keepdims=True)
    seen = observation.without_offsets(
        observation.Observation(
            nu=(bend,),
            H=(np.zeros((bend.shape[-1], d)),),
            R=(measurement.noise_covariance(place, speed, time),),
            present=measurement.independent(heard),
            group=measurement.offset_group,
        )
    )
    bend, _, R = gaussian.mask_rows(seen.nu[0], seen.H[0], seen.R[0], seen.present)
    white = np.linalg.solve(gaussian.factor(R, "noise covariance"), bend[..., None])[..., 0]
    return np.where(known, np.linalg.norm(white, axis=-1).max(axis=-1), np.inf)


def _estimate(fix: Fix) -> tuple[Array, Array]:
    """Mean and covariance of position and velocity; harmless numbers where there is no fix."""
    mean = (
        fix.position
        if fix.velocity is None
        else np.concatenate([fix.position, fix.velocity], axis=-1)
    )
    known = np.asarray(np.isfinite(fix.covariance).all(axis=(-2, -1)))
    n = mean.shape[-1]
    covariance = np.where(known[..., None, None], fix.covariance, np.eye(n))
    return np.where(known[..., None], mean, 0.0), covariance


def _reason(scans: Scans, fix: Fix) -> str:
    if not np.all(fix.converged):
        return "the geometry does not determine one"
    if fix.mirror is not None:
        return (
            f"two places explain the last scans: {np.round(fix.position, 1).tolist()} and "
            f"{np.round(fix.mirror, 1).tolist()}"
        )
    if fix.dof > 0 and fix.chi2 > scipy.special.chdtri(fix.dof, 1.0 - CONTRADICTION):
        return f"the last scans contradict each other, chi2 {fix.chi2:.3g} with {fix.dof} spare"
    return "the fixes are too uncertain"
