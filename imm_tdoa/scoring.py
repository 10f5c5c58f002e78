"""A track against the truth of its recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, metrics
from imm_tdoa.contract import AXES, Array, Mask
from imm_tdoa.recording import Recording
from imm_tdoa.track import Track


@attrs.frozen(eq=False)
class Errors:
    """Estimate minus truth, where both are known.

    Attributes
    ----------
    times : (K,)
        Times, s.
    position : (K, a)
        Errors along `axes`, m.
    covariance : (K, a, a)
        What the track says of them, m².
    velocity : (K, a) or None
        Errors of the velocity, m/s; None where the truth has none.
    axes : tuple of str
        Axes that the truth may be used on.
    """

    times: Array
    position: Array
    covariance: Array
    velocity: Array | None
    axes: tuple[str, ...]

    @property
    def distance(self) -> Array:
        """Length (K,) of the position error, m."""
        return np.asarray(np.linalg.norm(self.position, axis=-1))

    @property
    def bound(self) -> Array:
        """Length (K,) that the track itself gives its error with 95 % probability, m."""
        return metrics.error_radius(self.covariance, 0.95)

    def summary(self) -> dict[str, float | None]:
        """Return the figures of merit that `imm-tdoa track` writes, by name."""
        distance, flat = self.distance, self.position[:, : min(2, len(self.axes))]
        result: dict[str, float | None] = {
            "position_rmse_m": float(metrics.rmse(self.position)),
            "position_median_m": float(np.median(distance)),
        }
        if self.axes[:2] == AXES[:2]:
            result["horizontal_rmse_m"] = float(metrics.rmse(flat))
            result["horizontal_median_m"] = float(np.median(np.linalg.norm(flat, axis=-1)))
        speed = self.velocity
        result["velocity_rmse_mps"] = None if speed is None else float(metrics.rmse(speed))
        result["mean_nees"] = float(np.mean(metrics.nees(self.position, self.covariance)))
        return result


def against_truth(track: Track, recording: Recording, target: str | None = None) -> Errors | None:
    """Compare a track with the truth of `target`.

    Where the track has a row at every truth time that it covers, the errors are at the truth
    times. Otherwise they are at the track's own times, with the truth interpolated there
    (`Recording.truth_at`: not over gaps longer than ``max_gap_s``). Of several rows at one time
    the last counts: it has taken in everything that was measured then.

    Parameters
    ----------
    track : Track
        Of one target.
    recording : Recording
        Its truth, and ``truth_scoring.axes``, the axes that may be used.
    target : str, optional
        Which one; may be left out where there is only one.

    Returns
    -------
    Errors or None
        None where track and truth have no time in common.
    """
    if recording.truth is None:
        return None
    chosen = _last_of_each_time(track)
    times = track.times[chosen]
    known = recording.truth_times(target)
    known = known[(known >= times[0]) & (known <= times[-1])]
    if np.all(np.isin(known, times)):
        chosen = chosen & np.isin(track.times, known)
    position, velocity = recording.truth_at(target, track.times[chosen])
    return _errors(track, chosen, position, velocity, recording.truth_scoring.axes)


def against_points(track: Track, times: Any, position: Any) -> Errors | None:
    """Compare a track with true positions, straight in between.

    Parameters
    ----------
    track : Track
        Of one target.
    times : (K,)
        When the target was there, s.
    position : (K, d)
        Where it was, m.

    Returns
    -------
    Errors or None
        None where they have no time in common.
    """
    times = _validate.array("times", times, ("K",))
    place = _validate.array("position", position, (len(times), track.space.dims))
    chosen = _last_of_each_time(track) & (track.times >= times[0]) & (track.times <= times[-1])
    at = track.times[chosen]
    true = np.stack([np.interp(at, times, axis) for axis in place.T], axis=-1)
    return _errors(track, chosen, true, None, None)


def _last_of_each_time(track: Track) -> Mask:
    return np.append(np.diff(track.times) > 0.0, True)


def _errors(
    track: Track,
    chosen: Mask,
    position: Array,
    velocity: Array | None,
    axes: tuple[str, ...] | None,
) -> Errors | None:
    """Errors of the `chosen` rows (T,) against position and velocity (K, d)."""
    i = np.array([k for k in range(track.space.dims) if axes is None or AXES[k] in axes])
    error = (track.position[chosen] - position)[:, i]
    there = np.isfinite(error).all(axis=-1)
    if not np.any(there):
        return None
    speed = None if velocity is None else (track.velocity[chosen] - velocity)[there][:, i]
    return Errors(
        times=track.times[chosen][there],
        position=error[there],
        covariance=track.position_covariance[chosen][there][:, i[:, None], i],
        velocity=None if speed is None or np.isnan(speed).all() else speed,
        axes=tuple(AXES[k] for k in i),
    )


def pooled(errors: Sequence[Errors]) -> Errors:
    """Return the errors of several tracks as those of one; velocities of those that have any.

    Parameters
    ----------
    errors : sequence of Errors
        One or more, along the same axes.
    """
    speeds = [e.velocity for e in errors if e.velocity is not None]
    return Errors(
        times=np.concatenate([e.times for e in errors]),
        position=np.concatenate([e.position for e in errors]),
        covariance=np.concatenate([e.covariance for e in errors]),
        velocity=np.concatenate(speeds) if speeds else None,
        axes=errors[0].axes,
    )
