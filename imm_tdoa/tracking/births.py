"""How tracks begin: candidate fixes of a few scans that one emitter could have sent."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import attrs
import numpy as np
from scipy.special import chdtri

from imm_tdoa import _validate, initiation
from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.statespace import KIND_OF
from imm_tdoa.tracking import batches, lookback
from imm_tdoa.tracking.combinations import Candidates, Combining, extent, own_values
from imm_tdoa.tracking.lookback import Heard
from imm_tdoa.tracking.merit import merit, noise_variance
from imm_tdoa.tracking.rows import Unlabelled
from imm_tdoa.tracking.standing import TOLD, UNKNOWN, WINDOW

REACHABLE = 0.999  # quantile of the distance between two fixes of one emitter
AMPLE = 2  # rows beyond need with which ghosts do not pass for targets
LEAST_STEP = 1e-6  # s; fixes closer in time say nothing of the velocity


@attrs.frozen(eq=False)
class Memory:
    """Candidate fixes of the last scans, to which no track has led yet.

    Attributes
    ----------
    time, scan : (F,)
        When each was made, s, and in which scan.
    position, covariance : (F, d), (F, d, d)
        The fixes.
    members : (F, m)
        Which value of its scan each row had; -1 none.
    log_odds : (F,)
        How much likelier its values were from one emitter than false.
    merit : (F,)
        How well it explained them.
    heard : tuple of Heard
        The rows of those scans, where tracks that begin are to be led back through them.
    """

    time: Array
    scan: Index
    position: Array
    covariance: Array
    members: Index
    log_odds: Array
    merit: Array
    heard: tuple[Heard, ...] = ()

    @property
    def dims(self) -> int:
        """Number of space dimensions d."""
        return int(self.position.shape[1])

    @classmethod
    def none(cls, dims: int, size: int) -> Memory:
        """No fixes."""
        empty = np.zeros(0)
        place, covariance = np.zeros((0, dims)), np.zeros((0, dims, dims))
        nobody = np.zeros((0, size), dtype=np.int64)
        return cls(empty, empty.astype(np.int64), place, covariance, nobody, empty, empty)

    def with_fixes(self, found: Candidates, time: float, scan: int) -> Memory:
        """Return it with the candidates of a scan."""
        F = len(found.position)
        return Memory(
            np.concatenate([self.time, np.full(F, time)]),
            np.concatenate([self.scan, np.full(F, scan)]),
            np.concatenate([self.position, found.position]),
            np.concatenate([self.covariance, found.covariance]),
            np.concatenate([self.members, found.members]),
            np.concatenate([self.log_odds, found.log_odds]),
            np.concatenate([self.merit, found.merit]),
            self.heard,
        )

    def part(self, which: Any) -> Memory:
        """Return some of the fixes."""
        names = ("time", "scan", "position", "covariance", "members", "log_odds", "merit")
        return attrs.evolve(self, **{name: getattr(self, name)[which] for name in names})


class Births(NamedTuple):
    """Tracks that begin.

    Attributes
    ----------
    state : State or None
        Their states (B,) after the scan; None for none.
    members : (B, m)
        Which value of the scan each row was begun from; -1 none.
    log_ratio : (B,)
        Log of how much likelier the values of its fixes are from a target than false.
    gains, merits : (B, W)
        Log-ratio and merit of each of the last scans, newest first; NaN where not known.
    past : (B, TOLD, m)
        Which values they had, as in `Standing.own`.
    memory : Memory
        What to remember for the next scans.
    ignored : mapping of str to int
        What was left out, by reason.
    """

    state: State | None
    members: Index
    log_ratio: Array
    gains: Array
    merits: Array
    past: Index
    memory: Memory
    ignored: dict[str, int]


@runtime_checkable
class Initiation(Protocol):
    """Anything that begins tracks from rows that no confirmed target took."""

    def __call__(
        self,
        imm: IMM,
        measurement: MeasurementModel,
        time: float,
        scan: Unlabelled,
        density: Array,
        memory: Memory,
        number: int,
        known: Index,
    ) -> Births:
        """Return the tracks that begin at scan `number`.

        `scan` holds the rows (K,) that no confirmed target took, the others being NaN; `density`
        (m,) is that of false values; `known` (N, m) says which values the tracks on trial took:
        a fix of just these begins no other.
        """
        ...


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
        Probability that a row of a target is measured.
    lookback : int
        Number of scans through which a track that begins is led back, where rows are barely
        enough for a position.

    Notes
    -----
    How far an emitter gets between two scans follows from the birth law of the bank. In a bank
    where nothing moves one fix is enough.
    """

    scans: int = attrs.field(default=5, kw_only=True)
    seconds: float = attrs.field(default=120.0, kw_only=True)
    most_combinations: int = attrs.field(default=20000, kw_only=True)
    most_births: int = attrs.field(default=200, kw_only=True)
    detection_probability: float = attrs.field(default=0.9, kw_only=True)
    lookback: int = attrs.field(default=8, kw_only=True)

    def __attrs_post_init__(self) -> None:
        for name in ("scans", "most_combinations", "most_births", "lookback"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")
        if max(self.scans, self.lookback) >= WINDOW:
            raise ValueError(f"lookback: expected scans and lookback below {WINDOW}")
        _validate.positive("seconds", self.seconds)
        _probability(self.detection_probability)

    def __call__(
        self,
        imm: IMM,
        measurement: MeasurementModel,
        time: float,
        scan: Unlabelled,
        density: Array,
        memory: Memory,
        number: int,
        known: Index,
    ) -> Births:
        """Return the tracks that begin."""
        combine = Combining(self.most_combinations, self.detection_probability)
        found, left_out = combine(measurement, time, scan, density)
        ignored = {"combinations over the cap": left_out} if left_out else {}
        found = found.part(~_taken(found.members, known))
        one_message = scan.emission is not None
        recent = memory.time >= time - self.seconds
        if not one_message:
            recent &= memory.scan >= number - self.scans
        memory = memory.part(recent)
        moving = initiation.velocity_std(imm.bank, imm.space)
        kept = memory.with_fixes(found, time, number)
        if moving is None:
            some = slice(0, self.most_births)
            state = _at_rest(imm, time, found.position[some], found.covariance[some])
            over = max(len(found.position) - self.most_births, 0)
            if over:
                ignored["births over the cap"] = over
            first = found.part(np.arange(len(found.merit))[some])
            gains, merits = np.full((2, len(first.merit), WINDOW), np.nan)
            gains[:, 0], merits[:, 0] = first.log_odds, first.merit
            had = np.full((len(gains), TOLD, measurement.size), UNKNOWN, dtype=np.int64)
            return Births(state, first.members, first.log_odds, gains, merits, had, kept, ignored)
        now, then, apart, over = self._pairs(imm, memory, found, time, moving)
        if over:
            ignored["births over the cap"] = over
        if not one_message:
            rows = Heard(float(time), number, scan.values, scan.row, density)
            past = tuple(h for h in memory.heard if h.scan >= number - self.lookback)
            kept = attrs.evolve(kept, heard=(*past, rows))
            memory = attrs.evolve(memory, heard=past)
        if not len(now):
            gains = np.zeros((0, WINDOW))
            had = np.zeros((0, TOLD, measurement.size), dtype=np.int64)
            return Births(None, found.members[now], np.zeros(0), gains, gains, had, kept, ignored)
        state, ratio, gains, merits, had = self._led(
            imm, measurement, time, scan, density, memory, found, now, then, number
        )
        if one_message:
            ratio = apart + measurement.dims * np.log(extent(measurement, time))
            gains[:, 0] = merits[:, 0] = ratio
        return Births(state, found.members[now], ratio, gains, merits, had, kept, ignored)

    def _led(
        self,
        imm: IMM,
        measurement: MeasurementModel,
        time: float,
        scan: Unlabelled,
        density: Array,
        memory: Memory,
        found: Candidates,
        now: Index,
        then: Index,
        number: int,
    ) -> tuple[State, Array, Array, Array, Index]:
        """States (B,) of the pairs now, log-ratios, gains and merits (B, W), and values had."""
        heard = np.isin(np.arange(measurement.size), scan.row[np.isfinite(scan.values)])
        led = scan.emission is None and np.count_nonzero(heard) < measurement.dims + AMPLE
        P_D = self.detection_probability
        hit, miss = np.log(P_D) - np.log(density), np.log1p(-min(P_D, 0.999))
        gains, merits = np.full((2, len(now), WINDOW), np.nan)
        ratio = np.zeros(len(now))
        own = np.full((len(now), WINDOW, measurement.size), UNKNOWN, dtype=np.int64)
        parts, places = [], []
        for s in np.unique(memory.scan[then]).tolist():
            some = np.flatnonzero(memory.scan[then] == s)
            old, new = memory.part(then[some]), found.part(now[some])
            ago = min(number - s, WINDOW - 1)
            gains[some, ago], merits[some, ago] = old.log_odds, old.merit
            ratio[some], own[some, ago] = old.log_odds, old.members
            state = batches.whole(imm.start(old.time, old.position, old.covariance))
            between = [h for h in memory.heard if h.scan > s] if led else []
            if between:
                times = float(old.time[0]), time
                reach = _swerve(imm, np.array([0.5 * (times[1] - times[0])]))[0] ** 2
                wide = np.maximum(old.covariance, 0.0) * np.eye(measurement.dims)
                wide = np.maximum(wide, new.covariance * np.eye(measurement.dims))
                wide = wide + reach * np.eye(measurement.dims)
                ends = old.position, new.position
                state, more = lookback.between(imm, state, between, ends, wide, times, P_D)
                for h, said in zip(between, more, strict=True):
                    gains[some, number - h.scan] = said.gain
                    merits[some, number - h.scan] = said.merit
                    own[some, number - h.scan] = said.members
            z = own_values(measurement, scan, new.members)
            state, change = _taken_in(imm, state, time, z)
            rows = np.where(np.isfinite(z), hit, np.where(heard, miss, 0.0))
            gains[some, 0] = change + rows.sum(axis=-1)
            ratio[some] += gains[some, 0]
            state = batches.whole(state)
            merits[some, 0] = merit(
                state.taken.nis,
                state.taken.nis_dof.astype(float),
                np.isfinite(z),
                np.broadcast_to(heard, z.shape),
                noise_variance(measurement, new.position[0], time),
                density,
                P_D,
            )
            past = [h for h in reversed(memory.heard) if h.scan < s] if led else []
            for h, said in zip(past, lookback.before(imm, state, past, P_D), strict=True):
                gains[some, number - h.scan] = said.gain
                merits[some, number - h.scan] = said.merit
                own[some, number - h.scan] = said.members
            parts.append(state)
            places.append(some)
        order = np.argsort(np.concatenate(places), kind="stable")
        state = batches.select(batches.join(parts), order)
        return state, ratio, gains, merits, own[:, :TOLD]

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
        reach = (dt[:, None] * speed) ** 2 + _swerve(imm, dt)[:, None] ** 2
        C = found.covariance[:, None] + memory.covariance[None]
        C = C + reach[None, :, :, None] * np.eye(len(speed))
        distance = np.einsum("fgi,fgi->fg", delta, np.linalg.solve(C, delta[..., None])[..., 0])
        limit = chdtri(float(len(speed)), 1.0 - REACHABLE)
        good = (distance <= limit) & (dt > LEAST_STEP)
        now, then = np.nonzero(good)
        order = np.argsort(distance[now, then], kind="stable")
        over = max(len(order) - self.most_births, 0)
        order = np.sort(order[: self.most_births])
        now, then = now[order], then[order]
        size = np.linalg.slogdet(2.0 * np.pi * C[now, then])[1]
        return now, then, -0.5 * (distance[now, then] + size), over


def _probability(value: Any) -> float:
    number = _validate.positive("detection_probability", value)
    if number > 1.0:
        raise ValueError(f"detection_probability: expected at most 1, got {value!r}")
    return number


def _taken(members: Index, known: Index) -> Any:
    """Which candidates (F,) hold only values that one track on trial took."""
    if not len(members) or not len(known):
        return np.zeros(len(members), dtype=bool)
    same = (members[:, None] == known[None]) | (members < 0)[:, None]
    return same.all(axis=-1).any(axis=-1)


def _at_rest(imm: IMM, time: float, position: Array, covariance: Array) -> State | None:
    if not len(position):
        return None
    return imm.start(np.full(len(position), time), position, covariance)


def _swerve(imm: IMM, dt: Array) -> Array:
    """How far (F,) the acceleration of the birth law may lead in `dt`, m."""
    has = any(KIND_OF.get(c) == "acceleration" for c in imm.space.components)
    std = imm.bank.birth_std.get("acceleration", 0.0) if has else 0.0
    result: Array = 0.5 * std * dt**2
    return result


def _taken_in(imm: IMM, state: State, time: float, values: Array) -> tuple[State, Array]:
    """State (B,) after values (B, m) at `time`, and their log-likelihood."""
    state = imm.step(
        state, np.full(len(values), time), np.full_like(values, np.nan), engine="numpy"
    )
    after = imm.step(state, state.time, values, engine="numpy")
    return after, after.log_likelihood - state.log_likelihood
