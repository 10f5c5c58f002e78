"""What of a scan is let in, and what is counted as ignored."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Mask, MeasurementModel
from imm_tdoa.recording.unlabelled import Scan
from imm_tdoa.tracking.rows import Unlabelled
from imm_tdoa.tracking.scene import Scene
from imm_tdoa.tracking.settings import Settings

SETTLE = 0.1  # weight of the newest scan in how many rows are usual


def refuse_foreign(measurement: MeasurementModel, scan: Scan) -> None:
    if len(scan.row) and scan.row.max() >= measurement.size:
        raise ValueError(
            f"row: expected numbers below {measurement.size}, the rows of the measurement, "
            f"got {int(scan.row.max())}"
        )
    if scan.emission is None and np.any(measurement.offset_group[scan.row] >= 0):
        raise ValueError(
            "emission: needed for rows that share an unknown offset (arrival times): which "
            "values are of one emission?"
        )


def at_the_door(
    settings: Settings, scene: Scene, scan: Scan, low: Array, high: Array
) -> tuple[Unlabelled, dict[str, int], float]:
    """The usable rows, internal units (NaN the others), what was ignored, and the usual number.

    `low` and `high` (m,) bound what a row can be at all.
    """
    measurement = settings.imm.measurement
    values = scan.values * measurement.scale[scan.row]
    there = np.isfinite(values)
    impossible = there & ~((values >= low[scan.row]) & (values <= high[scan.row]))
    twice = _repeated(scan) & there & ~impossible
    ignored = {
        "impossible values": int(np.count_nonzero(impossible)),
        "second value of a row in one emission": int(np.count_nonzero(twice)),
    }
    values = np.where(impossible | twice, np.nan, values)
    count = int(np.count_nonzero(np.isfinite(values)))
    usual = float(count) if scene.scans == 0 else scene.usual
    most = settings.overload * max(usual, measurement.size)
    usual += SETTLE * (min(count, most) - usual)
    if count > most:
        ignored["rows of overloaded scans"] = count
        values = np.full_like(values, np.nan)
    emission = scan.emission if scan.emission is None else np.where(twice, -1, scan.emission)
    if emission is not None and np.any(twice):
        emission = np.where(twice, emission.max() + 1 + np.arange(len(twice)), emission)
    return Unlabelled(values, scan.row, emission=emission), ignored, usual


def _repeated(scan: Scan) -> Mask:
    """Values (K,) whose emission had one of their row before."""
    result = np.zeros(len(scan), dtype=bool)
    if scan.emission is None or not len(scan):
        return result
    _, first = np.unique(np.stack([scan.emission, scan.row]), axis=1, return_index=True)
    result[:] = True
    result[first] = False
    return result
