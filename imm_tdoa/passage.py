"""From a start through all scans of a recording, by NumPy or by the compiled engine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import attrs
import numpy as np

from imm_tdoa.contract import Index
from imm_tdoa.keeping import kept_rows
from imm_tdoa.scans import Scans
from imm_tdoa.state import State, Taken
from imm_tdoa.track import Track

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM


def through(
    imm: IMM,
    scans: Scans,
    state: State,
    first: Index,
    engine: Literal["numpy", "compiled"],
    keep: str,
    threads: int | None,
) -> Track:
    """Step through the scans after `first` (...), the last that each target's fix used.

    Parameters
    ----------
    keep : "all", "final" or "every k"
        Which scans the track has rows of.
    threads : int, optional
        How many the compiled engine computes in.
    """
    begin = int(first.min())
    alike = begin == int(first.max())
    shift = max(begin, 0)
    rows = shift + kept_rows(keep, scans.count - shift)
    times, bank = scans.times[..., rows], imm.cycle.bank
    if engine == "numpy":
        states = _by_numpy(imm, scans, state, first, rows)
        track = Track.from_states(states, times, bank=bank, update=imm.update, keep=keep)
    else:
        from imm_tdoa.kernel.running import run
        from imm_tdoa.kernel.tracking import track_of

        if scans.measurement.size != imm.measurement.size:  # other pairs, and not as many
            imm = attrs.evolve(imm, measurement=scans.measurement)
        kept = np.full(scans.count, -1)
        kept[rows] = np.arange(len(rows))
        records = run(imm, imm.plan, scans, state, first, alike, kept, threads)
        whole = records.reshape(*first.shape, *records.shape[1:])
        track = track_of(imm.plan, whole, times, state, bank, keep)
    return track if alike else track.blanked(rows < first[..., None])


def _by_numpy(imm: IMM, scans: Scans, state: State, first: Index, rows: Index) -> list[State]:
    """States after the scans `rows`.

    A target waits for its own start by steps of no length without measurement, which leave it
    as it is.
    """
    begin = int(first.min())
    nothing = Taken.nothing(first.shape, len(imm.bank), scans.measurement.size)
    state = attrs.evolve(state, taken=nothing)
    later = slice(begin + 1, None)
    clock = np.maximum(scans.times[..., later], state.time[..., None])
    before = np.broadcast_to(state.time[..., None], (*clock.shape[:-1], 1))
    dt = np.diff(clock, axis=-1, prepend=before)
    chain = imm.chain(dt)
    waiting = np.arange(begin + 1, scans.count) <= first[..., None]
    values = np.where(waiting[..., None], np.nan, scans.values[..., later, :])
    kept = set(rows.tolist())
    states = [state] if begin in kept else []
    for k in range(begin + 1, scans.count):
        i = k - begin - 1
        state = imm.cycle(
            state, clock[..., i], dt[..., i], chain[..., i, :, :], values[..., i, :],
            scans.measured_at(k),
        )  # fmt: skip
        if k in kept:
            states.append(state)
    return states
