"""What the rows of a measurement are made of, for an engine that computes them itself.

A measurement model that says so (by a method ``makeup``) may be computed by the compiled engine;
one that does not is computed by its own `predict` and `jacobian`, with the same answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from imm_tdoa.contract import Index
from imm_tdoa.stations import Stations

if TYPE_CHECKING:
    from imm_tdoa.frames import EastNorthUp

RANGE, RANGE_RATE, AXIS, HEIGHT = 0, 1, 2, 3


@attrs.frozen(eq=False)
class Makeup:
    """What each of m rows is.

    Attributes
    ----------
    kind : (m,) int
        `RANGE` to a station, `RANGE_RATE` to one, a coordinate (`AXIS`), or a `HEIGHT`.
    station, reference : (..., m) int
        The station of each row, and the one whose range (or rate) is subtracted, -1: none. The
        station of an `AXIS` row is the axis. Leading axes are scans, and targets.
    stations : tuple of Stations
        The stations; those of the second are numbered on from those of the first.
    frame : EastNorthUp, optional
        That heights are measured in; without it a height is z.
    """

    kind: Index
    station: Index
    reference: Index
    stations: tuple[Stations, ...] = ()
    frame: EastNorthUp | None = None

    @classmethod
    def of_pairs(cls, kind: int, pairs: Index, stations: Stations) -> Makeup:
        """Differences between the stations of `pairs` (..., m, 2)."""
        m = pairs.shape[-2]
        return cls(np.full(m, kind), pairs[..., 0], pairs[..., 1], (stations,))

    @classmethod
    def of_stations(cls, kind: int, stations: Stations) -> Makeup:
        """One row per station."""
        S = len(stations)
        return cls(np.full(S, kind), np.arange(S), np.full(S, -1), (stations,))


def joined(parts: Sequence[Makeup | None]) -> Makeup | None:
    """Return the makeup of the rows of all parts; None where one has none, or frames differ."""
    whole = [part for part in parts if part is not None]
    frames = {part.frame for part in whole if HEIGHT in part.kind}
    if len(whole) < len(parts) or len(frames) > 1:
        return None
    station: list[Index] = []
    reference: list[Index] = []
    stations: list[Stations] = []
    used = 0
    for part in whole:
        heard = part.kind <= RANGE_RATE
        station.append(np.where(heard, part.station + used, part.station))
        reference.append(np.where(part.reference >= 0, part.reference + used, -1))
        stations.extend(part.stations)
        used += sum(len(s) for s in part.stations)
    batch = np.broadcast_shapes(*(s.shape[:-1] for s in station))

    def together(rows: Sequence[Index]) -> Index:
        return np.concatenate([np.broadcast_to(a, (*batch, a.shape[-1])) for a in rows], axis=-1)

    return Makeup(
        np.concatenate([part.kind for part in whole]),
        together(station),
        together(reference),
        tuple(stations),
        next(iter(frames), None),
    )
