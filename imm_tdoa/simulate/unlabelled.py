"""Rows of which nobody knows whose they are: some fall together, and their order says nothing."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Index
from imm_tdoa.simulate.clutter import NOBODY
from imm_tdoa.simulate.rows import ARRIVAL_DIGITS, Columns
from imm_tdoa.simulate.scenario import Scenario

AND = "\x1f"  # between the targets of a merged row; no name has it


def merged(scenario: Scenario, rows: Columns) -> Columns:
    """Make one row of emitters' rows of one station or pair and scan that are not resolved.

    Rows whose moments follow each other by less than ``sampling.resolution_s`` become the first
    of them, with the mean moment of all; a difference has their mean range rate too.
    """
    resolution = scenario.sampling.resolution_s
    if resolution is None:
        return rows
    ends = _ends(scenario, rows)
    key = np.stack([rows["scan"], *ends, np.where(rows["target"] == NOBODY, 1, 0)])
    order = np.lexsort((rows["moment"], *key[::-1]))
    key, moment = key[:, order], rows["moment"][order]
    with np.errstate(invalid="ignore"):
        near = np.diff(moment) < resolution  # false alarms have no moment
    begins = np.append(True, ~(np.all(np.diff(key) == 0, axis=0) & near))[: len(order)]
    cluster = np.cumsum(begins) - 1
    first, size = order[begins], np.bincount(cluster)
    shift = np.bincount(cluster, weights=moment) / size - moment[begins]
    columns = {name: column[first] for name, column in rows.items()}
    columns["value"] = np.where(size > 1, columns["value"] + shift, columns["value"])
    if "reference" in rows:
        mean = np.bincount(cluster, weights=rows["rate"][order]) / size
        columns["rate"] = np.where(size > 1, mean, columns["rate"])
    who = columns["target"].astype(object)
    starts = np.flatnonzero(begins)
    for k in np.flatnonzero(size > 1).tolist():
        whole = order[starts[k] : starts[k] + size[k]]
        who[k] = AND.join(sorted(rows["target"][whole].tolist()))
    columns["target"] = who.astype(str)
    return columns


def shuffled(scenario: Scenario, rows: Columns) -> tuple[Columns, dict[str, str]]:
    """Put rows in an order, and give emissions numbers, that follow from what was measured alone.

    By time, station, reference and value; rows of one emission stay together, in the order of
    the emissions' first rows.

    Returns
    -------
    columns
        The rows in their new order.
    emissions : dict
        The number of each emission by its name before; empty where rows are differences.
    """
    ends = _ends(scenario, rows)
    by = (np.round(rows["value"], ARRIVAL_DIGITS), *ends[::-1], rows["time_s"])
    order = np.lexsort(by)
    columns = {name: column[order] for name, column in rows.items()}
    if "emission" not in rows:
        return columns, {}
    names = dict.fromkeys(columns["emission"].tolist())
    number = {name: i + 1 for i, name in enumerate(names)}
    emission = np.array([number[name] for name in columns["emission"].tolist()], dtype=np.int64)
    together = np.argsort(emission, kind="stable")
    columns["emission"] = emission.astype(str)
    columns = {name: column[together] for name, column in columns.items()}
    return columns, {name: str(i) for name, i in number.items()}


def renamed(heights: Columns, emissions: dict[str, str]) -> Columns:
    """Put heights in order of time and height, and give emissions numbers that say nothing.

    Where rows have emissions the numbers are theirs, and heights of emissions that lost all of
    their rows to others are left out.
    """
    order = np.lexsort((heights["height_m"], heights["time_s"]))
    columns = {name: column[order] for name, column in heights.items()}
    before = columns["emission"].tolist()
    numbers = emissions or {name: str(i + 1) for i, name in enumerate(before)}
    keep = np.array([name in numbers for name in before], dtype=bool)
    columns = {name: column[keep] for name, column in columns.items()}
    columns["emission"] = np.array([numbers[name] for name in before if name in numbers], dtype=str)
    return columns


def _ends(scenario: Scenario, rows: Columns) -> list[Index]:
    """Return the numbers (N,) of the rows' stations, and of their references."""
    number = {name: i for i, name in enumerate(scenario.station_names)}
    return [
        np.array([number[name] for name in rows[key].tolist()], dtype=np.int64)
        for key in ("station", "reference")
        if key in rows
    ]
