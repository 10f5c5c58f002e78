"""What a tracker has found: the confirmed tracks by name, and how each of them lived."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs
import numpy as np

from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Index
from imm_tdoa.recording.unlabelled import Scan
from imm_tdoa.track import Track
from imm_tdoa.tracking.history import Pieces, as_track, build
from imm_tdoa.tracking.scene import Scene


@attrs.frozen
class Life:
    """How a track lived.

    Attributes
    ----------
    name : str
        Its name.
    born, confirmed : float
        When it began, and when it was confirmed, s.
    heard : float
        When it last took any row, s.
    ended : float or None
        When it ended, s; None while it lives.
    reason : str
        Why it ended; empty while it lives.
    scans, taken : int
        Scans in its history, and how many of them it took rows of.
    rows : int
        Rows it took.
    """

    name: str
    born: float
    confirmed: float
    heard: float
    ended: float | None
    reason: str
    scans: int
    taken: int
    rows: int

    @property
    def gaps(self) -> int:
        """Scans that it coasted through."""
        return self.scans - self.taken


@attrs.frozen(eq=False, slots=False)
class Tracks(Mapping[str, Track]):
    """The confirmed tracks by name: a mapping that `recording.write_track` and `plot.track` take.

    A track's history begins with its first fix, before it was confirmed, and never shrinks: a
    track that has ended stays in the mapping.

    Attributes
    ----------
    time : float
        Time of the last scan, s.
    lives : mapping of name to Life
        How each track lived.
    ignored : mapping of str to int
        What was ignored, by reason: rows, combinations, births.
    rejected : mapping of str to int
        Tracks that were given up before they were confirmed, by reason.
    failed : mapping of name to str
        Labelled targets that could not be tracked, and why.
    on_trial : int
        Tracks on trial now.
    rows : mapping of str to int
        What became of the values, each counted once: of those ``given``, confirmed tracks have
        ``taken`` some, some were ``ignored`` as they could not be used, and the rest is ``left``,
        nobody's as far as is known. Empty for labelled recordings.
    """

    time: float
    lives: Mapping[str, Life]
    ignored: Mapping[str, int]
    rejected: Mapping[str, int]
    failed: Mapping[str, str]
    on_trial: int
    rows: Mapping[str, int] = attrs.field(factory=dict)
    _scene: Scene | None = attrs.field(default=None, repr=False)
    _bank: Bank | None = attrs.field(default=None, repr=False)
    _given: Mapping[str, Track] = attrs.field(factory=dict, repr=False)
    _update: str = attrs.field(default="ekf", repr=False)

    @classmethod
    def of_scene(cls, scene: Scene, bank: Bank, update: str) -> Tracks:
        """Return what a tracker has found so far."""
        return cls(
            time=scene.time,
            lives=_Lives(scene),
            ignored=dict(scene.ignored),
            rejected=dict(scene.rejected),
            failed={},
            on_trial=int(np.count_nonzero(~scene.confirmed)),
            rows=_Rows(scene),
            scene=scene,
            bank=bank,
            update=update,
        )

    def __getitem__(self, name: str) -> Track:
        if name in self._given:
            return self._given[name]
        if self._scene is None or name not in self.lives:
            raise KeyError(name)
        return self._built[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.lives)

    def __len__(self) -> int:
        return len(self.lives)

    @cached_property
    def _built(self) -> dict[str, Track]:
        assert self._scene is not None
        assert self._bank is not None
        return build(self._scene, self._bank, self._update)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all confirmed tracks, those that have ended included."""
        return tuple(self.lives)

    @cached_property
    def living(self) -> tuple[str, ...]:
        """Names of the confirmed tracks that live, in the order of `position`."""
        if self._scene is None:
            return tuple(self._given)
        numbers = self._scene.numbers
        who = self._scene.identity[self._scene.confirmed]
        return tuple(str(numbers[int(i)]) for i in who)

    @property
    def position(self) -> Array:
        """Positions (N, d) now of the living tracks, m."""
        return self._now("position")

    @property
    def position_covariance(self) -> Array:
        """Covariances (N, d, d) of `position`, m²."""
        return self._now("position_covariance")

    @property
    def velocity(self) -> Array:
        """Velocities (N, d) now of the living tracks, m/s."""
        return self._now("velocity")

    @property
    def mode_probability(self) -> Array:
        """Mode probabilities (N, r) now of the living tracks."""
        return self._now("mode_probability")

    def _now(self, name: str) -> Array:
        if self._scene is None:
            last = [getattr(t, name)[-1] for t in self._given.values()]
            return np.array(last)
        result: Array = getattr(self._snapshot, name)[:, 0]
        return result

    @cached_property
    def _snapshot(self) -> Track:
        """The living tracks now, as a batch of tracks of one scan."""
        assert self._scene is not None
        assert self._bank is not None
        record, scene = self._scene.records, self._scene
        if not record:
            return as_track(Pieces.none(scene), self._bank, scene.state.space, self._update)
        who = np.isin(record[-1].identity, scene.identity[scene.confirmed])
        pieces = Pieces.of([record[-1].part(who)])
        return as_track(pieces.each(), self._bank, scene.state.space, self._update)

    def at(self, times: Any) -> tuple[tuple[str, ...], Array]:
        """Return the names, and positions (N, T, d) at scan times; NaN where a track is not.

        Rows before the confirmation count as not there, rows after the last one heard too where
        the track has ended.

        Parameters
        ----------
        times : (T,)
            Times of scans, s; at other times no track has a position.

        Returns
        -------
        names : tuple of str
            Names of the N tracks.
        position : (N, T, d)
            Where they were, m.
        """
        times = np.asarray(times, dtype=float)
        d = next(iter(self.values())).space.dims if len(self) else 0
        result = np.full((len(self), len(times), d), np.nan)
        for n, name in enumerate(self):
            track, life = self[name], self.lives[name]
            place = np.searchsorted(track.times, times, side="right") - 1
            known = (place >= 0) & np.isin(times, track.times) & (times >= life.confirmed)
            result[n, known] = track.position[place[known]]
        return self.names, result

    def taken(self, name: str) -> tuple[Index, Index]:
        """Return the scan (K,) and the place in that scan (K,) of every value a track took.

        Parameters
        ----------
        name : str
            The track.

        Returns
        -------
        scan, value : (K,) int
            Number of the scan among all that the tracker was given, and of the value in it.

        Raises
        ------
        ValueError
            No such track, or the tracks of a labelled recording.
        """
        scene = self._scene
        if scene is None:
            raise ValueError("taken: labelled tracks take the rows of their own target")
        who = {str(number): identity for identity, number in scene.numbers.items()}
        if name not in who:
            raise ValueError(f"name: no track {name!r}; there are {', '.join(self.names)}")
        scans, values = [], []
        for record in scene.records:
            for n in np.flatnonzero(record.identity == who[name]):
                own = record.members[n]
                own = own[own >= 0]
                scans += [record.scan] * len(own)
                values += own.tolist()
        return np.array(scans, dtype=np.int64), np.array(values, dtype=np.int64)

    def labels(self, scans: Sequence[Scan]) -> dict[str, list[str]]:
        """Return the hidden targets of the values that each track took, for `metrics.purity`.

        Parameters
        ----------
        scans : sequence of Scan
            All scans the tracker was given, from its first; those without targets count as "".

        Returns
        -------
        dict of str to list of str
            By track.

        Raises
        ------
        ValueError
            The tracks of a labelled recording.
        """
        result: dict[str, list[str]] = {}
        for name in self:
            own = zip(*self.taken(name), strict=True)
            result[name] = [
                "" if scans[s].target is None else str(scans[s].target[k]) for s, k in own
            ]
        return result


