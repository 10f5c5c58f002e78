"""What ``imm-tdoa track`` writes and prints of emitters that nobody told apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imm_tdoa.cli import output
from imm_tdoa.cli.track_report import figures, last_finite

if TYPE_CHECKING:
    from imm_tdoa.cli.emitters import Found
    from imm_tdoa.following import Following
    from imm_tdoa.recording import Recording

LISTED = 20  # tracks in the printed table


def summarised(facts: Mapping[str, Any], data: Recording, found: Found) -> dict[str, Any]:
    """Return what summary.json holds."""
    tracks, beside = found.tracks, found.following
    rows = {name: _of_track(name, data, found) for name in tracks}
    emitters = {}
    if beside is not None:
        by = {who: [t for t, w in beside.main.items() if w == who] for who in beside.targets}
        each = zip(beside.targets, beside.latency, beside.kept, beside.id_switches, strict=True)
        for who, latency, kept, switches in each:
            emitters[who] = {
                "tracks": by[who],
                "latency_s": float(latency),
                "kept": float(kept),
                "id_switches": int(switches),
            }
    return {
        **facts,
        "overall": _overall(data, found, rows),
        "targets": rows,
        "emitters": emitters,
        "ignored": dict(tracks.ignored),
        "rejected": dict(tracks.rejected),
        "failed": {},
    }


def _of_track(name: str, data: Recording, found: Found) -> dict[str, Any]:
    track, life = found.tracks[name], found.tracks.lives[name]
    beside = found.following
    row: dict[str, Any] = {
        "scans": life.scans,
        **figures(data.dims, found.errors.get(name)),
        "log_likelihood": last_finite(track.log_likelihood),
        "lost_scans": int(np.count_nonzero(track.lost)),
        "seconds": found.seconds / len(found.tracks),
        "engine": track.engine,
        "born_s": life.born,
        "confirmed_s": life.confirmed,
        "heard_s": life.heard,
        "ended_s": life.ended,
        "reason": life.reason,
        "scans_heard": life.taken,
        "rows": life.rows,
    }
    if beside is not None:
        n = beside.tracks.index(name)
        row["emitter"] = beside.main.get(name)
        row["purity"] = float(beside.purity[n])
    if name in found.purity:
        row["row_purity"] = found.purity[name]
    return row


def _overall(
    data: Recording, found: Found, rows: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    from imm_tdoa.scoring import pooled

    tracks, every = found.tracks, found.rows.scans
    known = list(found.errors.values())
    result: dict[str, Any] = {
        "tracks": len(tracks),
        "living": len(tracks.living),
        "on_trial": tracks.on_trial,
        "scans": len(every),
        "rows": tracks.rows["given"],
        **{f"rows_{name}": tracks.rows[name] for name in ("taken", "ignored", "left")},
        **figures(data.dims, pooled(known) if known else None),
        "log_likelihood": sum(row["log_likelihood"] for row in rows.values()),
        "lost_scans": sum(row["lost_scans"] for row in rows.values()),
        "seconds": found.seconds,
        "engine": ", ".join(sorted({row["engine"] for row in rows.values()})),
    }
    if found.following is not None:
        result |= _of_sets(found.following)
    if found.purity:
        weight = [rows[name]["rows"] for name in found.purity]
        result["row_purity"] = float(np.average(list(found.purity.values()), weights=weight))
    return result


def _of_sets(beside: Following) -> dict[str, Any]:
    """Figures of all tracks together: means over the scans, counts over the run."""
    late, there = beside.latency, beside.present.any(axis=1)
    followed = there & np.isfinite(late)
    pure = beside.purity[np.isfinite(beside.purity)]
    return {
        "cutoff_m": beside.cutoff,
        "gospa_m": float(beside.gospa.distance.mean()),
        "gospa_localisation_m2": float(beside.gospa.localisation.mean()),
        "gospa_missed_m2": float(beside.gospa.missed.mean()),
        "gospa_false_m2": float(beside.gospa.false.mean()),
        "ospa_m": float(beside.ospa.mean()),
        "purity": float(pure.mean()) if len(pure) else None,
        "id_switches": int(beside.id_switches.sum()),
        "false_tracks": int(beside.false_tracks.sum()),
        "emitters": int(there.sum()),
        "emitters_never_followed": int(np.count_nonzero(there & ~followed)),
        "kept": float(np.nanmean(beside.kept[there])),
        "latency_median_s": float(np.median(late[followed])) if followed.any() else None,
        "latency_max_s": float(late[followed].max()) if followed.any() else None,
    }


def tell(data: Recording, found: Found, summary: Mapping[str, Any], home: Path) -> None:
    """Print a short table of the tracks, what they are worth, and where everything is."""
    out = output.console()
    heading = data.title or summary["recording"]
    modes = ", ".join(summary["modes"])
    output.heading(out, f"{heading}\nbank {summary['bank']}: {modes}\n")
    overall, rows = summary["overall"], summary["targets"]
    if rows:
        _table(out, rows, bool(found.errors), bool(found.purity))
    else:
        out.print("no track was confirmed")
    if len(rows) > LISTED:
        out.print(f"{len(rows) - LISTED} more tracks are in summary.json")
    out.print(
        f"\n{_count(overall['tracks'], 'track')}, {overall['living']} of them alive at the end; "
        f"of {_count(overall['rows'], 'row')} {overall['rows_taken']} taken, "
        f"{overall['rows_left']} nobody's, {overall['rows_ignored']} ignored; "
        f"{output.number(overall['seconds'], 2)} s",
        soft_wrap=True,
    )
    if found.following is not None:
        _tell_truth(out, overall)
    else:
        out.print("no truth to compare with")
    if found.purity:
        out.print(f"rows of a track from its main emitter: {overall['row_purity']:.1%}")
    ends: dict[str, int] = {}
    for row in rows.values():
        if row["reason"]:
            ends[row["reason"]] = ends.get(row["reason"], 0) + 1
    for word, counts in (
        ("ended", ends),
        ("given up before confirmation", summary["rejected"]),
        ("ignored", summary["ignored"]),
    ):
        if counts:
            reasons = "; ".join(f"{reason}: {n}" for reason, n in counts.items())
            out.print(output.escaped(f"{word}: {reasons}"), soft_wrap=True)
    output.written(out, home, summary["files"])


def _table(out: Any, rows: Mapping[str, Mapping[str, Any]], scored: bool, named: bool) -> None:
    columns = [
        *(("track", True), ("born [s]", True), ("confirmed [s]", True), ("last heard [s]", True)),
        *(("ended [s]", True), ("rows", True)),
    ]
    if scored:
        columns += [("emitter", False), ("RMSE [m]", True), ("mean NEES", True)]
    if named:
        columns.append(("row purity", True))
    table = output.table(columns)
    for name, row in list(rows.items())[:LISTED]:
        cells: list[Any] = [
            output.escaped(name),
            *(f"{row[key]:.6g}" for key in ("born_s", "confirmed_s", "heard_s")),
            "-" if row["ended_s"] is None else f"{row['ended_s']:.6g}",
            str(row["rows"]),
        ]
        if scored:
            cells += [
                output.escaped(row["emitter"] or "nobody"),
                output.number(row["position_rmse_m"]),
                output.number(row["mean_nees"]),
            ]
        if named:
            cells.append(output.number(row.get("row_purity")))
        table.add_row(*cells)
    out.print(table)


def _tell_truth(out: Any, overall: Mapping[str, Any]) -> None:
    number = output.number
    said = [
        f"against the truth: {_count(overall['emitters'], 'emitter')}, "
        f"{overall['emitters_never_followed']} never followed",
        _count(overall["false_tracks"], "false track"),
        _count(overall["id_switches"], "id switch", "es"),
    ]
    if overall["latency_max_s"] is not None:
        said += [
            f"purity {number(overall['purity'])}",
            f"confirmed after {number(overall['latency_median_s'], 2)} s (median), "
            f"{number(overall['latency_max_s'], 2)} s at most",
        ]
    out.print("; ".join(said), soft_wrap=True)
    out.print(
        f"GOSPA {number(overall['gospa_m'])} m, OSPA {number(overall['ospa_m'])} m "
        f"(means over the scans; cutoff {overall['cutoff_m']:g} m, order 2)",
        soft_wrap=True,
    )


def _count(number: int, word: str, plural: str = "s") -> str:
    return f"{number} {word}{'' if number == 1 else plural}"
