"""Which track follows which target, where nobody says whose a track is; and how well all do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, metrics
from imm_tdoa.bounds.fix import fisher_information
from imm_tdoa.contract import AXES, Array, Index, Mask, MeasurementModel
from imm_tdoa.locate.normal import inverse
from imm_tdoa.recording import Recording
from imm_tdoa.tracking import Tracks

FIXES = 3.0  # standard deviations of a fix that a track may be away from its target
SCORED = 2000  # scans that are scored, evenly spread, where there are more


@attrs.frozen(eq=False, slots=False)
class Following:
    """Targets and tracks side by side, scan by scan.

    Attributes
    ----------
    times : (T,)
        Scans, s.
    targets, tracks : tuple of M, of N str
        Their names.
    truth : (M, T, a)
        Where targets truly were, m, along the axes whose truth may be used; NaN where not there.
    position : (N, T, a)
        Where tracks were, from their confirmation on.
    cutoff : float
        Largest distance at which a track follows a target, m; also that of the set metrics.
    """

    times: Array
    targets: tuple[str, ...]
    tracks: tuple[str, ...]
    truth: Array
    position: Array
    cutoff: float

    @cached_property
    def follower(self) -> Index:
        """Which track follows each target at each scan (M, T); -1: none."""
        return metrics.follow(self.truth, self.position, self.cutoff)

    @cached_property
    def gospa(self) -> metrics.Gospa:
        """GOSPA of order 2 and its parts (T,), m and m²."""
        return metrics.gospa_curve(self.truth, self.position, self.cutoff)

    @cached_property
    def ospa(self) -> Array:
        """OSPA (T,) of order 2, m."""
        return metrics.ospa_curve(self.truth, self.position, self.cutoff)

    @property
    def missed(self) -> Array:
        """Number of targets (T,) without a track."""
        result: Array = self.gospa.missed / (0.5 * self.cutoff**2)
        return result

    @property
    def false(self) -> Array:
        """Number of tracks (T,) without a target."""
        result: Array = self.gospa.false / (0.5 * self.cutoff**2)
        return result

    @property
    def present(self) -> Mask:
        """Which targets are there at which scan (M, T)."""
        return np.asarray(np.isfinite(self.truth).all(axis=-1))

    @property
    def alive(self) -> Mask:
        """Which tracks are there at which scan (N, T)."""
        return np.asarray(np.isfinite(self.position).all(axis=-1))

    @property
    def id_switches(self) -> Index:
        """How often each target (M,) is taken over by another track."""
        return metrics.id_switches(self.follower)

    @property
    def latency(self) -> Array:
        """How long each target (M,) was there before a confirmed track followed it, s."""
        return metrics.latency(self.present, self.follower, self.times)

    @property
    def kept(self) -> Array:
        """Share (M,) of its scans in which a track follows each target; NaN: never there."""
        there, held = self.present.sum(axis=1), (self.follower >= 0).sum(axis=1)
        result: Array = np.where(there > 0, held, np.nan) / np.maximum(there, 1)
        return result

    @property
    def false_tracks(self) -> Mask:
        """Which tracks (N,) never followed anybody."""
        return metrics.false_tracks(self.follower, len(self.tracks))

    @cached_property
    def followed(self) -> Index:
        """Which target each track follows at each scan (N, T); -1: none."""
        result = np.full((len(self.tracks), len(self.times)), -1, dtype=np.int64)
        m, k = np.nonzero(self.follower >= 0)
        result[self.follower[m, k], k] = m
        return result

    @property
    def purity(self) -> Array:
        """Share (N,) of the scans in which a track followed any target, with its main one."""
        return metrics.purity(self.followed)

    @cached_property
    def main(self) -> dict[str, str]:
        """The target that each track followed most, for tracks that followed any."""
        result = {}
        for name, row in zip(self.tracks, self.followed, strict=True):
            own = row[row >= 0]
            if len(own):
                result[name] = self.targets[int(np.bincount(own).argmax())]
        return result


def follow(
    tracks: Tracks,
    recording: Recording,
    times: Any = None,
    *,
    cutoff: float | None = None,
    measurement: MeasurementModel | None = None,
) -> Following | None:
    """Compare tracks with the targets of a recording's truth.

    Parameters
    ----------
    tracks : Tracks
        As `imm_tdoa.Tracker` gives them. They count from their confirmation on.
    recording : Recording
        Whose truth counts.
    times : (T,), optional
        Times of the scans, s; default those of the truth. Only those count at which some truth
        is known; a track is there at those at which it has a row.
    cutoff : float, optional
        Largest distance at which a track follows a target, m. Default: three standard deviations
        of a fix from a single scan of `measurement`, the median over the truth.
    measurement : MeasurementModel, optional
        What was measured; needed where there is no `cutoff`.

    Returns
    -------
    Following or None
        None where there is no truth at any of the times, or nothing says what the cutoff is.
    """
    if recording.truth is None:
        return None
    given = recording.truth["time_s"] if times is None else times
    every = np.unique(_validate.array("times", given, ("T",)))
    clock = every[np.unique(np.linspace(0, len(every) - 1, SCORED).astype(int))]
    names = tuple(dict.fromkeys(recording.truth["target"].tolist()))
    whole = np.stack([recording.truth_at(name, clock)[0] for name in names])
    axes = recording.truth_scoring.axes
    i = [k for k in range(recording.dims) if axes is None or AXES[k] in axes]
    some = np.isfinite(whole[..., i]).all(axis=-1).any(axis=0)
    if not some.any():
        return None
    clock, whole = clock[some], whole[:, some]
    if cutoff is None:
        cutoff = None if measurement is None else _cutoff(measurement, whole, clock, i)
    if cutoff is None:
        return None
    place = np.full((len(tracks), len(clock), len(i)), np.nan)
    for n, (name, track) in enumerate(tracks.items()):
        row = np.searchsorted(track.times, clock, side="right") - 1
        there = (row >= 0) & (clock <= track.times[-1]) & (clock >= tracks.lives[name].confirmed)
        there[there] = track.times[row[there]] == clock[there]
        place[n, there] = track.position[row[there]][:, i]
    return Following(clock, names, tuple(tracks), whole[..., i], place, cutoff)


def _cutoff(
    measurement: MeasurementModel, truth: Array, times: Array, axes: Sequence[int]
) -> float | None:
    """Return `FIXES` times the median error of one scan's fix (two digits), m; None if none."""
    m, k = np.nonzero(np.isfinite(truth[..., axes]).all(axis=-1))
    some = np.unique(np.linspace(0, len(m) - 1, 500).astype(int))
    p = np.nan_to_num(truth[m[some], k[some]])  # a height that the truth lacks counts as 0
    d = measurement.dims
    J = fisher_information(measurement, p, np.zeros_like(p), times[k[some]])[..., :d, :d]
    C, regular = inverse(J)
    variance = np.einsum("...ii->...i", C)[regular][:, axes].sum(axis=-1)
    if not len(variance):
        return None
    return float(f"{FIXES * np.sqrt(np.median(variance)):.2g}")


def labels(names: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Return the purity of each track from the names of its values' senders; "" does not count."""
    known = {
        who: k for k, who in enumerate(dict.fromkeys(w for own in names.values() for w in own))
    }
    number = {who: -1 if who == "" else k for who, k in known.items()}
    return {
        track: float(metrics.purity(np.array([number[w] for w in own], dtype=np.int64)))
        for track, own in names.items()
    }
