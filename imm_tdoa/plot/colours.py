"""Colours of tracks, the same in every picture, and how their lines are cut."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from imm_tdoa.contract import Array, Mask
from imm_tdoa.track import Track
from imm_tdoa.tracking import Life

# Twelve colours that differ from each other and from those of truth and stations; the first eight
# do so for every kind of colour vision.
PALETTE = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#7A1FA2",
    "#1B2A6B",
    "#B5C800",
    "#D6006C",
    "#8C564B",
    "#00B8B0",
    "#5B7300",
)
SEEN = 40  # points of a track by which it is told how near others come
GAP = 2.5  # usual intervals between a track's own rows that make a gap


def of_tracks(tracks: Mapping[str, Track]) -> dict[str, str]:
    """Return a colour per track; those that must share one are as far apart as can be."""
    places = [_some(track) for track in tracks.values()]
    chosen: list[int] = []
    for n, own in enumerate(places):
        if n < len(PALETTE):
            chosen.append(n)
            continue
        room = np.full(len(PALETTE), np.inf)
        for m, colour in enumerate(chosen):
            apart = np.linalg.norm(own[:, None] - places[m][None], axis=-1).min()
            room[colour] = min(room[colour], float(apart))
        chosen.append(int(np.argmax(room)))
    return {name: PALETTE[c] for name, c in zip(tracks, chosen, strict=True)}


def _some(track: Track) -> Array:
    rows = np.unique(np.linspace(0, len(track.times) - 1, SEEN).astype(int))
    return np.asarray(track.position[rows, :2])


class Stretches(NamedTuple):
    """Rows of a track that is drawn.

    Attributes
    ----------
    shown : (T,)
        Rows from its birth until it was last heard, or until now while it lives.
    coasting : (T - 1,)
        Whether it was on its own between a row and the next.
    trial : (T,)
        Rows before it was confirmed.
    """

    shown: Mask
    coasting: Mask
    trial: Mask


def stretches(track: Track, life: Life) -> Stretches:
    """Return which rows of a track are drawn, and how.

    It coasts where it took no row for longer than a few times as long as usual: single rows
    missed, and messages of others in between, are no gaps.
    """
    took = track.nis_dof > 0
    took[0] = True  # the fix that it began with
    heard = track.times[took]
    usual = float(np.median(np.diff(heard))) if len(heard) > 1 else 0.0
    last = np.inf if life.ended is None else life.heard
    own = np.flatnonzero(took)
    place = np.searchsorted(own, np.arange(len(took) - 1), side="right")
    before = track.times[own[place - 1]]
    after = np.append(heard, track.times[-1])[place]
    return Stretches(
        np.asarray(track.times <= last),
        np.asarray(after - before > GAP * usual),
        np.asarray(track.times < life.confirmed),
    )


def pieces(flags: Mask) -> list[tuple[int, int]]:
    """Return first and last place of every run of `flags` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
