"""Whether an IMM can be compiled, and what of it does not change from scan to scan."""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from imm_tdoa.bank import MIXING
from imm_tdoa.contract import KINDS, Array, Index, LinearMotion, MeasurementModel, component_names
from imm_tdoa.kernel.layout import Record, Spec, record
from imm_tdoa.makeup import HEIGHT, RANGE_RATE, Makeup

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM

PROBES = (0.0, 0.37, 2.0)  # time steps at which a transition matrix is looked at, s
REMEMBERED = 256  # time steps whose tables are kept
NEVER = 1e-250  # a chance below which the mixing weights are computed by their logarithms
FEW_STEPS = 1000  # which it is quick to look through for different ones


def makeup_of(measurement: MeasurementModel) -> Makeup | None:
    """Return what a measurement's rows are made of, or None where it does not say.

    A subclass that changes a prediction of the class that says so is not believed.
    """
    says = getattr(measurement, "makeup", None)
    if says is None or hasattr(measurement, "constant_errors"):
        return None
    kind = type(measurement)
    owner = next((c for c in kind.__mro__ if "makeup" in vars(c)), kind)
    for name in ("predict", "jacobian", "noise_covariance", "independent", "error_sources"):
        if getattr(kind, name) is not getattr(owner, name):
            return None
    parts = getattr(measurement, "models", ())
    if any(makeup_of(part) is None for part in parts):
        return None
    result: Makeup | None = says()
    return result


def why_not(imm: IMM) -> str | None:
    """Return why an IMM cannot be compiled, in words; None where it can."""
    if imm.update != "ekf":
        return f"update={imm.update!r}"
    if imm.merging not in ("imm", "autonomous"):
        return f"merging={imm.merging!r}"
    if makeup_of(imm.measurement) is None:
        return f"the measurement model {type(imm.measurement).__name__}"
    d = imm.measurement.dims
    for name, model in zip(imm.bank.names, imm.bank.models, strict=True):
        components = tuple(model.components(d))
        order = len(components) // d
        nests = order <= len(KINDS) and components == component_names(d, order - 1)
        if not isinstance(model, LinearMotion) or not nests:
            return f"the motion model {name!r}"
        for dt in PROBES:
            try:
                F = model.transition(dt, d)
            except ValueError:  # a model of one time step only
                return f"the motion model {name!r}, which has no transition over {dt:g} s"
            if not np.array_equal(F, np.kron(F[::d, ::d], np.eye(d))):
                return f"the motion model {name!r}, whose axes are coupled"
    return None


@attrs.frozen(eq=False)
class Plan:
    """What the compiled recursion is told of an IMM."""

    imm: IMM
    spec: Spec
    record: Record
    kept: dict[str, Any] = attrs.field(init=False, factory=dict, repr=False)
    _tables: dict[float, Array] = attrs.field(init=False, factory=dict)
    _single: dict[float, Array] = attrs.field(init=False, factory=dict)

    @classmethod
    def of(cls, imm: IMM) -> Plan:
        """Return the plan of an IMM that can be compiled (`why_not`)."""
        space, measurement = imm.space, imm.measurement
        d = space.dims
        makeup = makeup_of(measurement)
        assert makeup is not None
        n = np.array([len(components) for components in space.modes])
        order = n // d
        k = int(order.max())
        birth = np.zeros(k * d)
        largest, smallest = int(np.argmax(n)), int(np.argmin(n))
        widest = space.lifts[smallest][largest]
        birth[widest.missing] = widest.birth_variance
        pattern = np.zeros((len(n), k, k))
        for j, model in enumerate(imm.bank.models):
            assert isinstance(model, LinearMotion)
            for dt in PROBES:
                seen = model.transition(dt, d)[::d, ::d] != 0.0
                pattern[j, : order[j], : order[j]] += seen
        frame = np.full(12, np.nan)
        if makeup.frame is not None and HEIGHT in makeup.kind:
            frame = makeup.frame.axes_and_origin()
        return cls(
            imm,
            Spec(
                dims=d,
                rule=MIXING.index(imm.bank.mixing),
                rates=bool(np.any(makeup.kind == RANGE_RATE)),
                order=order,
                n=n,
                birth=birth,
                pattern=pattern,
                kind=np.ascontiguousarray(makeup.kind, dtype=np.int64),
                group=np.ascontiguousarray(measurement.offset_group, dtype=np.int64),
                scale=np.ascontiguousarray(measurement.scale, dtype=float),
                frame=frame,
            ),
            record(int(n.sum()), int((n**2).sum()), len(n), measurement.size),
        )

    def tables(self, dt: Array) -> tuple[Array, Index]:
        """What the bank makes of the time steps dt (...), s.

        Returns
        -------
        tables : (U, W)
            Of each different step: whether every entry of the chain is positive; the process
            noise of each mode; the transition matrix per axis of each; the chain. Matrices by
            rows.
        index : (...)
            Which of them each step takes.
        """
        if dt.size <= FEW_STEPS:
            several = dict.fromkeys(dt.ravel().tolist())
            if len(several) == 1:
                return self.table(next(iter(several))), np.zeros(dt.shape, dtype=np.int64)
        steps, index = np.unique(dt, return_inverse=True)
        if len(steps) > REMEMBERED:
            return self._make(steps), index.reshape(dt.shape)
        known = self._tables
        new = [step for step in steps.tolist() if step not in known]
        if new:
            if len(known) + len(new) > REMEMBERED:
                known.clear()
                new = steps.tolist()
            known.update(zip(new, self._make(np.array(new)), strict=True))
        return np.array([known[step] for step in steps.tolist()]), index.reshape(dt.shape)

    def table(self, dt: float) -> Array:
        """The same of one step, (1, W)."""
        known = self._single.get(dt)
        if known is None:
            if len(self._single) >= REMEMBERED:
                self._single.clear()
            known = self._single[dt] = self._make(np.array([dt]))
        return known

    def _make(self, dt: Array) -> Array:
        bank, d = self.imm.bank, self.spec.dims
        chain = self.imm.chain(dt)
        noise, transition = [], []
        for model in bank.models:
            assert isinstance(model, LinearMotion)
            F = model.transition(dt, d)
            transition.append(np.ascontiguousarray(F[:, ::d, ::d]).reshape(len(dt), -1))
            Q = np.broadcast_to(model.process_noise(dt, d), F.shape)
            noise.append(np.ascontiguousarray(Q).reshape(len(dt), -1))
        positive = np.all(chain > NEVER, axis=(-2, -1))[:, None].astype(float)
        whole = (positive, *noise, *transition, chain.reshape(len(dt), -1))
        return np.concatenate(whole, axis=-1)

    @cached_property
    def sizes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Where each mode's mean begins in a record, and its covariance; both with the end."""
        n = self.spec.n.tolist()
        means = tuple(itertools.accumulate(n, initial=0))
        squares = tuple(itertools.accumulate((k * k for k in n), initial=means[-1]))
        return means, squares

    @cached_property
    def nothing_taken(self) -> Array:
        """What a record says of its last scan, from `nis` on, where there was none."""
        at = self.record
        blank = np.zeros(at.size)
        blank[at.nis] = np.nan
        blank[at.mode_nis : at.lost] = np.nan
        return blank[at.nis :]
