"""A recording, or a million of them, through the compiled recursion."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.kernel import feeding, sharing
from imm_tdoa.kernel.layout import Feed, Robust
from imm_tdoa.kernel.machine import machine
from imm_tdoa.kernel.plan import Plan
from imm_tdoa.kernel.recursion import FINE, INDEFINITE, REOPENS
from imm_tdoa.kernel.vectors import FOUR, LANES, ONE, Lanes
from imm_tdoa.scans import Scans
from imm_tdoa.state import State

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM

FEW, SEVERAL = 2, 8  # targets that are quicker one by one, or four by four


def lanes_for(targets: int) -> Lanes:
    """Return how many targets to compute at once."""
    return ONE if targets <= FEW else FOUR if targets <= SEVERAL else LANES


class _Failure(NamedTuple):
    """What went wrong; of several the least is told, which is what NumPy would meet first."""

    scan: int
    code: int
    target: int
    time: float

    def error(self) -> ValueError:
        if self.code == INDEFINITE:
            return ValueError("innovation covariance: not positive definite")
        return ValueError(
            f"values: at time {self.time:g} s no mode can explain the measurement "
            f"(its likelihood is zero or not a number in every mode)"
        )


@attrs.define(eq=False)  # a frozen one takes a few microseconds more to make
class _Job:
    """Part of the targets, all scans."""

    imm: IMM
    plan: Plan
    lanes: Lanes
    scans: Scans
    feed: Feed
    robust: Robust | None
    state: State
    times: Array
    dt: Array
    records: Array
    out: Array
    kept: Index
    start: int
    before: int

    def __call__(self) -> _Failure | None:
        """Take the targets through the scans; say what went wrong first, if anything did."""
        first, begin, last, L = 0, self.start, len(self.records), len(self.lanes)
        records, out, failures = self.records.reshape(-1), self.out.reshape(-1), []
        while first < last:
            code, t, target = machine(
                self.lanes, self.plan.spec, self.feed, self.robust, records, out, self.kept,
                self.out[0].size, first, last, self.start, begin,
            )  # fmt: skip
            if code == FINE:
                break
            first, begin = target - target % L, self.times.shape[-1]
            if code == REOPENS:
                self._reopen(slice(first, min(first + L, last)), t)
                begin = t + 1
            else:
                time = self.times[target if len(self.times) > 1 else 0, t]
                failures.append(_Failure(t, code, self.before + target, float(time)))
            if begin == self.times.shape[-1]:
                first, begin = first + L, self.start
        return min(failures, default=None)

    def _reopen(self, part: slice, t: int) -> None:
        """Take a block with a lost target over scan t by the plain cycle."""
        assert self.robust is not None
        rows, trust = self.records[part], self.robust.trust[part]

        def own(a: Any) -> Any:
            return a[part] if len(a) > 1 else a[[0] * len(rows)]

        times, dt, values = own(self.times)[:, t], own(self.dt)[:, t], own(self.feed.values)[:, t]
        values = np.where((t >= own(self.feed.since))[:, None], values, np.nan)
        before = own(self.times)[:, t] - dt
        state = feeding.state_of(self.plan, self.state, before, rows.copy(), trust.copy())
        scans, measurement = self.scans, self.scans.measurement
        if scans.pairs is not None:
            pairs = scans.pairs[..., t, :, :]
            measurement = measurement.with_pairs(pairs[part] if pairs.ndim > 2 else pairs)
        state = self.imm.cycle(state, times, dt, self.imm.chain(dt), values, measurement)
        feeding.records(self.plan, state, (len(rows),), rows)
        self.robust.trust[part] = feeding.trusts(self.plan, state, (len(rows),))
        if self.kept[t] >= 0:
            self.out[part, self.kept[t]] = rows


def run(
    imm: IMM,
    plan: Plan,
    scans: Scans,
    state: State,
    first: Index,
    alike: bool,
    kept: Index,
    threads: int | None,
) -> Array:
    """Take every target through the scans after `first` (...), the last its fix used.

    Parameters
    ----------
    alike : bool
        Whether these are the same of every target.
    kept : (T,)
        Which of the K records kept each scan's is; -1: none.
    threads : int, optional
        How many to compute in; default as many as there are processors, where it is worth it.

    Returns
    -------
    (B, K, size)
        The records kept, target by target.
    """
    batch, T, m = first.shape, scans.count, scans.measurement.size
    B = math.prod(batch)
    begin = int(first.flat[0] if alike else first.min())
    times, dt, since = _clock(scans, state, first, alike)
    values = scans.values
    if values.shape[:-2] != batch and math.prod(values.shape[:-2]) > 1:
        values = np.broadcast_to(values, (*batch, T, m))
    values = values.reshape(-1, T, m)
    K = int(kept.max()) + 1
    records = np.empty((B, plan.record.size))
    shares = state.log_likelihood.ndim == 0 and begin < 0  # all begin alike; workers fill them in
    begun = np.empty(plan.record.size) if shares else records
    feeding.records(plan, state, () if shares else batch, begun, anew=True)
    out = records[:, None] if K == 1 and kept[-1] == 0 else np.empty((B, K, plan.record.size))
    if begin >= 0 and kept[begin] >= 0:
        out[:, kept[begin]] = records
    trust = feeding.trusts(plan, state, batch) if imm.robust is not None else np.empty((0, 0))
    pairs = scans.pairs
    if pairs is not None and pairs.ndim > 3:
        pairs = np.broadcast_to(pairs, (*batch, *pairs.shape[-3:])).reshape(B, *pairs.shape[-3:])
    lanes = lanes_for(B)
    workers = sharing.workers(B, T) if threads is None else threads
    shared: Feed | None = None
    if len(times) == 1 and pairs is None:
        shared = feeding.template(plan)
        if shared is not None:
            tables, step = plan.tables(dt)
            shared = shared._replace(tables=tables, step=step, since=since)

    def job(part: slice) -> _Job:
        if shares:
            records[part] = begun

        def own(array: Any) -> Any:
            return array[part] if len(array) > 1 else array

        if shared is not None:
            fed = shared._replace(values=feeding.untouchable(own(values)))
            return finish(part, scans, scans.measurement, fed)
        own_pairs = pairs[part] if pairs is not None and pairs.ndim > 3 else pairs
        scan = Scans(scans.measurement, scans.times, scans.values, own_pairs)
        measurement = scan.together()
        usable = feeding.usable(measurement, own(times), own(values))
        fed = feeding.feed(plan, measurement, own(times), own(dt), own(values), own(since), usable)
        return finish(part, scan, measurement, fed)

    def finish(part: slice, scan: Scans, measurement: MeasurementModel, fed: Feed) -> _Job:
        clock, gap = (a[part] if len(a) > 1 else a for a in (times, dt))
        return _Job(
            imm=imm,
            plan=plan,
            lanes=lanes,
            scans=scan,
            feed=fed,
            robust=feeding.robust(imm, measurement, clock, fed.values, trust[part]),
            state=state,
            times=clock,
            dt=gap,
            records=records[part],
            out=out[part],
            kept=kept,
            start=begin + 1,
            before=part.start,
        )

    if begin + 1 < T:
        parts = sharing.shares(B, T, workers, len(lanes))
        failures = sharing.work(parts, job, workers)
        if failures:
            raise min(failures).error()
    return out


def _clock(scans: Scans, state: State, first: Index, alike: bool) -> tuple[Array, Array, Index]:
    """Times (1 | B, T) of the scans, steps between them, and the first scan (1 | B,) taken in."""
    T = scans.count
    begun, begin = np.asarray(state.time), int(first.flat[0] if alike else first.min())
    if alike and scans.times.ndim == 1 and (begun.ndim == 0 or np.all(begun == begun.flat[0])):
        times, begun, since = scans.times[None], begun.reshape(-1)[:1], np.array([begin + 1])
    else:
        batch = first.shape
        times = np.broadcast_to(scans.times, (*batch, T)).reshape(-1, T)
        begun, since = np.broadcast_to(begun, batch).reshape(-1), first.reshape(-1) + 1
    times = np.maximum(times, begun[:, None])
    dt = np.zeros(times.shape)
    if begin + 1 < T:
        dt[:, begin + 1] = times[:, begin + 1] - begun
        dt[:, begin + 2 :] = times[:, begin + 2 :] - times[:, begin + 1 : -1]
    return times, dt, since
