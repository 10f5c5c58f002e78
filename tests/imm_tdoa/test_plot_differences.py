"""The picture of time differences over time, and scenes of unlabelled recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from matplotlib.figure import Figure

from imm_tdoa import plot
from imm_tdoa.recording import Recording, Table
from imm_tdoa.simulate import Swarm, load, simulate
from imm_tdoa.simulate.detection import Detection


def panels(figure: Figure) -> list[Any]:
    return [ax for ax in figure.axes if ax.axison]


def legend(figure: Figure) -> list[str]:
    texts = []
    for ax in figure.axes:
        box = ax.get_legend()
        texts += [] if box is None else [t.get_text() for t in box.get_texts()]
    return texts


@pytest.fixture(scope="module")
def three() -> Recording:
    return simulate(load("three-emitters"), seed=1)


def test_every_row_is_a_point_and_every_truth_a_line(three: Recording, tmp_path: Path) -> None:
    figure = plot.differences(three, path=tmp_path / "differences.svg")
    assert (tmp_path / "differences.svg").stat().st_size > 10_000
    assert three.tdoa is not None
    assert [ax.get_title("left") for ax in panels(figure)] == [
        f"slave-{i} - master" for i in (1, 2, 3)
    ]
    truth, speed = three.truth, three.speed_mps
    assert truth is not None
    for i, ax in enumerate(panels(figure), start=1):
        rows = three.tdoa["station"] == f"slave-{i}"
        expected = np.stack([three.tdoa["time_s"][rows], 1e6 * three.tdoa["tdoa_s"][rows]], axis=-1)
        np.testing.assert_allclose(ax.collections[0].get_offsets(), expected)
        lines = [line for line in ax.lines if len(line.get_xdata()) > 1]
        assert len(lines) == 3
        for name, line in zip("123", lines, strict=True):
            mine = truth["target"] == name
            place = np.stack([truth["x_m"][mine], truth["y_m"][mine]], axis=-1)
            master, slave = three.stations.positions[[0, i]]
            d = np.linalg.norm(place - slave, axis=-1) - np.linalg.norm(place - master, axis=-1)
            np.testing.assert_allclose(line.get_ydata(), 1e6 * d / speed, atol=1e-6)
    words = legend(figure)
    assert words[0] == f"measured ({len(three.tdoa)})"
    assert {"truth of 1", "truth of 2", "truth of 3", "start", "end"} <= set(words)


def test_arrivals_are_shown_as_differences_of_their_emission() -> None:
    ships = simulate(load("two-ships"), seed=1)
    assert ships.toa is not None
    figure = plot.differences(ships)
    (reference,) = {ax.get_title("left").split(" - ")[1] for ax in panels(figure)}
    names, count = np.unique(ships.toa["station"], return_counts=True)
    assert count[names == reference] == count.max()
    shown = sum(len(ax.collections[0].get_offsets()) for ax in panels(figure))
    heard = set(ships.toa["emission"][ships.toa["station"] == reference].tolist())
    with_it = np.isin(ships.toa["emission"], list(heard)) & (ships.toa["station"] != reference)
    assert shown == np.count_nonzero(with_it)
    for ax in panels(figure):  # the points lie on the lines
        lines = [line for line in ax.lines if len(line.get_xdata()) > 1]
        for t, d in np.asarray(ax.collections[0].get_offsets()):
            near = [np.interp(t, line.get_xdata(), line.get_ydata()) for line in lines]
            assert np.min(np.abs(np.array(near) - d)) < 0.5


def test_births_and_deaths_are_in_the_legend() -> None:
    made = load("three-emitters")
    late = attrs.evolve(made.targets[1], start_s=60.0)
    recording = simulate(attrs.evolve(made, targets=[made.targets[0], late]), seed=2)
    for figure in (plot.differences(recording), plot.scene(recording)):
        assert {"truth of 1\n0 to 118 s", "truth of 2\n60 to 178 s"} <= set(legend(figure))


def test_many_targets_and_pairs_have_one_line_in_the_legend() -> None:
    made = load("busy-sky")
    few = [attrs.evolve(made.swarms[0], count=20)]
    made = attrs.evolve(made, swarms=few, detection=Detection())
    recording = simulate(made, seed=3)
    figure = plot.differences(recording)
    assert len(panels(figure)) == 6
    assert {"truth of 20 targets", "1 more pair"} <= set(legend(figure))
    scene = plot.scene(recording)
    named = {t.get_text() for ax in scene.axes for t in ax.texts}
    assert len(named & {f"e-{i + 1}" for i in range(20)}) > 15


def test_rows_beyond_what_a_pair_can_measure_are_counted(three: Recording) -> None:
    assert three.tdoa is not None
    columns = {name: three.tdoa[name].copy() for name in three.tdoa}
    columns["tdoa_s"][3] = 1.0
    figure = plot.differences(attrs.evolve(three, tdoa=Table(columns)))
    assert "1 row is larger than their\npair can measure" in legend(figure)
    assert all(np.max(np.abs(ax.get_ylim())) < 1e3 for ax in panels(figure))


def test_without_truth_there_are_points_alone(three: Recording) -> None:
    bare = attrs.evolve(three, truth=None)
    figure = plot.differences(bare)
    assert all(not ax.lines for ax in panels(figure))
    assert len(legend(figure)) == 1


def test_nothing_to_draw_is_refused() -> None:
    made = load("two-ships")
    recording = simulate(made, seed=1)
    assert recording.toa is not None
    one = {name: recording.toa[name][:1] for name in recording.toa}
    assert plot.has_differences(recording)
    assert not plot.has_differences(attrs.evolve(recording, toa=Table(one)))
    with pytest.raises(ValueError, match="recording: no time differences to draw"):
        plot.differences(attrs.evolve(recording, toa=Table(one)))


def test_a_scene_shows_the_truth_of_unlabelled_targets(three: Recording) -> None:
    figure = plot.scene(three)
    assert {"truth of 1", "truth of 2", "truth of 3"} <= set(legend(figure))
    assert {"1", "2", "3"} <= {t.get_text() for ax in figure.axes for t in ax.texts}


def test_a_scene_counts_as_far_away_only_what_it_does_not_show() -> None:
    figure = plot.scene(simulate(load("crossing")))
    (note,) = [t for t in legend(figure) if "not shown" in t]
    assert note.startswith("5 stations")
    assert "stations" in legend(figure)


def test_a_swarm_can_be_drawn_in_three_dimensions() -> None:
    made = load("many-aircraft")
    swarm = made.swarms[0]
    assert isinstance(swarm, Swarm)
    recording = simulate(attrs.evolve(made, swarms=[attrs.evolve(swarm, count=3)]))
    for ax in panels(plot.differences(recording)):
        offsets = np.asarray(ax.collections[0].get_offsets())
        lines = [line for line in ax.lines if len(line.get_xdata()) > 1]
        for t, d in offsets:
            near = [np.interp(t, line.get_xdata(), line.get_ydata()) for line in lines]
            assert np.min(np.abs(np.array(near) - d)) < 1.0
