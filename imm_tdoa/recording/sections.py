"""``[noise]`` and ``[truth]`` of a recording."""

from __future__ import annotations

from typing import Any

import attrs

from imm_tdoa import _validate
from imm_tdoa.contract import AXES


@attrs.frozen
class Noise:
    """Standard deviations of a recording (``[noise]``); None where not given.

    Parameters
    ----------
    toa_sigma_s, tdoa_sigma_s : float, optional
        Of an arrival time, of a difference of arrival times, s. Of differences that share
        stations the first says more: they are correlated.
    range_rate_sigma_mps : float, optional
        Of a range rate, m/s.
    bias_sigma_s, bias_time_s : float, optional
        Of an error per station (or pair) that lasts, s, and about how long it lasts, s.
    sigma_floor_s : float, optional
        Least standard deviation of a time that is believed, s.

    Raises
    ------
    ValueError
        A number that is not above zero.
    """

    toa_sigma_s: float | None = None
    tdoa_sigma_s: float | None = None
    range_rate_sigma_mps: float | None = None
    bias_sigma_s: float | None = None
    bias_time_s: float | None = None
    sigma_floor_s: float | None = None

    def __attrs_post_init__(self) -> None:
        for field in attrs.fields(Noise):
            value = getattr(self, field.name)
            if value is not None:
                object.__setattr__(self, field.name, _validate.positive(field.name, value))


def _axes(given: Any) -> tuple[str, ...] | None:
    return None if given is None else tuple(given)


@attrs.frozen
class TruthScoring:
    """What of the truth scoring may use (``[truth]``).

    Parameters
    ----------
    axes : tuple of str, optional
        Axes whose truth is good enough, of ``x``, ``y``, ``z``; default all.
    max_gap_s : float, optional
        Longest time between two truth rows that may be interpolated over, s; default any.
    """

    axes: tuple[str, ...] | None = attrs.field(default=None, converter=_axes)
    max_gap_s: float | None = None

    def __attrs_post_init__(self) -> None:
        if self.axes is not None:
            axes = set(self.axes)
            if not axes or len(axes) != len(self.axes) or not axes <= set(AXES):
                raise ValueError(f"axes: expected different ones of x, y, z, got {[*self.axes]}")
        if self.max_gap_s is not None:
            gap = _validate.positive("max_gap_s", self.max_gap_s)
            object.__setattr__(self, "max_gap_s", gap)
