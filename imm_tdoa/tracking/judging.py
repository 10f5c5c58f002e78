"""Merge duplicates, confirm, give up on trial, displace, end: who stays after a scan."""

from __future__ import annotations

import attrs
import numpy as np

from imm_tdoa.contract import AXES, Array, Index, Mask
from imm_tdoa.state import State
from imm_tdoa.tracking import batches, exclusive
from imm_tdoa.tracking.memory import Heard
from imm_tdoa.tracking.retold import Retold, retold
from imm_tdoa.tracking.scene import Confirmed, Ended, Scene, counted
from imm_tdoa.tracking.settings import Settings
from imm_tdoa.tracking.standing import TOLD, UNKNOWN, Standing

REDUNDANT = 1.5  # rows beyond need, on average, with which ghosts do not pass for targets
HOPELESS = 20.0  # nats behind a rival after which a track on trial is given up


def judged(
    settings: Settings, scene: Scene, now: Heard, members: Index, share: Array
) -> tuple[Scene, Index, Array]:
    """Merge duplicates, confirm, give up, and end, after a scan whose rows are `now`."""
    N = len(scene.identity)
    if N == 0:
        return scene, members, share
    number = scene.numbers
    into = settings.merging(scene.state, scene.standing, scene.confirmed, scene.identity)
    end = np.full(N, "", dtype=object)
    for n in np.flatnonzero(into >= 0):
        end[n] = "same as another track"
        if scene.confirmed[n]:
            other = number.get(int(scene.identity[into[n]]), "one on trial")
            end[n] = f"merged into {other}"
    trial = ~scene.confirmed & (end == "")
    verdict = settings.confirmation(scene.standing)
    end = np.where(trial & (verdict.end != ""), verdict.end, end)
    confirm = np.zeros(N, dtype=bool)
    young = scene.confirmed & ~scene.settled & (end == "")
    standing = scene.standing
    grown = (standing.redundant >= REDUNDANT) | (standing.age >= settings.patience - 2)
    able = trial & (end == "") & verdict.confirm & grown
    on = np.flatnonzero(young | able)
    if len(on):
        scene = _contested(settings, scene, now, on, confirm, end)
    std = _position_std(scene.state)
    last = settings.deletion(scene.standing, std)
    end = np.where(scene.confirmed & (end == "") & (last.end != ""), last.end, end)
    before, settled = scene.settled, scene.settled | _beyond_doubt(settings, scene, confirm)
    scene = attrs.evolve(_booked(scene, confirm, end), settled=settled)
    if np.any(settled & ~before):
        rest = ~scene.confirmed & (end == "")
        same = exclusive.shared(scene.standing.values)[:, settled].max(axis=1)
        lost = rest & (same >= exclusive.RIVALS)
        end[lost] = "its rows are a confirmed track's"
        more = {"its rows are a confirmed track's": int(np.count_nonzero(lost))}
        scene = attrs.evolve(scene, rejected=counted(scene.rejected, more))
    kept = end == ""
    return _kept(scene, kept), members[kept], share[kept]


def _contested(
    settings: Settings, scene: Scene, now: Heard, on: Index, confirm: Mask, end: Array
) -> Scene:
    """Confirm, of tracks that share values, those that explain them best; displace the others.

    A scan without redundant rows cannot tell a ghost, made of several targets' values, from a
    target: such tracks wait until one of their rivals is `patience` scans old.
    """
    standing = scene.standing.part(on)
    young = scene.confirmed[on]
    displaced, better = _displaced(settings, standing, young)
    end[on[displaced]] = "displaced by tracks that explain its rows better"
    told = _told(settings, scene, now, on)
    if told is None:
        gains, values = standing.gains, standing.values
        result = exclusive.contest(values, gains)
    else:
        gains, values = told.gains, told.values
        result = exclusive.contest_of_stories(values, gains, _merit(scene, standing, young))
    oldest = np.zeros(result.group.max() + 1, dtype=np.int64)
    np.maximum.at(oldest, result.group, standing.age)
    ripe = (standing.redundant >= REDUNDANT) | (oldest[result.group] >= settings.patience)
    outdone = exclusive.outdone(standing.values, standing.merits)
    hopeless = ~young & ~result.chosen & ~better & (outdone >= HOPELESS)
    end[on[hopeless]] = "another explains its rows better"
    wanted = ~young & ((result.chosen & ripe) | better) & (standing.heard == scene.time)
    holding = young & ~displaced
    rivals = exclusive.shared(values) >= exclusive.RIVALS
    wanted &= ~rivals[:, holding].any(axis=1)
    wanted &= better | ~rivals[:, better].any(axis=1)
    confirm[on[wanted]] = True
    fresh = np.flatnonzero(wanted & (standing.age <= gains.shape[1]))
    if told is None or not len(fresh):
        return scene
    better_known = batches.put(scene.state, on[fresh], batches.select(told.state, fresh))
    return attrs.evolve(scene, state=better_known)


