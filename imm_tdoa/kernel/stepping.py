"""One step of one target through the compiled recursion, with as little around it as possible."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, MeasurementModel
from imm_tdoa.kernel import feeding
from imm_tdoa.kernel.layout import Feed
from imm_tdoa.kernel.machine import machine
from imm_tdoa.kernel.plan import Plan
from imm_tdoa.kernel.recursion import FINE
from imm_tdoa.kernel.running import lanes_for
from imm_tdoa.kernel.vectors import ONE
from imm_tdoa.state import State, Taken

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM

NOWHERE, NOTHING = np.array([-1]), np.empty(0)


class PackedState(State):
    """A state of one target as the compiled engine keeps it; its parts are views, made when asked.

    It cannot be changed; `attrs.evolve` makes a plain `State` of it.
    """

    __slots__ = ("_estimate", "_like", "_plan", "_record", "_time")

    _estimate: Array
    _like: State
    _plan: Plan
    _record: Array
    _time: Array

    def __new__(cls, *args: Any, **fields: Any) -> State:  # type: ignore[misc]
        return State(*args, **fields)

    @classmethod
    def of(cls, plan: Plan, like: State, time: Any, record: Array, estimate: Array) -> PackedState:
        """Return the state of a record (size,) and combined estimate (n + n²,)."""
        self = object.__new__(cls)
        put = object.__setattr__
        put(self, "_plan", plan)
        put(self, "_like", like)
        put(self, "_time", time)
        put(self, "_record", record)
        put(self, "_estimate", estimate)
        return self

    def __reduce__(self) -> Any:
        return State, tuple(getattr(self, a.name) for a in attrs.fields(State))

    @property
    def time(self) -> Array:
        return np.asarray(self._time)

    @property
    def means(self) -> tuple[Array, ...]:
        return feeding.modes(self._plan, self._record)[0]

    @property
    def covariances(self) -> tuple[Array, ...]:
        return feeding.modes(self._plan, self._record)[1]

    @property
    def log_mode_probability(self) -> Array:
        at = self._plan.record
        return self._record[at.log_p : at.log_likelihood]

    @property
    def log_likelihood(self) -> Array:
        return np.asarray(self._record[self._plan.record.log_likelihood])

    @property
    def taken(self) -> Taken:
        return feeding.taken(self._plan, self._record)

    @property
    def trust(self) -> Any:
        return self._like.trust

    @property
    def space(self) -> Any:
        return self._like.space

    @property
    def modes(self) -> Any:
        return self._like.modes

    @property
    def mean(self) -> Array:
        """Combined mean (n,) of all components."""
        return self._estimate[: len(self._like.space.components)]

    @property
    def covariance(self) -> Array:
        """Combined covariance (n, n), spread between the modes included."""
        n = len(self._like.space.components)
        return self._estimate[n:].reshape(n, n)


class Stepper:
    """An IMM that takes scans of its own measurement, one target, through the kernel."""

    def __init__(self, imm: IMM) -> None:
        plan = imm.plan
        self.plan, self.imm = plan, imm
        feed = feeding.template(plan)
        assert feed is not None
        self.ints, self.floats = packed(plan, feed)
        n = int(plan.spec.n.max())
        self.estimate = n * (n + 1)
        self.shape = (imm.measurement.size,)

    @classmethod
    def fits(cls, imm: IMM) -> bool:
        """Whether the measurement is the same at all times, and nothing needs to be judged."""
        return imm.robust is None and feeding.template(imm.plan) is not None

    def take(self, state: State, time: Any, values: Any) -> State | None:
        """Return the state after the scan `values` (m,) at `time`.

        None where that is not for the kernel: a batch, something that does not fit, a scan that
        no mode explains. The caller then goes the longer way, which says what is wrong.
        """
        plan = self.plan
        if type(state) is PackedState and state._plan is plan:
            record, like, before = state._record.copy(), state._like, float(state._time)
        elif isinstance(state, State) and state.log_likelihood.ndim == 0:
            if state.space is not self.imm.space:
                return None
            record, like, before = np.empty(plan.record.size), state, float(state.time)
            feeding.records(plan, state, (), record, anew=True)
        else:
            return None
        if isinstance(time, np.ndarray) and time.ndim > 0:
            return None
        try:
            now, z = float(time), np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            return None
        if not z.flags.carray:  # another type to Numba, for which it would compile the step anew
            z = np.array(z)
        dt = now - before
        if z.shape != self.shape or not 0.0 <= dt < np.inf:
            return None
        estimate = np.empty(self.estimate)
        given = (ONE, self.ints, self.floats, plan.table(dt), z, record, estimate)
        try:
            code = machine.step(*given) if machine.stepped else machine.first_step(*given)
        except OSError:  # it is compiled, but the folder for it has become unwritable
            code = machine.step(*given)
        machine.stepped = True
        if code != FINE:
            return None
        return PackedState.of(plan, like, now, record, estimate)


def packed(plan: Plan, feed: Feed) -> tuple[Index, Array]:
    """All numbers of a plan and of what stays the same from scan to scan, in two arrays.

    Few arguments are quick to hand over; `machine.unpacked` finds them again.
    """
    spec = plan.spec
    r, m = len(spec.n), len(spec.kind)
    k, S = spec.pattern.shape[-1], feed.place.shape[2]
    ints = [
        np.array([spec.dims, spec.rule, int(spec.rates), r, m, k, S, len(spec.birth)]),
        spec.order, spec.n, spec.kind, spec.group, feed.station.ravel(), feed.reference.ravel(),
    ]  # fmt: skip
    floats = [
        spec.birth, spec.pattern.ravel(), spec.scale, spec.frame, feed.noise.ravel(),
        feed.place.ravel(), feed.speed.ravel(),
    ]  # fmt: skip
    return np.concatenate(ints).astype(np.int64), np.concatenate(floats)


def step(
    imm: IMM, state: State, time: Array, dt: Array, values: Array, measurement: MeasurementModel
) -> State:
    """Return the states after a scan, any batch; by the plain cycle where a lost target reopens."""
    plan = imm.plan
    batch = np.broadcast_shapes(state.log_likelihood.shape, time.shape, values.shape[:-1])
    B, m = int(np.prod(batch)), measurement.size
    trust = np.empty((0, 0))
    if not np.isfinite(values).any():  # not even the noise need be known then
        return imm.cycle(state, time, dt, imm.chain(dt), values, measurement)
    if imm.robust is not None:
        if np.any(state.trust.opens):
            return imm.cycle(state, time, dt, imm.chain(dt), values, measurement)
        trust = feeding.trusts(plan, state, batch)
    records = np.empty((B, plan.record.size))
    feeding.records(plan, state, batch, records, anew=True)

    def flat(array: Array, trailing: int) -> Array:
        shape = array.shape[: array.ndim - trailing]
        if np.prod(shape) > 1 and shape != batch:
            array = np.broadcast_to(array, batch + array.shape[array.ndim - trailing :])
        return array.reshape(-1, 1, *array.shape[array.ndim - trailing :])

    clock, gap = flat(time, 0), flat(dt, 0)
    values = flat(values, 1)
    usable = feeding.usable(measurement, clock, values)
    feed = feeding.feed(plan, measurement, clock, gap, values, np.zeros(1, int), usable)
    how = feeding.robust(imm, measurement, clock, values, trust)
    code, _, _ = machine(
        lanes_for(B), plan.spec, feed, how, records.reshape(-1), NOTHING, NOWHERE, 0, 0, B, 0, 0,
    )  # fmt: skip
    if code != FINE:  # which says what is wrong
        return imm.cycle(state, time, dt, imm.chain(dt), values.reshape(*batch, m), measurement)
    whole = records.reshape(*batch, -1)
    kept = trust.reshape(*batch, -1) if imm.robust is not None else None
    return feeding.state_of(plan, state, time, whole, kept)
