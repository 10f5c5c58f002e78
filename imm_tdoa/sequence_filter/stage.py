"""Kalman filtering of time-difference sequences before locating (Source B; ALGORITHMS §6)."""

from __future__ import annotations

from typing import Any, Literal

import attrs
import numpy as np

from imm_tdoa import _validate, registry
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.scans import Scans
from imm_tdoa.sequence_filter import loop_gain as gain
from imm_tdoa.sequence_filter import recursion, response
from imm_tdoa.sequence_filter.filtered import FilteredSequence
from imm_tdoa.sequence_filter.loop_gain import Rule, Weights
from imm_tdoa.stations import Stations

Test = Literal["posterior", "innovation"]
SIGMAS = ("tick", "toa_sigma", "tdoa_sigma")


@attrs.frozen(eq=False)
class SequenceFilter:
    """Scalar Kalman filters on the time differences of adjacent stations, before the fix.

    Each epoch: every difference z_i = arrival(i) - arrival(i + 1) goes through a scalar filter
    of a random walk; a gate decides between the filtered difference and the measured one; the
    position follows from those by weighted least squares; the filters' process noise for the
    next epoch follows from how far the position moved (Xu & Hua 2020).

    The fixes of a target that stands shrink to a point where `kappa` is below 1. The point is not
    the target: it stands still at what is left of the error. A target that moves is followed with
    a lag of rate (1 - K)/K per epoch; a motion model (`IMM`) is the right tool there. What comes
    out is coloured and no measurement for a tracker.

    Parameters
    ----------
    stations : Stations
        The receivers, fixed or moving, at least d + 1, in the order in which they are
        differenced. Where they move, predictions follow them. Position errors they declare
        count in the weights of the fix.
    tick : float, optional
        Clock tick T0, s: the differences have the variance R = `r_factor` T0².
    toa_sigma : float or (S,), optional
        Standard deviation of each arrival, s. Adjacent differences share one and are correlated,
        which the scalar filters leave out and the fix does not.
    tdoa_sigma : float or (m,), optional
        Standard deviation of each difference, s, independent of the others.
    r_factor : float
        R / T0²: 1/6 for two arrivals rounded to the tick; 1/12 and 1/3 are other readings of
        the source.
    rule : "iso", "proj" or "bound"
        Process noise from the position increment Δs: ``iso`` (2/d) |Δs|², ``proj`` what Δs
        changes in each difference, squared, ``bound`` 4 |Δs|².
    multiplier : float or "auto"
        Factor on it; ``"auto"`` sets it at every position such that `kappa` is 0.5.
    floor : float
        Least process noise per epoch, as a standard deviation, s.
    gate : float or None
        How many standard deviations the filtered difference may lie off the measured one; None
        takes the filtered one always.
    gate_s : float, optional
        The same in seconds, in the place of `gate`.
    test : "posterior" or "innovation"
        What the gate judges: the updated state against the measurement, in standard deviations
        of R (the source's; loosest when the gain is high), or the innovation, in its own.
    reset_on_gate : bool
        Whether a sequence whose gate fails begins anew from the measurement.
    weights : "full" or "diagonal"
        Whether the fix weighs with the full covariance of the differences or with its diagonal.
    speed : float
        Speed of the signal, m/s.
    sigma_times : (K,), optional
        With it, sigmas are (K, S) or (K, m) and hold at these times, as in `TDOA`.

    Raises
    ------
    ValueError
        Too few stations, not exactly one of the three standard deviations, an unknown rule, test
        or weights, a negative multiplier or floor, a gate of 0 or less.

    Examples
    --------
    >>> filtered = SequenceFilter(stations, toa_sigma=3e-9).run(times, tdoa)
    >>> filtered.position, filtered.raw_position
    """

    stations: Stations
    tick: float | None = attrs.field(default=None, kw_only=True)
    toa_sigma: Any = attrs.field(default=None, kw_only=True)
    tdoa_sigma: Any = attrs.field(default=None, kw_only=True)
    r_factor: float = attrs.field(default=1.0 / 6.0, kw_only=True)
    rule: Rule = attrs.field(default="iso", kw_only=True)
    multiplier: float | Literal["auto"] = attrs.field(default=1.0, kw_only=True)
    floor: float = attrs.field(default=0.0, kw_only=True)
    gate: float | None = attrs.field(default=3.0, kw_only=True)
    gate_s: float | None = attrs.field(default=None, kw_only=True)
    test: Test = attrs.field(default="posterior", kw_only=True)
    reset_on_gate: bool = attrs.field(default=False, kw_only=True)
    weights: Weights = attrs.field(default="full", kw_only=True)
    speed: float = attrs.field(default=299792458.0, kw_only=True)
    sigma_times: Any = attrs.field(default=None, kw_only=True)
    measurement: MeasurementModel = attrs.field(init=False, repr=False)

    def __attrs_post_init__(self) -> None:
        gain.check_stations(self.stations)
        _validate.one_of("rule", self.rule, gain.RULES)
        _validate.one_of("test", self.test, ("posterior", "innovation"))
        _validate.one_of("weights", self.weights, gain.WEIGHTS)
        _validate.one_of("reset_on_gate", self.reset_on_gate, (True, False))
        put = object.__setattr__
        put(self, "speed", _validate.positive("speed", self.speed))
        put(self, "r_factor", _validate.positive("r_factor", self.r_factor))
        put(self, "floor", _validate.non_negative("floor", self.floor))
        if not isinstance(self.multiplier, str) or self.multiplier != "auto":
            put(self, "multiplier", _multiplier(self.multiplier))
        for name in ("gate", "gate_s", "tick"):
            if getattr(self, name) is not None:
                put(self, name, _validate.positive(name, getattr(self, name)))
        put(self, "measurement", registry.load("tdoa")(self.stations, **self._noise()))

    def _noise(self) -> dict[str, Any]:
        """Arguments of the measurement model of the differences."""
        given = [name for name in SIGMAS if getattr(self, name) is not None]
        if len(given) != 1:
            got = ", ".join(given) if given else "none"
            raise ValueError(f"sigma: give exactly one of {', '.join(SIGMAS)}, got {got}")
        (name,) = given
        value = getattr(self, name)
        if name == "tick":
            if self.sigma_times is not None:
                raise ValueError("sigma_times: a clock tick does not change over time")
            name, value = "toa_sigma", value * np.sqrt(self.r_factor / 2.0)
        return {
            name: value,
            "sigma_times": self.sigma_times,
            "speed": self.speed,
            "pairs": "adjacent",
        }

    def run(self, times: Any, tdoa: Any) -> FilteredSequence:
        """Filter whole sequences.

        Parameters
        ----------
        times : (T,) or (..., T)
            Epochs, s, not decreasing. The random walk counts epochs, not seconds.
        tdoa : (..., T, m)
            Measured arrival(i) - arrival(i + 1), s, m = S - 1. NaN is missing: that sequence is
            only predicted, and the fix of the epoch made of the others. Leading axes are
            separate targets or runs.

        Raises
        ------
        ValueError
            Decreasing times, shapes that do not fit, infinite values.
        """
        times = _validate.array("times", times, (None, "T"))
        shape = (None, times.shape[-1], self.measurement.size)
        values = _validate.array("tdoa", tdoa, shape, finite=False)
        scans = Scans.checked(self.measurement, times, values)
        return recursion.filtered(self, scans)

    def kappa(self, position: Any, time: float | Array = 0.0) -> Array:
        """Return the loop gain (...) of this filter for a target that stands.

        As the function `kappa`, for the noise, weights and multiplier of this filter; 0.5 where
        the multiplier is ``"auto"``.

        Parameters
        ----------
        position : (..., d)
            Where it stands, m.
        time : float or (...)
            When, s, for stations that move.
        """
        p = _validate.array("position", position, (None, self.stations.dims))
        present = np.ones(self.measurement.size, dtype=bool)
        once = response.Response.at(self, p, time, present).loop_gain(self.rule)
        return response.multiplier(self, once) * once

    @property
    def automatic(self) -> bool:
        """Whether the multiplier follows the geometry."""
        return self.multiplier == "auto"


def _multiplier(value: Any) -> float:
    try:
        return _validate.non_negative("multiplier", value)
    except ValueError as error:
        raise ValueError(f"{error}, or 'auto'") from None
