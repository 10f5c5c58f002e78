"""Pictures in the manner of Source A's Figs. 2 to 4: where the targets were, and the errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox

from imm_tdoa.contract import Array
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Unit
from imm_tdoa.plot.maps import Box, name_points, settle
from imm_tdoa.plot.receivers import Receivers
from imm_tdoa.reproduce.motion_form import scenario
from imm_tdoa.reproduce.motion_form.table_one import Row, Table

COLOURS = ("#0072B2", "#CC79A7", "#009E73")
TITLES = {
    "scenario-1": "Scenario 1: constant velocity, taken for constant velocity",
    "scenario-2": "Scenario 2: constant acceleration, taken for constant velocity",
    "scenario-3": "Scenario 3: constant acceleration, taken for constant acceleration",
}


def of_scenario(table: Table, name: str, path: str | Path | None = None) -> Figure:
    """Draw one scenario: paths and estimates of three targets (a), and errors over time (b).

    Parameters
    ----------
    table : Table
        Table 1.
    name : str
        ``"scenario-1"`` to ``"scenario-3"``.
    path : str or Path, optional
        File to write; its ending says which format.
    """
    row = table.row(name)
    assert row.sample is not None
    assert row.estimate is not None
    figure = canvas.figure(12.0, 7.6)
    figure.suptitle(_heading(row, table.runs), x=0.01, ha="left", fontsize=12, color=canvas.INK)
    grid = figure.add_gridspec(2, 4, height_ratios=[1.25, 1.0], width_ratios=[1, 1, 1, 0.95])
    truth, unit = row.motion.truth()[..., :2], Unit(1e6)
    boxes = _same_size([Box.of(np.concatenate(p)) for p in zip(truth, row.estimate, strict=True)])
    maps = []
    for i, (box, colour) in enumerate(zip(boxes, COLOURS, strict=True)):
        ax = figure.add_subplot(grid[0, i])
        ax.plot(*unit(truth[i].T), color=canvas.TRUTH, linewidth=4.0, alpha=0.75)
        ax.plot(*unit(row.estimate[i].T), "--o", color=colour, linewidth=1.1, markersize=3.5)
        canvas.dress(ax, "x [km]", "y [km]" if i == 0 else "", f"a) target {i + 1}", size=10)
        maps.append((ax, box, unit))
    whole = figure.add_subplot(grid[0, 3])
    receivers = Receivers.during(scenario.stations(), row.motion.times)
    receivers.draw(whole, unit, size=6.0)
    for path_, colour in zip(truth, COLOURS, strict=True):
        whole.plot(*unit(path_.T), color=colour, linewidth=2.5)
    canvas.dress(whole, "x [km]", "", "targets and stations", size=10)
    maps.append((whole, Box.of(np.concatenate([*truth, receivers.places])), unit))
    _errors(figure.add_subplot(grid[1, :3]), row)
    canvas.legend(figure.add_subplot(grid[1, 3]), _handles(row, table.runs))
    settle(figure, maps)
    clear: Array = unit(np.concatenate([*truth, receivers.places]))
    taken: list[Bbox] = []
    names = [*("123"), "master"]
    points = [*(path_[-1] for path_ in truth), receivers.places[0]]
    for text, point, colour in zip(names, points, (*COLOURS, canvas.STATION), strict=True):
        place = unit(point[None])
        taken = name_points(
            figure, whole, place, [text], colour=colour, keep_clear=clear, taken=taken
        )
    return canvas.finish(figure, path)


def _heading(row: Row, runs: int) -> str:
    assert row.sample is not None
    paper = "" if row.paper_km is None else f", the paper's {row.paper_km:.3f} km"
    return (
        f"{TITLES[row.name]}\nmean error {row.sample.mean_km:.3f} ± "
        f"{row.sample.standard_error_km:.3f} km in {runs} runs{paper}; geometry and noise are "
        f"our reconstruction"
    )


def _same_size(boxes: list[Box]) -> list[Box]:
    """Return the boxes grown to a common size, so that one map compares with the next."""
    half = 0.5 * np.max([box.high - box.low for box in boxes], axis=0)
    middles = [0.5 * (box.low + box.high) for box in boxes]
    return [Box(middle - half, middle + half) for middle in middles]


def _errors(ax: Axes, row: Row) -> None:
    assert row.sample is not None
    times = row.motion.times[1:]
    for i, colour in enumerate(COLOURS):
        errors = row.sample.errors_km[:, i]
        ax.plot(times, errors[0], "o", color=colour, markersize=3.0, alpha=0.55)
        ax.plot(times, errors.mean(axis=0), color=colour, linewidth=2.0)
        if row.predicted_km is not None:
            ax.plot(times, row.predicted_km[i], ":", color=canvas.INK, linewidth=1.3)
    ax.set_xlim(0.0, float(times[-1]) + 0.5)
    ax.set_ylim(0.0, _top(row))
    canvas.dress(ax, "time [s]", "position error [km]", "b) error over time", size=10)


def _top(row: Row) -> float:
    """Upper end of the error axis: all means, and all but a few of the first run's points."""
    assert row.sample is not None
    means = row.sample.errors_km.mean(axis=0)
    return 1.1 * float(max(means.max(), np.quantile(row.sample.errors_km[0], 0.98)))


def _handles(row: Row, runs: int) -> list[Line2D]:
    def line(label: str, width: float, colour: str = canvas.INK) -> Line2D:
        return Line2D([], [], linewidth=width, color=colour, label=label)

    handles = [line(f"target {i + 1}", 2.5, colour) for i, colour in enumerate(COLOURS)]
    handles.append(line("true path", 4.0, canvas.TRUTH))
    estimate = line("estimate, first run", 1.1)
    estimate.set(linestyle="--", marker="o", markersize=3.5)
    one = line("error of the first run", 0.0)
    one.set(linestyle="", marker="o", markersize=3.0)
    handles += [estimate, line(f"mean error of {runs} runs", 2.0), one]
    if row.predicted_km is not None:
        theory = line("mean error by theory,\nno random numbers", 1.3)
        theory.set(linestyle=":")
        handles.append(theory)
    return handles
