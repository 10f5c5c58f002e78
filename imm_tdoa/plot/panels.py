"""Panels over time: height and mode probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from imm_tdoa.frames import EastNorthUp
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.plot.truth import Truth
from imm_tdoa.track import Track


def height(
    ax: Axes, clock: Clock, track: Track, truth: Truth | None, frame: EastNorthUp | None
) -> Sequence[Any]:
    """Height over time with its 95 % band."""
    level, up = track.position[:, 2], np.broadcast_to([0.0, 0.0, 1.0], track.position.shape)
    if frame is not None:
        level, up = frame.height(track.position)
    sigma = np.sqrt(np.einsum("ti,tij,tj->t", up, track.position_covariance, up))
    known, times = [level], clock(track.times)
    true = None
    if truth is not None and np.isfinite(truth.position).all(axis=-1).any():
        whole = np.isfinite(truth.position).all(axis=-1)
        truth = Truth(truth.times[whole], truth.position[whole])
        true = truth.position[:, 2] if frame is None else frame.height(truth.position)[0]
        known.append(true)
    every = np.concatenate(known)
    low, high = (float(q) for q in np.nanquantile(every, [0.01, 0.99]))
    edge = max(0.4 * (high - low), 2.0 * float(np.nanmedian(sigma)), 1.0)
    unit = Unit(max(abs(low), abs(high)))
    handles: list[Any] = []
    if true is not None and truth is not None:
        handles += ax.plot(
            clock(truth.times),
            unit(true),
            color=canvas.TRUTH,
            linewidth=4.0,
            alpha=0.75,
            label="truth",
        )
    band = ax.fill_between(
        times,
        unit(level - 1.96 * sigma),
        unit(level + 1.96 * sigma),
        color=canvas.TRACK,
        alpha=0.18,
        linewidth=0.0,
        label="95 % band",
    )
    handles += ax.plot(times, unit(level), color=canvas.TRACK, linewidth=1.5, label="track")
    handles.append(band)
    ax.set_ylim(*unit([low - edge, high + edge]))
    what = "z" if frame is None else "height above\nWGS84 ellipsoid"
    canvas.dress(ax, clock.label, f"{what} [{unit.name}]")
    return handles


def modes(ax: Axes, clock: Clock, track: Track) -> Sequence[Any]:
    """Mode probabilities as a stacked ribbon."""
    colours = [canvas.MODES[j % len(canvas.MODES)] for j in range(len(track.modes))]
    layers = ax.stackplot(
        clock(track.times),
        np.nan_to_num(track.mode_probability.T),
        colors=colours,
        labels=track.modes,
        edgecolor="white",
        linewidth=0.3 if len(track.times) < 300 else 0.0,
    )
    ax.set_ylim(0.0, 1.0)
    canvas.dress(ax, clock.label, "mode probability")
    return layers[::-1]