def _merit(scene: Scene, standing: Standing, young: Mask) -> Array:
    """Who is to stand (n,) for tracks of one story: confirmed, heard now, likeliest by itself."""
    known = 1e9 * young + 1e6 * (standing.heard == scene.time)
    return np.asarray(known + np.clip(standing.log_ratio, -1e5, 1e5))


def _told(settings: Settings, scene: Scene, now: Heard, on: Index) -> Retold | None:
    """The last scans told anew, where that decides."""
    standing = scene.standing.part(on)
    alike = exclusive.shared(standing.values) >= exclusive.RIVALS
    np.fill_diagonal(alike, False)
    wait = alike.any(axis=1) & (standing.redundant < REDUNDANT)
    past = scene.memory.heard
    if not past or not np.any(wait & ~scene.confirmed[on]):
        return None
    state = batches.select(scene.state, on)
    heard = (*past, now)[-TOLD:]
    ago = now.scan - np.array([h.scan for h in heard])
    own = standing.own[:, np.minimum(ago, TOLD - 1)]
    own[:, ago >= TOLD] = UNKNOWN
    return retold(settings.imm, state, heard, own, settings.detection_probability)


def _displaced(settings: Settings, standing: Standing, young: Mask) -> tuple[Mask, Mask]:
    """Which young confirmed tracks (n,) others displace, and which these others are.

    Rivals of any age are compared by their merits; those who displace must have lived through
    `patience` scans themselves.
    """
    displaced, better = np.zeros(len(young), dtype=bool), np.zeros(len(young), dtype=bool)
    old = np.flatnonzero(young | (standing.chances > settings.patience))
    if not young.any() or len(old) == np.count_nonzero(young):
        return displaced, better
    result = exclusive.contest(standing.values[old], standing.merits[old])
    out = young[old] & ~result.chosen & (result.behind >= settings.margin)
    displaced[old[out]] = True
    rivals = exclusive.shared(standing.values[old])[:, out] >= exclusive.RIVALS
    better[old[rivals.any(axis=1) & result.chosen & ~young[old]]] = True
    return displaced, better


def _beyond_doubt(settings: Settings, scene: Scene, confirm: Mask) -> Mask:
    """Confirmed tracks with redundant rows, or long on probation."""
    standing = scene.standing
    sure = (standing.redundant >= REDUNDANT) | (standing.age >= settings.probation)
    return np.asarray((scene.confirmed | confirm) & sure)


def _booked(scene: Scene, confirm: Mask, end: Array) -> Scene:
    """Note who was confirmed, who has ended, and why."""
    standing, number = scene.standing, scene.numbers
    confirmations, endings = list(scene.confirmations), list(scene.endings)
    for n in np.flatnonzero(confirm):
        confirmations.append(
            Confirmed(
                int(scene.identity[n]),
                len(confirmations) + 1,
                float(standing.born[n]),
                scene.time,
                scene.scans - 1,
            )
        )
    rejected: dict[str, int] = {}
    for n in np.flatnonzero(end != ""):
        if scene.confirmed[n]:
            who = int(scene.identity[n])
            endings.append(
                Ended(who, number[who], scene.time, float(standing.heard[n]), str(end[n]))
            )
        else:
            rejected[str(end[n])] = rejected.get(str(end[n]), 0) + 1
    return attrs.evolve(
        scene,
        confirmed=scene.confirmed | confirm,
        confirmations=tuple(confirmations),
        endings=tuple(endings),
        rejected=counted(scene.rejected, rejected),
    )


def _position_std(state: State) -> Array:
    i = np.array([state.components.index(a) for a in AXES[: state.space.dims]])
    variance = np.einsum("nii->ni", state.covariance)[:, i]
    result: Array = np.sqrt(variance.mean(axis=-1))
    return result


def _kept(scene: Scene, kept: Mask) -> Scene:
    if kept.all():
        return scene
    return attrs.evolve(
        scene,
        state=batches.select(scene.state, kept),
        identity=scene.identity[kept],
        confirmed=scene.confirmed[kept],
        settled=scene.settled[kept],
        standing=scene.standing.part(kept),
    )
