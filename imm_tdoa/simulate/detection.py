"""Which rows there are: how often emitters are detected, and false alarms beside them."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from imm_tdoa.simulate import _checks
from imm_tdoa.simulate._checks import Vector


@attrs.frozen(kw_only=True)
class Detection:
    """How often an emitter is detected (``[detection]``), each row independently of the others.

    A difference is detected as one row: its own station's probability counts, and its reference
    has none. A station that misses an emission in all its differences at once is one of
    ``[dropouts]``.

    Parameters
    ----------
    probability : float
        Probability that a row (an arrival time, a difference) of an emitter is there.
    station : mapping of str to float
        That probability for the rows of single stations, in place of `probability`.
    target : mapping of str to float
        What the probability is multiplied by for single, weaker targets.
    """

    probability: float = attrs.field(default=1.0, validator=_checks.probability)
    station: Mapping[str, float] = attrs.field(factory=dict, validator=_checks.probabilities)
    target: Mapping[str, float] = attrs.field(factory=dict, validator=_checks.probabilities)

    def of(self, station: str, target: str) -> float:
        """Return the probability that a row of `station` and `target` is there."""
        return self.station.get(station, self.probability) * self.target.get(target, 1.0)


@attrs.frozen(kw_only=True)
class Clutter:
    """False alarms (``[clutter]``), in recordings that are not labelled.

    Each scan, each station (each pair, where rows are differences) has a Poisson number of rows
    that are no emitter's, their values uniform. A false arrival time is a row of an emission of
    its own, that no other station hears: rows of one emission are known to belong together, so
    it cannot be taken into another's.

    Parameters
    ----------
    rate : float
        Mean number of false alarms per station (pair) and scan.
    station : mapping of str to float
        That number for single stations (pairs of that station), in place of `rate`.
    window_s : [low, high], optional
        Where the values lie, s. Differences have their own: without a window they lie between
        plus and minus the time that the signal takes from one station of the pair to the other,
        where all true ones do. Arrival times, whose zero is anywhere, need one.
    range_rate_window_mps : [low, high], optional
        Where range rates, or their differences, of false alarms lie, m/s; needed where
        ``sampling.range_rate = true``.
    """

    rate: float = attrs.field(default=0.0, validator=_checks.at_least_zero)
    station: Mapping[str, float] = attrs.field(factory=dict, validator=_checks.rates)
    window_s: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_interval
    )
    range_rate_window_mps: Vector | None = attrs.field(
        default=None, converter=_checks.vector, validator=_checks.is_interval
    )

    @property
    def present(self) -> bool:
        """Whether there can be any."""
        return self.rate > 0.0 or any(rate > 0.0 for rate in self.station.values())

    def of(self, station: str) -> float:
        """Return the mean number of false alarms of a station per scan."""
        return float(self.station.get(station, self.rate))
