"""Tracks begin from two fixes in different scans that one emitter can have gone between."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
from scipy.special import chdtri

from imm_tdoa import _validate, initiation
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.imm import IMM
from imm_tdoa.tracking import batches
from imm_tdoa.tracking.births import Births, no_others, unknown
from imm_tdoa.tracking.candidates import Candidates, Combining
from imm_tdoa.tracking.clutter import extent
from imm_tdoa.tracking.gathering import gathered, is_thin
from imm_tdoa.tracking.leading import led, swerve
from imm_tdoa.tracking.memory import Heard, Memory
from imm_tdoa.tracking.messages import locate, messages
from imm_tdoa.tracking.standing import TOLD, WINDOW

REACHABLE = 0.999  # quantile of the distance between two fixes of one emitter
LEAST_STEP = 1e-6  # s; fixes closer in time say nothing of the velocity


@attrs.frozen
class PairedFixes:
    """A track begins from two fixes in different scans which the emitter can have gone between.

    Parameters
    ----------
    scans : int
        Number of scans before the present one whose fixes are remembered.
    seconds : float
        How long fixes are remembered at most, s.
    most_combinations : int
        Most combinations of values tried in one scan.
    most_births : int
        Most tracks begun in one scan; the pairs that fit the birth law best go first.
    detection_probability : float
        Probability that a row of a target is measured in a scan in which every target could be
        heard; of messages it says nothing.
    lookback : int
        Number of scans through which a track that begins is led back, where rows are barely
        enough for a position.
    gathered : int
        Number of scans that are put together where each is too thin for a fix: rows that come
        one pair of stations at a time.

    Notes
    -----
    How far an emitter gets between two scans follows from the birth law of the bank. In a bank
    where nothing moves one fix is enough.

    A scan without enough different rows for a fix is put together with others of the kind
    (`imm_tdoa.tracking.gathering`). Messages are not: one at fewer than d + 1 stations (d with a
    height) begins no track and is counted as ignored, unless a track takes it that it fits.
    """

    scans: int = attrs.field(default=5, kw_only=True)
    seconds: float = attrs.field(default=120.0, kw_only=True)
    most_combinations: int = attrs.field(default=20000, kw_only=True)
    most_births: int = attrs.field(default=200, kw_only=True)
    detection_probability: float = attrs.field(default=0.9, kw_only=True)
    lookback: int = attrs.field(default=8, kw_only=True)
    gathered: int = attrs.field(default=TOLD, kw_only=True)

    def __attrs_post_init__(self) -> None:
        for name in ("scans", "most_combinations", "most_births", "lookback", "gathered"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")
        if max(self.scans, self.lookback) >= WINDOW:
            raise ValueError(f"lookback: expected scans and lookback below {WINDOW}")
        if self.gathered > TOLD:
            raise ValueError(f"gathered: expected at most {TOLD} scans, got {self.gathered!r}")
        _validate.positive("seconds", self.seconds)
        _probability(self.detection_probability)

    def __call__(self, imm: IMM, now: Heard, memory: Memory, known: Index) -> Births:
        """Return the tracks that begin."""
        if is_thin(imm.measurement, now):
            return self._gathered(imm, now, memory, known)
        combine = Combining(self.most_combinations, self.detection_probability)
        found, left_out = combine(imm.measurement, now.time, now.rows, now.density)
        ignored = {"combinations over the cap": left_out} if left_out else {}
        short = _too_short(imm.measurement, now, known)
        if short:
            ignored["messages at too few stations to begin a track"] = short
        found = found.part(no_others(found.members, known))
        memory = self._recent(memory, now)
        kept = memory.with_fixes(found, now.time, now.scan)
        speed = initiation.velocity_std(imm.bank, imm.space)
        if speed is None:
            return self._at_rest(imm, now.time, found, kept, ignored)
        if now.emission is None:
            kept = attrs.evolve(kept, heard=(*memory.heard, now))
        else:
            kept = kept.with_strangers(found)
        new, old, apart, over = self._pairs(imm, memory, found, now.time, speed)
        if over:
            ignored["births over the cap"] = over
        if not len(new):
            return Births.none(imm.measurement.size, kept, ignored)
        start = led(imm, now, memory, found, (new, old), self.detection_probability)
        ratio, gains, merits = start.log_ratio, start.gains, start.merits
        if now.emission is not None:
            ratio = apart + imm.measurement.dims * np.log(extent(imm.measurement, now.time))
            gains[:, 0] = merits[:, 0] = ratio
        members = found.members[new]
        return Births(start.state, members, ratio, gains, merits, start.past, kept, ignored)

    def _recent(self, memory: Memory, now: Heard) -> Memory:
        """What is not too old; of messages the time alone counts, they come when they come."""
        recent = memory.time >= now.time - self.seconds
        if now.emission is None:
            recent &= memory.scan >= now.scan - self.scans
        heard = tuple(h for h in memory.heard if h.scan >= now.scan - self.lookback)
        return attrs.evolve(memory.part(recent), heard=heard)

    def _gathered(self, imm: IMM, now: Heard, memory: Memory, known: Index) -> Births:
        """Begin tracks from the last scans too thin for a fix, this one included."""
        d, m = imm.measurement.dims, imm.measurement.size
        free = now.values.copy()
        free[known[known >= 0]] = np.nan
        recent = [h for h in memory.thin if h.time >= now.time - self.seconds]
        thin = (*recent[len(recent) - self.gathered + 1 :], attrs.evolve(now, values=free))
        memory = self._recent(memory, now)
        speed = initiation.velocity_std(imm.bank, imm.space)
        kept = attrs.evolve(memory, thin=thin)
        if speed is not None:
            kept = attrs.evolve(kept, heard=(*memory.heard, now))
        speed = np.zeros(d) if speed is None else speed
        found = gathered(imm, thin, speed, self.most_combinations, self.detection_probability)
        ignored = {"combinations over the cap": found.left_out} if found.left_out else {}
        if found.state is None:
            return Births.none(m, kept, ignored)
        over = max(len(found.members) - self.most_births, 0)
        if over:
            ignored["births over the cap"] = over
        some = slice(0, self.most_births)
        gains = found.gains[some]
        return Births(
            batches.select(found.state, some),
            found.members[some],
            found.log_ratio[some],
            gains,
            gains.copy(),
            found.past[some],
            kept,
            ignored,
        )

    def _at_rest(
        self, imm: IMM, time: float, found: Candidates, kept: Memory, ignored: dict[str, int]
    ) -> Births:
        """Where nothing moves each fix begins a track."""
        over = max(len(found.position) - self.most_births, 0)
        if over:
            ignored["births over the cap"] = over
        m = imm.measurement.size
        if not len(found.position):
            return Births.none(m, kept, ignored)
        first = found.part(np.arange(len(found.position) - over))
        gains, past = unknown(len(first.merit), m)
        merits = gains.copy()
        gains[:, 0], merits[:, 0] = first.log_odds, first.merit
        times = np.full(len(first.merit), time)
        state = imm.start(times, first.position, first.covariance)
        return Births(state, first.members, first.log_odds, gains, merits, past, kept, ignored)

    def _pairs(
        self, imm: IMM, memory: Memory, found: Candidates, time: float, speed: Array
    ) -> tuple[Index, Index, Array, int]:
        """New and remembered fixes that may be one emitter's, the log-density of their distance.

        Last, how many pairs were left out.
        """
        none = np.zeros(0, dtype=np.int64)
        if not len(found.position) or not len(memory.time):
            return none, none, np.zeros(0), 0
        dt = time - memory.time
        delta = found.position[:, None] - memory.position[None]
        reach = (dt[:, None] * speed) ** 2 + swerve(imm, dt)[:, None] ** 2
        C = found.covariance[:, None] + memory.covariance[None]
        C = C + reach[None, :, :, None] * np.eye(len(speed))
        distance = np.einsum("fgi,fgi->fg", delta, np.linalg.solve(C, delta[..., None])[..., 0])
        limit = chdtri(float(len(speed)), 1.0 - REACHABLE)
        good = (distance <= limit) & (dt > LEAST_STEP)
        new, old = np.nonzero(good)
        order = np.argsort(distance[new, old], kind="stable")
        over = max(len(order) - self.most_births, 0)
        order = np.sort(order[: self.most_births])
        new, old = new[order], old[order]
        size = np.linalg.slogdet(2.0 * np.pi * C[new, old])[1]
        return new, old, -0.5 * (distance[new, old] + size), over


def _too_short(measurement: MeasurementModel, now: Heard, known: Index) -> int:
    """Number of messages that no track took and that are no fix by themselves."""
    if now.emission is None:
        return 0
    members = messages(now.rows, measurement.size)
    short = members[~locate(measurement, members)]
    return len(no_others(short, known))


def _probability(value: Any) -> float:
    number = _validate.positive("detection_probability", value)
    if number > 1.0:
        raise ValueError(f"detection_probability: expected at most 1, got {value!r}")
    return number
