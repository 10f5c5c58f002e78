"""What ``imm-tdoa track`` writes and prints of labelled targets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imm_tdoa.cli import output

if TYPE_CHECKING:
    from imm_tdoa.cli.track import Result
    from imm_tdoa.recording import Recording
    from imm_tdoa.scoring import Errors

LISTED = 12  # targets in the printed table
REASONS = 4  # reasons printed why targets were not tracked


def figures(dims: int, errors: Errors | None) -> dict[str, float | None]:
    """Return figures of merit by name, null where there is no truth."""
    names = ["position_rmse_m", "horizontal_rmse_m", "position_median_m", "horizontal_median_m"]
    names += ["velocity_rmse_mps", "mean_nees"]
    found = {} if errors is None else errors.summary()
    return {n: found.get(n) for n in names if dims == 3 or not n.startswith("horizontal")}


def summarised(
    facts: Mapping[str, Any],
    data: Recording,
    results: Mapping[str, Result],
    failed: Mapping[str, str],
) -> dict[str, Any]:
    """Return what summary.json holds."""
    from imm_tdoa.scoring import pooled

    targets: dict[str, dict[str, Any]] = {
        name: {
            "scans": len(result.track.times),
            **figures(data.dims, result.errors),
            "log_likelihood": last_finite(result.track.log_likelihood),
            "rows_left_out": int(np.count_nonzero(result.track.row_weight < 0.5)),
            "lost_scans": int(np.count_nonzero(result.track.lost)),
            "seconds": result.seconds,
            "engine": result.track.engine,
        }
        for name, result in results.items()
    }
    known = [result.errors for result in results.values() if result.errors is not None]
    engines = sorted({result.track.engine for result in results.values()})
    overall = {
        "targets": len(results),
        "scans": sum(row["scans"] for row in targets.values()),
        **figures(data.dims, pooled(known) if known else None),
        "log_likelihood": sum(row["log_likelihood"] for row in targets.values()),
        "rows_left_out": sum(row["rows_left_out"] for row in targets.values()),
        "lost_scans": sum(row["lost_scans"] for row in targets.values()),
        "seconds": sum(row["seconds"] for row in targets.values()),
        "engine": ", ".join(engines),
    }
    return {**facts, "overall": overall, "targets": targets, "failed": dict(failed)}


def last_finite(values: Any) -> float:
    """Return the last value that is known; 0 if none is."""
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else 0.0


def tell(data: Recording, summary: Mapping[str, Any], home: Path) -> None:
    """Print a short table and where everything is."""
    out = output.console()
    heads = {
        "position_rmse_m": "RMSE [m]",
        "position_median_m": "median [m]",
        "horizontal_rmse_m": "horizontal RMSE [m]",
        "velocity_rmse_mps": "velocity RMSE [m/s]",
        "mean_nees": f"mean NEES (ideal {len(data.truth_scoring.axes or 'xyz'[: data.dims])})",
    }
    overall, targets = summary["overall"], summary["targets"]
    shown = [key for key in heads if overall.get(key) is not None]
    columns = [("target", False), ("scans", True), *((heads[k], True) for k in shown)]
    output.heading(
        out,
        f"{data.title or summary['recording']}\n"
        f"bank {summary['bank']}: {', '.join(summary['modes'])}\n",
    )
    table = output.table([*columns, ("log-likelihood", True), ("time [s]", True)])
    rows = [*list(targets.items())[:LISTED], *([("all", overall)] if len(targets) > 1 else [])]
    for name, row in rows:
        table.add_row(
            output.escaped(name),
            str(row["scans"]),
            *(output.number(row[k]) for k in shown),
            f"{row['log_likelihood']:.1f}",
            output.number(row["seconds"], 2),
            style="bold" if row is overall else None,
        )
    out.print(table)
    if len(targets) > LISTED:
        out.print(f"{len(targets) - LISTED} more targets are in summary.json")
    if not shown:
        out.print("no truth to compare with")
    if overall["rows_left_out"]:
        out.print(f"rows left out or trusted less than half: {overall['rows_left_out']}")
    if overall["lost_scans"]:
        out.print(f"scans while lost, nothing having fitted for too long: {overall['lost_scans']}")
    failed = summary["failed"]
    if failed:
        out.print(f"\nnot tracked: {len(failed)} of {len(failed) + len(targets)} targets")
        for name, reason in list(failed.items())[:REASONS]:
            out.print(output.escaped(f"  {name}: {reason}"))
        if len(failed) > REASONS:
            out.print(f"  and {len(failed) - REASONS} more, in summary.json")
    output.written(out, home, summary["files"])
