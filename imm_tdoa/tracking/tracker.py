"""Several emitters from rows of which nobody knows whose they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import attrs

from imm_tdoa.bank import Bank
from imm_tdoa.contract import MeasurementModel
from imm_tdoa.imm import IMM
from imm_tdoa.recording.recording import Recording
from imm_tdoa.recording.unlabelled import Scan, unlabelled
from imm_tdoa.tracking import labelled, store
from imm_tdoa.tracking.advance import advance
from imm_tdoa.tracking.scene import Scene
from imm_tdoa.tracking.settings import Settings
from imm_tdoa.tracking.tracks import Life, Tracks

Progress = Callable[[int, int], None]
_IMM = ("update", "merging", "robust", "gate_probability", "degrees_of_freedom", "reopen_after")


class Tracker:
    """Tracks emitters that come and go, from rows without owner.

    Parameters
    ----------
    bank : Bank
        The motion models; every target has its own copy of the mixture.
    measurement : MeasurementModel, optional
        What is measured. Needed for `step`; `run` takes a recording's own.
    imm : mapping, optional
        Options of `IMM`: ``update``, ``merging``; for labelled recordings also ``robust`` and its
        parameters. Without labels these are refused: a rule that leaves out what does not fit
        would make the rows of other emitters fit. There a row that does not fit a track is left
        to others.
    associator : "global", "jpda", "nearest" or Associator
        Who takes which rows among confirmed tracks. A name stands for `GlobalNearest`, `Jpda`
        with ``permutations="best"`` and the learnt clutter density, `Nearest`.
    initiation : Initiation
        How tracks begin: `PairedFixes`, by default with this tracker's detection probability.
    confirmation : Confirmation
        When a track on trial is believed: `SequentialRatio` or `Hits` (M of N).
    deletion : Deletion
        When a confirmed track ends: `Silence`.
    merging : Merging
        Which tracks repeat others: `Duplicates`.
    detection_probability : float
        Probability that a row of a target is measured in a scan in which every target could be
        heard. Messages (arrival times) come when they come: it says nothing of them.
    clutter_density : float or (m,), optional
        Expected false values per scan and unit of each row (per metre). Default: learnt.
    gate_probability : float
        Probability that a target's own value passes its gate. A target also leaves a message
        that is likelier an emitter's without a track: to one of which nearly nothing is known
        any more all messages fit.
    overload : float
        A scan with so many times the usual number of rows says nothing: tracks coast, its rows
        are counted as ignored. If it goes on, it becomes usual.
    most_trials : int
        Most tracks on trial at a time.
    patience : int
        Where rows are barely enough for a position, combinations of several targets' rows
        (ghosts) pass for targets: tracks that share values then wait until one of them is so
        many scans old, and those that explain the values best together are confirmed.
    probation : int
        Scans over which a confirmed track without redundant rows may still be displaced by
        others that explain its values better.
    margin : float
        How much better, nats.

    Attributes
    ----------
    scene : Scene
        The whole state, frozen; replaced by each step.

    Examples
    --------
    >>> tracks = Tracker(bank).run(recording.read("folder"))
    >>> recording.write_track("tracks.csv", tracks)

    As a stream, one scan at a time:

    >>> tracker = Tracker(bank, TDOA(stations, toa_sigma=70e-9))
    >>> for scan in scans:
    ...     tracks = tracker.step(scan)
    ...     print(tracks.time, tracks.living, tracks.position)
    >>> tracker.save("tracker.npz")
    >>> tracker = Tracker(bank, TDOA(stations, toa_sigma=70e-9)).resume("tracker.npz")
    """

    def __init__(
        self,
        bank: Bank,
        measurement: MeasurementModel | None = None,
        *,
        imm: Any = None,
        **parts: Any,
    ) -> None:
        if not isinstance(bank, Bank):
            raise ValueError(f"bank: expected a Bank, got {bank!r}")
        options = dict(imm or {})
        for name in options:
            if name not in _IMM:
                raise ValueError(f"imm: unknown option {name!r}; expected {', '.join(_IMM)}")
        known = [f.name for f in attrs.fields(Settings) if f.name != "imm"]
        for name in parts:
            if name not in known:
                raise ValueError(f"{name}: unknown argument; expected one of {', '.join(known)}")
        self.bank = bank
        self._options, self._parts = options, parts
        self._settings: Settings | None = None
        self._scene: Scene | None = None
        if measurement is not None:
            self._measure(measurement)

    def _measure(self, measurement: MeasurementModel) -> None:
        imm = IMM(self.bank, measurement, **self._options)
        self._settings = Settings(imm, **self._parts)
        self._scene = Scene.empty(imm)

    @property
    def settings(self) -> Settings:
        """What the tracker is made of."""
        if self._settings is None:
            raise ValueError("measurement: needed to take scans; give it to Tracker")
        return self._settings

    @property
    def scene(self) -> Scene:
        """All that is known now."""
        if self._scene is None:
            raise ValueError("measurement: needed to take scans; give it to Tracker")
        return self._scene

    @property
    def tracks(self) -> Tracks:
        """What was found so far."""
        return Tracks.of_scene(self.scene, self.bank, self.settings.imm.update)

    def step(self, scan: Scan) -> Tracks:
        """Take a scan in and return what was found so far.

        A scan that is earlier than the last is ignored and counted, as is whatever else cannot
        be used (`Tracks.ignored`).

        Parameters
        ----------
        scan : Scan
            What was measured at one time, as `imm_tdoa.recording.unlabelled` makes it.

        Returns
        -------
        Tracks
            The confirmed tracks, this scan included.

        Raises
        ------
        ValueError
            No measurement, or a scan that does not fit it.
        """
        if not isinstance(scan, Scan):
            raise ValueError(f"scan: expected a Scan, got {scan!r}")
        self._scene = advance(self.settings, self.scene, scan)
        return self.tracks

    def run(
        self, recording: Recording | Iterable[Scan], progress: Progress | None = None
    ) -> Tracks:
        """Track through a recording, or any scans, and return what was found.

        Of a labelled recording every target gets its track, by its own name, all as one batch of
        the IMM. Without labels tracks are named ``1``, ``2``, ... as they were confirmed; a
        tracker without a measurement takes the recording's own and goes on from its first scan.

        Parameters
        ----------
        recording : Recording or iterable of Scan
            What was measured.
        progress : callable, optional
            Is told how many scans (targets) are done, and how many there are.

        Returns
        -------
        Tracks
            The confirmed tracks, or those of the labelled targets.

        Raises
        ------
        ValueError
            Something that is no recording and no scans, or scans that do not fit the measurement.
        """
        if isinstance(recording, Recording) and recording.labelled:
            return self._run_labelled(recording, progress)
        if isinstance(recording, Recording):
            found = unlabelled(recording)
            scans = list(found.scans)
            if self._settings is None:
                self._measure(found.measurement)
            self._scene = self.scene.refusing(found.ignored, sum(found.ignored.values()))
        else:
            scans = list(recording)
        for k, scan in enumerate(scans):
            if not isinstance(scan, Scan):
                raise ValueError(f"recording: expected scans, got {scan!r}")
            self._scene = advance(self.settings, self.scene, scan)
            if progress is not None:
                progress(k + 1, len(scans))
        return self.tracks

    def _run_labelled(self, recording: Recording, progress: Progress | None) -> Tracks:
        tracks, failed = labelled.run(
            labelled.of_bank(self.bank, self._options), recording, progress
        )
        lives = {name: _life(name, track) for name, track in tracks.items()}
        time = max((float(t.times[-1]) for t in tracks.values()), default=float("-inf"))
        return Tracks(
            time=time,
            lives=lives,
            ignored={},
            rejected={},
            failed=failed,
            on_trial=0,
            given=tracks,
        )

    def save(self, path: str | Path) -> None:
        """Write the whole state to one file (no pickle), whole or not at all.

        Parameters
        ----------
        path : str or Path
            Where; a file that is there is replaced. The folder must exist.

        Raises
        ------
        ValueError
            A tracker without a measurement has no state yet.
        OSError
            The file cannot be written.
        """
        store.save(path, self.settings, self.scene)

    def resume(self, path: str | Path) -> Tracker:
        """Go on from a saved state, as if there had been no interruption; returns the tracker.

        Parameters
        ----------
        path : str or Path
            What `save` wrote.

        Returns
        -------
        Tracker
            This tracker.

        Raises
        ------
        ValueError
            No such file, no saved tracker, or one whose settings differ from this tracker's; the
            message names the first difference.
        """
        self._scene = store.load(path, self.settings)
        return self


def _life(name: str, track: Any) -> Life:
    took = track.nis_dof > 0
    start = float(track.times[0])
    heard = float(track.times[took][-1]) if took.any() else start
    rows = int((track.row_weight > 0.5).sum())
    return Life(name, start, start, heard, None, "", len(track.times), int(took.sum()), rows)
