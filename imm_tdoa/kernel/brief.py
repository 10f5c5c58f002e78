"""Few targets through a short recording, with as little around the compiled recursion as possible.

There checks and preparations would take longer than the arithmetic.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from imm_tdoa.kernel import feeding
from imm_tdoa.kernel.machine import machine
from imm_tdoa.kernel.plan import FEW_STEPS
from imm_tdoa.kernel.recursion import FINE
from imm_tdoa.kernel.running import SEVERAL, lanes_for
from imm_tdoa.kernel.tracking import track_of
from imm_tdoa.state import State
from imm_tdoa.track import Track

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM

FROM_THE_FIRST = np.zeros(1, dtype=np.int64)


class Runner:
    """An IMM that takes recordings of its own measurement, few targets, through the kernel."""

    def __init__(self, imm: IMM) -> None:
        template = feeding.template(imm.plan)
        assert template is not None
        self.imm, self.plan, self.template = imm, imm.plan, template

    @classmethod
    def fits(cls, imm: IMM) -> bool:
        """Whether the measurement is the same at all times, and nothing needs to be judged."""
        return imm.robust is None and feeding.template(imm.plan) is not None

    def take(self, times: Any, values: Any, start: Any, wait: bool) -> Track | None:
        """Return the track of targets with batch axes (...) from `start` on, every scan kept.

        None where that is not for the kernel, or not for this way: many targets or scans, times
        or starts that differ from target to target, something that does not fit, a scan that no
        mode explains. The caller then goes the longer way, which says what is wrong.

        Parameters
        ----------
        times : (T,)
            Of the scans, s.
        values : (..., T, m)
            What was measured.
        wait : bool
            Whether to wait for the compiler.
        """
        if type(start) is not State or start.space is not self.imm.space:
            return None
        plan, batch = self.plan, start.log_likelihood.shape
        B, m, size = math.prod(batch), self.imm.measurement.size, plan.record.size
        if not 0 < B <= SEVERAL:
            return None
        try:
            t = np.array(times, dtype=float)
            if t.ndim != 1 or not 0 < t.size <= FEW_STEPS:
                return None
            z = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            return None
        T = t.size
        if z.shape != (*batch, T, m):
            return None
        begun = np.asarray(start.time).ravel().tolist()
        if begun.count(begun[0]) < len(begun) or np.count_nonzero(np.isfinite(t)) < T:
            return None
        dt = np.empty((1, T))
        dt[0, 0] = t[0] - begun[0]
        np.subtract(t[1:], t[:-1], out=dt[0, 1:])
        if np.count_nonzero(dt >= 0.0) < T or np.count_nonzero(np.isinf(z)) > 0:
            return None
        lanes = lanes_for(B)
        if not (wait or machine.ready(lanes, robust=False)):
            return None
        tables, step = plan.tables(dt)
        feed = self.template._replace(
            tables=tables,
            step=step,
            values=feeding.untouchable(z).reshape(B, T, m),
            since=FROM_THE_FIRST,
        )
        records, out = np.empty((B, size)), np.empty((*batch, T, size))
        feeding.records(plan, start, batch, records, anew=True)
        code, _, _ = machine(
            lanes, plan.spec, feed, None, records.reshape(-1), out.reshape(-1), np.arange(T),
            T * size, 0, B, 0, 0,
        )  # fmt: skip
        if code != FINE:
            return None
        t.setflags(write=False)
        return track_of(plan, out, t, start, self.imm.cycle.bank, "all")
