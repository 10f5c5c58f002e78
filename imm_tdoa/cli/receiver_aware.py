"""A fix per scan of a recording by the estimators that know of receiver errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.cli.fixes import Fixes, together
from imm_tdoa.locate import Fix, joint_scans, two_step_scans
from imm_tdoa.recording import Recording

TOGETHER = 1000  # scans located at once
ESTIMATORS: dict[str, Callable[..., Fix]] = {"two-step": two_step_scans, "joint": joint_scans}


def receiver_aware(
    recording: Recording, target: str, method: Literal["two-step", "joint"]
) -> Fixes:
    """Locate every scan of `target` from its time differences and range rates.

    Heights are left out, and so are differences where there are arrival times or range rates.

    Raises
    ------
    ValueError
        No time differences, too few stations.
    """
    if recording.toa is None and recording.tdoa is None:
        raise ValueError(f"--method {method}: the recording has no time differences of arrival")
    used = attrs.evolve(recording, height=None)
    if used.toa is not None:
        used = attrs.evolve(used, tdoa=None)
    if used.range_rate is not None:
        used = attrs.evolve(used, fdoa=None)
    scans = used.scans(target)
    parts = {}
    for first in range(0, scans.count, TOGETHER):
        some = scans.part(slice(first, first + TOGETHER))
        parts[str(first)] = Fixes(some.times, ESTIMATORS[method](some))
    return together(parts)


def with_station_errors(recording: Recording, sigma: float) -> Recording:
    """Return the recording with a standard deviation of every station coordinate, m.

    Raises
    ------
    ValueError
        A standard deviation that is not above 0.
    """
    variance = _validate.positive("--station-sigma", sigma) ** 2
    S, d = len(recording.stations), recording.dims
    errors = np.broadcast_to(variance * np.eye(d), (S, d, d))
    stations = attrs.evolve(recording.stations, position_covariance=errors)
    return attrs.evolve(recording, stations=stations)
