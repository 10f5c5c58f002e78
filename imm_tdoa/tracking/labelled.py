"""Recordings whose rows name their target: all targets as one batch of an IMM.

Targets need not be heard at the same times. Each keeps its own clock: the k-th step of the batch
is the k-th scan of every target, padded at the end, so that the work grows with the number of
rows, not with the number of different times.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa.bank import Bank
from imm_tdoa.contract import Index, MeasurementModel
from imm_tdoa.engine import Engine
from imm_tdoa.imm import IMM
from imm_tdoa.recording import schema
from imm_tdoa.recording.recording import Recording
from imm_tdoa.recording.table import Table
from imm_tdoa.scans import Scans
from imm_tdoa.track import Track
from imm_tdoa.tracking.store import describe

Progress = Callable[[int, int], None]


def run(
    make: Callable[[MeasurementModel], IMM],
    recording: Recording,
    progress: Progress | None = None,
    *,
    targets: Sequence[str] | None = None,
    engine: Engine = "auto",
) -> tuple[dict[str, Track], dict[str, str]]:
    """Return the track of every target by name, and why others could not be tracked.

    Parameters
    ----------
    make : callable
        Makes the IMM for a measurement model.
    recording : Recording
        A labelled one.
    progress : callable, optional
        Is told the number of targets done, and of all.
    targets : sequence of str, optional
        Whom to track; default all.
    engine : "auto", "numpy" or "compiled"
        What computes.

    Notes
    -----
    Targets measured by the same model (stations, pairs, noise) make one batch. Rows with standard
    deviations of their own make a model of their own for each target, and are run one by one.
    """
    targets = recording.targets if targets is None else tuple(targets)
    batches: dict[str, list[tuple[str, Scans]]] = {}
    tracks: dict[str, Track] = {}
    failed: dict[str, str] = {}
    for name, own in _by_target(recording):
        if name not in targets:
            continue
        scans = own.scans(name)
        batches.setdefault(_fingerprint(scans), []).append((name, scans))
    done = 0
    for batch in batches.values():
        some, why = _together(make(batch[0][1].measurement), batch, engine)
        tracks |= some
        failed |= why
        done += len(batch)
        if progress is not None:
            progress(done, len(targets))
    return {name: tracks[name] for name in targets if name in tracks}, failed


def _by_target(recording: Recording) -> Iterator[tuple[str, Recording]]:
    """Each target's rows as a recording of its own; every row is looked at once."""
    if len(recording.targets) == 1:
        yield recording.targets[0], recording
        return
    sorted_rows = {}
    for name, table in recording.measured.items():
        order = np.argsort(table["target"], kind="stable")
        who, first = np.unique(table["target"][order], return_index=True)
        sorted_rows[name] = dict(zip(who.tolist(), np.split(order, first[1:]), strict=True))
    for target in recording.targets:
        tables: dict[str, Any] = dict.fromkeys(schema.TABLES)
        for name, rows in sorted_rows.items():
            if target in rows:
                tables[name] = _part_of(recording.measured[name], rows[target])
        yield target, attrs.evolve(recording, **tables)


def _part_of(table: Table, rows: Index) -> Table:
    lines = None if table.lines is None else table.lines[rows]
    return Table({name: table[name][rows] for name in table}, file=table.file, lines=lines)


def _fingerprint(scans: Scans) -> str:
    """What targets of one batch have in common: the measurement, but for changing pairs."""
    said = repr((describe(scans.measurement), scans.values.shape[-1], scans.pairs is None))
    if scans.pairs is not None:
        said = repr((_without_pairs(scans.measurement), scans.values.shape[-1]))
    return hashlib.sha256(said.encode()).hexdigest()


def _without_pairs(measurement: Any) -> Any:
    said = describe(measurement)
    parts = said.get("models", [said])
    for part in parts:
        part.pop("pairs", None)
    return said


def _together(
    imm: IMM, batch: list[tuple[str, Scans]], engine: Engine
) -> tuple[dict[str, Track], dict[str, str]]:
    """Run targets of one measurement model side by side; those without a start are left out."""
    try:
        return _split(imm, batch, _run(imm, batch, engine)), {}
    except ValueError as error:
        if len(batch) == 1:
            return {}, {batch[0][0]: str(error)}
    # someone has no start: find out who, half by half
    middle = len(batch) // 2
    first, why = _together(imm, batch[:middle], engine)
    second, more = _together(imm, batch[middle:], engine)
    return first | second, why | more


def _run(imm: IMM, batch: list[tuple[str, Scans]], engine: Engine) -> Track:
    N, T = len(batch), max(scans.count for _, scans in batch)
    m = imm.measurement.size
    times, values = np.zeros((N, T)), np.full((N, T, m), np.nan)
    pairs = None
    first = batch[0][1].pairs
    if first is not None:
        pairs = np.zeros((N, T, m, 2), dtype=np.int64)
        pairs[..., 0] = 1
    for n, (_, scans) in enumerate(batch):
        K = scans.count
        times[n, :K], times[n, K:] = scans.times, scans.times[-1]
        values[n, :K] = scans.values
        if pairs is not None and scans.pairs is not None:
            pairs[n, :K] = scans.pairs
            pairs[n, K:] = scans.pairs[-1]
    return imm.run(times, values, pairs=pairs, engine=engine)


def _split(imm: IMM, batch: list[tuple[str, Scans]], whole: Track) -> dict[str, Track]:
    """Return each target's own track, without the padding and from its start on."""
    last = whole.times.shape[-1]
    result = {}
    for n, (name, scans) in enumerate(batch):
        T = max(s.count for _, s in batch)
        first = T - last  # rows before the first start of all are not there
        there = np.isfinite(whole.log_likelihood[n])
        there &= np.arange(first, T) < scans.count
        result[name] = _part(whole, n, there)
    return result


def _part(whole: Track, n: int, there: Any) -> Track:
    """Rows `there` (T,) of target n of a batch."""
    kept: dict[str, Any] = {}
    batch = whole.log_likelihood.shape
    for field in attrs.fields(Track):
        value = getattr(whole, field.name)
        if isinstance(value, np.ndarray) and value.shape[: len(batch)] == batch:
            kept[field.name] = value[n][there]
        elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
            kept[field.name] = tuple(v[n][there] for v in value)
    return attrs.evolve(whole, **kept)


def of_bank(bank: Bank, options: dict[str, Any]) -> Callable[[MeasurementModel], IMM]:
    """Return what makes an IMM of `bank` with `options` for any measurement."""
    return lambda measurement: IMM(bank, measurement, **options)
