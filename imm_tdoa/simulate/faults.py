"""What goes wrong in a scenario: noise, clocks, dropouts, outliers."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from imm_tdoa.simulate import _checks


@attrs.frozen(kw_only=True)
class NoiseLevel:
    """Standard deviations of normal errors (``[noise]``).

    Parameters
    ----------
    toa_sigma_s : float
        Of each arrival time, s: differences that share a station are correlated. Or
    tdoa_sigma_s : float
        of each difference, s, independent of the others. Exactly one of the two.
    range_rate_sigma_mps : float, optional
        Of each range rate, m/s.
    bias_sigma_s, bias_time_s : float, optional
        Standard deviation, s, and correlation time, s, of a lasting error of each station: a
        stationary first-order Gauss-Markov process, the same for all targets.
    """

    toa_sigma_s: float | None = attrs.field(default=None, validator=_checks.above_zero)
    tdoa_sigma_s: float | None = attrs.field(default=None, validator=_checks.above_zero)
    range_rate_sigma_mps: float | None = attrs.field(default=None, validator=_checks.above_zero)
    bias_sigma_s: float | None = attrs.field(default=None, validator=_checks.above_zero)
    bias_time_s: float | None = attrs.field(default=None, validator=_checks.above_zero)

    def __attrs_post_init__(self) -> None:
        if (self.toa_sigma_s is None) == (self.tdoa_sigma_s is None):
            raise ValueError("toa_sigma_s: expected exactly one of toa_sigma_s and tdoa_sigma_s")
        if (self.bias_sigma_s is None) != (self.bias_time_s is None):
            raise ValueError("bias_sigma_s: expected bias_sigma_s and bias_time_s, or neither")


@attrs.frozen(kw_only=True)
class Clock:
    """What nobody knows of the emitters' clocks (``[clock]``); it leaves every difference alone.

    To the arrival times of an emission at time t after ``sampling.start_s`` is added
    ``offset_s + drift * t`` and a number drawn for the emission, uniform within
    ``± spread_s / 2``; to its range rates likewise.

    Parameters
    ----------
    offset_s, drift, spread_s : float
        Of arrival times, s, s/s, s.
    range_rate_offset_mps, range_rate_drift_mps2, range_rate_spread_mps : float
        Of range rates, m/s, m/s², m/s.
    """

    offset_s: float = attrs.field(default=0.0, validator=_checks.finite)
    drift: float = attrs.field(default=0.0, validator=_checks.finite)
    spread_s: float = attrs.field(default=1.0, validator=_checks.at_least_zero)
    range_rate_offset_mps: float = attrs.field(default=0.0, validator=_checks.finite)
    range_rate_drift_mps2: float = attrs.field(default=0.0, validator=_checks.finite)
    range_rate_spread_mps: float = attrs.field(default=100.0, validator=_checks.at_least_zero)


@attrs.frozen(kw_only=True)
class Silence:
    """A time in which a station hears nothing (``[[dropouts.silences]]``).

    Parameters
    ----------
    station : str
        Its name.
    from_s, to_s : float, optional
        When, s, both ends included; without them from the beginning, to the end.
    """

    station: str = attrs.field(validator=_checks.name)
    from_s: float | None = attrs.field(default=None, validator=_checks.finite)
    to_s: float | None = attrs.field(default=None, validator=_checks.finite)

    def __attrs_post_init__(self) -> None:
        if self.from_s is not None and self.to_s is not None and self.to_s < self.from_s:
            raise ValueError(
                f"to_s: expected a time after from_s, {self.from_s:g} s, got {self.to_s:g}"
            )


@attrs.frozen(kw_only=True)
class Dropouts:
    """What is not received (``[dropouts]``).

    Parameters
    ----------
    row : float
        Probability that a row (an arrival time, a difference) is missing, with its range rate.
    scan : float
        Probability that a whole scan is missing.
    station : mapping of str to float
        Probability, by station, that it misses an emission, and all its rows are missing.
    silences : sequence of Silence
        Times in which a station hears nothing.
    """

    row: float = attrs.field(default=0.0, validator=_checks.probability)
    scan: float = attrs.field(default=0.0, validator=_checks.probability)
    station: Mapping[str, float] = attrs.field(factory=dict, validator=_checks.probabilities)
    silences: tuple[Silence, ...] = attrs.field(
        default=(), converter=_checks.sequence, validator=_checks.all_are(Silence)
    )


@attrs.frozen(kw_only=True)
class Outliers:
    """Gross errors (``[outliers]``); each is between a half and one and a half of its size.

    Parameters
    ----------
    row : float
        Probability that a row (an arrival time, a difference) is grossly wrong.
    station : mapping of str to float
        Probability, by station, that it takes an arrival grossly wrong; every difference with
        that arrival is then wrong by the same amount.
    size_s : float
        Size of errors of times, s, or
    size_sigmas : float
        in standard deviations of ``[noise]``. Exactly one where a probability is above 0.
    range_rate_size_mps : float, optional
        Size of errors of range rates, m/s, which are wrong independently of the times; without
        it they have none.
    late : bool
        Whether times are always too late, as by reflections, or to either side.
    """

    row: float = attrs.field(default=0.0, validator=_checks.probability)
    station: Mapping[str, float] = attrs.field(factory=dict, validator=_checks.probabilities)
    size_s: float | None = attrs.field(default=None, validator=_checks.above_zero)
    size_sigmas: float | None = attrs.field(default=None, validator=_checks.above_zero)
    range_rate_size_mps: float | None = attrs.field(default=None, validator=_checks.above_zero)
    late: bool = attrs.field(default=False, validator=_checks.is_a(bool))

    def __attrs_post_init__(self) -> None:
        sizes = [size for size in (self.size_s, self.size_sigmas) if size is not None]
        if len(sizes) > 1 or (not sizes and (self.row > 0.0 or any(self.station.values()))):
            raise ValueError("size_s: expected exactly one of size_s and size_sigmas")
