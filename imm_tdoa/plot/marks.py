"""What is drawn on maps: truth, ends of tracks, uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from scipy.stats import chi2

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.plot.truth import Truth
from imm_tdoa.recording import Recording
from imm_tdoa.track import Track


def apart(places: Array, distance: float) -> list[int]:
    """Indices of `places` (N, 2) at least `distance` from those before and from the last."""
    kept = [0]
    for i in range(1, len(places) - 1):
        if np.min(np.linalg.norm(places[[*kept, -1]] - places[i], axis=-1)) >= distance:
            kept.append(i)
    return kept


def true_targets(recording: Recording) -> tuple[str, ...]:
    """Names of the targets of which a recording knows the truth, whoever its rows are of."""
    if recording.truth is None:
        return ()
    known = dict.fromkeys(recording.truth["target"].tolist())
    if not recording.labelled:
        return tuple(known)
    return tuple(name for name in recording.targets if name in known) or tuple(known)


def lives(truths: Mapping[str, Truth]) -> dict[str, str]:
    """Return a word for each truth: its target, and its times where they are not all alike."""
    spans = np.array([(t.times[0], t.times[-1]) for t in truths.values()]).reshape(-1, 2)
    words = [f"truth of {name}" for name in truths]
    if len(spans) and np.max(np.ptp(spans, axis=0)) > 0.02 * np.ptp(spans):
        words = [
            f"{w}\n{round(a, 1):g} to {round(b, 1):g} s"
            for w, (a, b) in zip(words, spans, strict=True)
        ]
    return dict(zip(truths, words, strict=True))


def ends(ax: Axes, unit: Unit, clock: Clock, track: Track) -> list[Line2D]:
    """Mark where the track starts and ends."""
    marks = ((0, "o", canvas.START, "start"), (-1, "s", canvas.INK, "end"))
    lines = []
    for row, marker, colour, word in marks:
        lines += ax.plot(
            *unit(track.position[row, :2]),
            linestyle="",
            marker=marker,
            color=colour,
            markersize=8,
            markeredgecolor="white",
            label=f"{word}, {float(clock(track.times[row])):.4g} s",
            zorder=8,
        )
    return lines


def truth_line(ax: Axes, unit: Unit, truth: Truth) -> list[Any]:
    """Draw a truth, wide and grey, so that a track on it shows."""
    return list(
        ax.plot(
            *unit(truth.position[:, :2].T),
            color=canvas.TRUTH,
            linewidth=4.0,
            alpha=0.75,
            solid_capstyle="round",
            marker="o" if len(truth.times) <= 60 else "",
            markersize=6,
            label="truth",
        )
    )


def ellipses(ax: Axes, unit: Unit, centre: Array, P: Array, largest: float) -> int:
    """Draw 95 % ellipses of half axes up to `largest` m; return how many there are."""
    w, V = np.linalg.eigh(P)
    half = np.sqrt(np.maximum(w, 0.0) * chi2.ppf(0.95, 2))
    drawn = 0
    for middle, (minor, major), axes in zip(centre, half, V, strict=True):
        if not np.isfinite(major) or major > largest:
            continue
        x, y = unit(middle)
        ellipse = Ellipse(
            (float(x), float(y)),
            2.0 * float(unit(major)),
            2.0 * float(unit(minor)),
            angle=float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))),
            facecolor=to_rgba(canvas.TRACK, 0.18),
            edgecolor=canvas.TRACK,
            linewidth=0.8,
        )
        ax.add_patch(ellipse)
        drawn += 1
    return drawn
