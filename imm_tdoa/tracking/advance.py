"""One scan on: predict, associate, judge, begin. Pure functions from scene to scene."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.recording.unlabelled import Scan
from imm_tdoa.state import State
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.clutter import bounds
from imm_tdoa.tracking.door import at_the_door, refuse_foreign
from imm_tdoa.tracking.judging import judged
from imm_tdoa.tracking.memory import Heard
from imm_tdoa.tracking.rows import Unlabelled
from imm_tdoa.tracking.scene import Record, Scene, counted
from imm_tdoa.tracking.settings import Settings
from imm_tdoa.tracking.standing import Standing
from imm_tdoa.tracking.strangers import log_density
from imm_tdoa.tracking.taking import (
    OWN,
    confirmed_take,
    heard_rows,
    less,
    trials_take,
    values_of,
)

COMPACT = 50  # scans after which the records forget tracks that were given up on trial
GROWN = 5  # scans old a track on trial must be to keep others from beginning from its rows


def advance(settings: Settings, scene: Scene, scan: Scan) -> Scene:
    """Return the scene after a scan; what could not be used is counted, never fatal.

    Raises
    ------
    ValueError
        A scan that does not fit the measurement: row numbers beyond its rows, no emissions where
        rows share an unknown offset.
    """
    measurement = settings.imm.measurement
    refuse_foreign(measurement, scan)
    given = int(np.count_nonzero(np.isfinite(scan.values)))
    if scan.time < scene.time:
        return attrs.evolve(scene.refusing({"late rows": given}, given), scans=scene.scans + 1)
    low, high = bounds(measurement, scan.time)
    rows, ignored, usual = at_the_door(settings, scene, scan, low, high)
    clutter = scene.clutter.seeing(rows, low, high)
    density = clutter.density if settings.clutter_density is None else settings.clutter_density
    state = _predicted(settings, scene, scan.time)
    first, second = np.flatnonzero(scene.confirmed), np.flatnonzero(~scene.confirmed)
    strangers = -np.inf
    if rows.emission is not None:
        strangers = log_density(measurement, scene.memory, scan.time)
    own = confirmed_take(settings, batches.select(state, first), rows, density, strangers)
    left = less(rows, values_of(own.members[scene.settled[first]], len(scan)))
    tried = trials_take(settings, batches.select(state, second), left, density, strangers)
    order = np.argsort(np.concatenate([first, second]), kind="stable")
    state = batches.select(batches.join([own.state, tried.state]), order)
    members, share, gain, worth = (
        np.concatenate([a, b])[order]
        for a, b in (
            (own.members, tried.members),
            (own.share, tried.share),
            (own.gain, tried.gain),
            (own.worth, tried.worth),
        )
    )
    standing = _stand(scene, scan, rows, members, share, gain, worth, measurement)
    scene = attrs.evolve(
        scene,
        time=scan.time,
        scans=scene.scans + 1,
        state=state,
        standing=standing,
        clutter=clutter.after(rows, np.clip(1.0 - own.claimed, 0.0, 1.0)),
        usual=usual,
    ).refusing(ignored, given)
    now = Heard(scan.time, scene.scans - 1, left.values, left.row, density, left.emission)
    scene, members, share = judged(settings, scene, now, members, share)
    left = less(left, values_of(members[scene.settled], len(scan)))
    now = attrs.evolve(now, values=left.values)
    scene, members, share = _begun(settings, scene, now, members, share)
    record = Record.of(scan.time, scene.scans - 1, scene.identity, scene.state, members, share)
    return _remembered(scene, record)


def _predicted(settings: Settings, scene: Scene, time: float) -> State:
    N, m = len(scene.identity), settings.imm.measurement.size
    if N == 0:
        return scene.state
    nothing = np.full((N, m), np.nan)
    return batches.whole(settings.imm.step(scene.state, np.full(N, time), nothing, engine="numpy"))


def _stand(
    scene: Scene,
    scan: Scan,
    rows: Unlabelled,
    members: Index,
    share: Array,
    gain: Array,
    worth: Array,
    measurement: MeasurementModel,
) -> Standing:
    """Return how the tracks stand after the scan."""
    got = np.nansum(share, axis=-1)
    heard = int(np.count_nonzero(heard_rows(rows, measurement.size)))
    hit = got >= 0.5 * heard if scan.sweep else got > 0.0
    hit = hit & (heard > 0)
    chance = np.full(len(got), heard > 0) if scan.sweep else hit
    offsets = len(np.unique(measurement.offset_group[measurement.offset_group >= 0]))
    spare = got - measurement.dims - offsets
    return scene.standing.after(
        scan.time, scene.scans, chance, hit, got > OWN, gain, worth, members, spare
    )


def _begun(
    settings: Settings,
    scene: Scene,
    now: Heard,
    members: Index,
    share: Array,
) -> tuple[Scene, Index, Array]:
    """Begin tracks from what is left, and keep no more on trial than the most."""
    trial = ~scene.confirmed
    known = members[scene.confirmed | (scene.standing.age >= GROWN)]
    births = settings.initiation(settings.imm, now, scene.memory, known)
    scene = attrs.evolve(
        scene, memory=births.memory, ignored=counted(scene.ignored, births.ignored)
    )
    if births.state is None:
        return scene, members, share
    B = len(births.members)
    room = settings.most_trials - int(np.count_nonzero(trial))
    over = max(B - max(room, 0), 0)
    if over:
        ignored = counted(scene.ignored, {"tracks on trial over the cap": over})
        scene, B = attrs.evolve(scene, ignored=ignored), B - over
    if B == 0:
        return scene, members, share
    new = batches.select(batches.whole(births.state), slice(0, B))
    standing = Standing.new(
        births.log_ratio[:B],
        births.gains[:B],
        births.merits[:B],
        births.members[:B],
        scene.scans - 1,
        scene.memory.dims,
        scene.time,
        births.past[:B],
    )
    scene = attrs.evolve(
        scene,
        state=batches.join([scene.state, new]),
        identity=np.concatenate([scene.identity, scene.begun + np.arange(B)]),
        confirmed=np.concatenate([scene.confirmed, np.zeros(B, dtype=bool)]),
        settled=np.concatenate([scene.settled, np.zeros(B, dtype=bool)]),
        standing=Standing.joined(scene.standing, standing),
        begun=scene.begun + B,
    )
    took = births.members[:B]
    return (
        scene,
        np.concatenate([members, took]),
        np.concatenate([share, np.where(took >= 0, 1.0, np.nan)]),
    )


def _remembered(scene: Scene, record: Record) -> Scene:
    """Add a record; from time to time forget tracks that were given up on trial."""
    records = (*scene.records, record)
    if scene.scans % COMPACT == 0:
        alive = np.union1d(scene.identity, [c.identity for c in scene.confirmations])
        last = records[-2 * COMPACT :]
        last = tuple(r.part(np.isin(r.identity, alive)) for r in last)
        records = (*records[: len(records) - len(last)], *last)
    return attrs.evolve(scene, records=records)
