"""What ``imm-tdoa select`` prints."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imm_tdoa.cli import output

if TYPE_CHECKING:
    from imm_tdoa.selection import Comparison

FEW = 3  # targets whose models are printed one by one
LISTED = 12  # targets in the printed table
REASONS = 4  # reasons printed why targets were not compared


def tell(summary: Mapping[str, Any], results: Mapping[str, Comparison], home: Path) -> None:
    """Print what was decided, why, and where everything is."""
    out = output.console()
    first = next(iter(results.values()))
    prior = ", ".join(f"{key} {value:g}" for key, value in first.birth_std.items())
    robust = f", robust: {summary['robust']}" if summary["robust"] else ""
    output.heading(
        out,
        f"{summary['title'] or summary['recording']}\n"
        f"bank {summary['bank']}: {', '.join(summary['models'])}{robust}; judged by {first.span}\n",
    )
    if len(results) <= FEW:
        for name, found in results.items():
            _tell_one(out, name, found)
    else:
        _tell_many(out, summary)
    failed = summary["failed"]
    if failed:
        out.print(f"not judged: {len(failed)} of {len(failed) + len(results)} targets")
        for name, reason in list(failed.items())[:REASONS]:
            out.print(output.escaped(f"  {name}: {reason}"))
        if len(failed) > REASONS:
            out.print(f"  and {len(failed) - REASONS} more, in summary.json")
    out.print(
        "2 dL: twice the log-evidence behind the best; over 2 positive, 6 strong, 10 very strong.\n"
        f"It depends on what is believed beforehand; birth standard deviations: {prior}."
    )
    output.written(out, home, summary["files"])


def _tell_one(out: Any, target: str, found: Comparison) -> None:
    """The models of one target, and the verdict in words."""
    from imm_tdoa.selection.comparison import HEADS, WORDY

    output.heading(out, f"target {target}")
    shown = [i for i, head in enumerate(HEADS) if head != "against"]
    table = output.table([(HEADS[i], i not in WORDY) for i in shown])
    for row in found.table():
        cells = found.cells(row)
        table.add_row(*(cells[i] for i in shown), style="bold" if row["verdict"] else None)
    out.print(table)
    for name, why in zip(found.names, found.reason_aic.tolist(), strict=True):
        if why:
            out.print(output.escaped(f"no AIC and BIC of {name}: {why}"), soft_wrap=True)
    out.print(output.escaped(f"verdict: {found.verdict}. {found.reason}.\n"), soft_wrap=True)


def _tell_many(out: Any, summary: Mapping[str, Any]) -> None:
    """How often each verdict fell, and the first targets."""
    overall, targets = summary["overall"], summary["targets"]
    table = output.table([("verdict", False), ("targets", True)])
    for name, count in overall["verdicts"].items():
        table.add_row(output.escaped(name), str(count))
    table.add_row("all", str(overall["targets"]), style="bold")
    out.print(table)
    out.print()
    table = output.table(
        [
            *(("target", False), ("scans", True), ("verdict", False), ("best", False)),
            *(("margin", True), ("over", False), ("NIS p of the best", True)),
        ]
    )
    for name, row in list(targets.items())[:LISTED]:
        table.add_row(
            output.escaped(name),
            str(row["scans"]),
            output.escaped(row["verdict"]),
            output.escaped(row["best"]),
            output.number(row["margin"]),
            output.escaped(row["runner_up"]),
            output.number(row["models"][row["best"]]["nis_p"], 2),
        )
    out.print(table)
    if len(targets) > LISTED:
        out.print(f"{len(targets) - LISTED} more targets are in summary.json")
    out.print()
