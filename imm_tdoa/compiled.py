"""What the compiled engine keeps of an IMM: made when first asked for."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import attrs

from imm_tdoa.contract import MeasurementModel
from imm_tdoa.engine import Engine, loaded, ready_to_step
from imm_tdoa.kernel.plan import Plan, why_not

if TYPE_CHECKING:
    from imm_tdoa.imm import IMM
    from imm_tdoa.kernel.brief import Runner
    from imm_tdoa.kernel.stepping import Stepper

REMEMBERED = 8  # other measurements


class Compiled:
    """Whether the compiled engine supports an IMM, and what it is told of it.

    Parameters
    ----------
    imm : IMM
        The estimator.
    """

    def __init__(self, imm: IMM) -> None:
        self.imm = imm
        self._others: dict[int, IMM] = {}

    @cached_property
    def why_not(self) -> str | None:
        """What of the IMM is not supported; None where all is."""
        return why_not(self.imm)

    @cached_property
    def plan(self) -> Plan:
        """What the recursion is told."""
        return Plan.of(self.imm)

    def on(self, measurement: MeasurementModel) -> IMM:
        """Return this IMM on another measurement; a few are remembered with what is kept of them.

        Scans of several kinds often take turns.
        """
        known = self._others.get(id(measurement))
        if known is None or known.measurement is not measurement:
            if len(self._others) >= REMEMBERED:
                self._others.clear()
            known = attrs.evolve(self.imm, measurement=measurement)
            self._others[id(measurement)] = known
        return known

    @cached_property
    def _stepper(self) -> Stepper | None:
        if self.why_not is not None:
            return None
        from imm_tdoa.kernel.stepping import Stepper

        return Stepper(self.imm) if Stepper.fits(self.imm) else None

    def stepper(self, engine: Engine) -> Stepper | None:
        """Return what takes a single target through a step quickly, where there is such a thing.

        With ``"auto"`` only where it is ready: a stream never waits for it.
        """
        if engine == "auto" and "_stepper" not in self.__dict__ and not ready_to_step():
            return None
        return self._stepper

    @cached_property
    def _runner(self) -> Runner | None:
        if self.why_not is not None:
            return None
        from imm_tdoa.kernel.brief import Runner

        return Runner(self.imm) if Runner.fits(self.imm) else None

    def runner(self, engine: Engine) -> Runner | None:
        """Return what takes few targets through a short recording quickly, where there is such.

        With ``"auto"`` only where the compiled engine is loaded: nothing short waits for it.
        """
        if engine != "compiled" and not (engine == "auto" and loaded()):
            return None
        return self._runner
