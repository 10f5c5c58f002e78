"""What of Source B may be taken one way or another (ALGORITHMS §15)."""

from __future__ import annotations

from typing import Any, Literal

import attrs

from imm_tdoa import _validate
from imm_tdoa.reproduce.sequence_filter.scenario import TICK_S
from imm_tdoa.sequence_filter import SequenceFilter
from imm_tdoa.sequence_filter.loop_gain import RULES, Rule, Weights
from imm_tdoa.stations import Stations

Test = Literal["posterior", "innovation"]


@attrs.frozen(kw_only=True)
class Switches:
    """Readings of the source; the table of cases fixes rule and multiplier case by case.

    Parameters
    ----------
    rule : "iso", "proj" or "bound"
        Process noise from the position increment, for moving targets and random geometries.
    test : "posterior" or "innovation"
        What the gate judges; the source's is the posterior.
    reset_on_gate : bool
        Whether a sequence begins anew where the gate failed; the source's does not.

    Raises
    ------
    ValueError
        A value that is none of these.
    """

    rule: Rule = "iso"
    test: Test = "posterior"
    reset_on_gate: bool = False

    def __attrs_post_init__(self) -> None:
        _validate.one_of("rule", self.rule, RULES)
        _validate.one_of("test", self.test, ("posterior", "innovation"))
        _validate.one_of("reset_on_gate", self.reset_on_gate, (True, False))

    def stage(self, stations: Stations, weights: Weights = "full", **other: Any) -> SequenceFilter:
        """Return the filter of these switches, and of `other` arguments before them."""
        arguments: dict[str, Any] = {**attrs.asdict(self), "weights": weights, **other}
        return SequenceFilter(stations, tick=TICK_S, **arguments)