class _Lives(Mapping[str, Life]):
    """Lives of a scene's confirmed tracks, counted when asked for."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._lives: dict[str, Life] | None = None

    def __getitem__(self, name: str) -> Life:
        if self._lives is None:
            self._lives = _lives(self._scene)
        return self._lives[name]

    def __iter__(self) -> Iterator[str]:
        return (str(c.number) for c in self._scene.confirmations)

    def __len__(self) -> int:
        return len(self._scene.confirmations)


class _Rows(Mapping[str, int]):
    """What became of a scene's values, counted when asked for."""

    NAMES = ("given", "taken", "ignored", "left")

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    @cached_property
    def _counts(self) -> dict[str, int]:
        given, taken, ignored = self._scene.given, self._scene.taken, self._scene.refused
        left = given - taken - ignored
        return dict(zip(self.NAMES, (given, taken, ignored, left), strict=True))

    def __getitem__(self, name: str) -> int:
        return self._counts[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.NAMES)

    def __len__(self) -> int:
        return len(self.NAMES)


def _lives(scene: Scene) -> dict[str, Life]:
    ends = {e.identity: e for e in scene.endings}
    heard = dict(zip(scene.identity.tolist(), scene.standing.heard.tolist(), strict=True))
    count = {c.identity: [0, 0, 0] for c in scene.confirmations}
    for record in scene.records:
        rows = np.count_nonzero(record.share > 0.5, axis=1)
        for who, got in zip(record.identity.tolist(), rows.tolist(), strict=True):
            if who in count:
                one = count[who]
                one[0], one[1], one[2] = one[0] + 1, one[1] + (got > 0), one[2] + got
    result = {}
    for c in scene.confirmations:
        end = ends.get(c.identity)
        scans, taken, rows_taken = count[c.identity]
        result[str(c.number)] = Life(
            name=str(c.number),
            born=c.born,
            confirmed=c.time,
            heard=heard[c.identity] if end is None else end.heard,
            ended=None if end is None else end.time,
            reason="" if end is None else end.reason,
            scans=scans,
            taken=taken,
            rows=rows_taken,
        )
    return result
