"""Pictures draw the figures of the Dataset."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Rectangle
from results_cases import SCANS, Shelf, bank, chunk, grid, study, sweep, tuned

from imm_tdoa.study import results
from imm_tdoa.study.report import draw_map, draw_rank, draw_time, lessons, paper, pictures

PLAIN = paper.finish


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures behind the pictures, in the order they are drawn."""
    figures: list[Figure] = []

    def keep(figure: Figure, *arguments: Any) -> paper.Picture:
        figures.append(figure)
        return PLAIN(figure, *arguments)

    monkeypatch.setattr(paper, "finish", keep)
    return figures


@pytest.fixture(scope="module")
def swept() -> xr.Dataset:
    return results.collect(*sweep(runs=60))


@pytest.fixture(scope="module")
def gridded() -> xr.Dataset:
    return results.collect(*grid(runs=60))


def lines(ax: Any) -> list[Any]:
    return [line for line in ax.get_lines() if len(line.get_xdata()) > 2]


def test_errors_over_time(swept: xr.Dataset, drawn: list[Figure]) -> None:
    picture = draw_time.errors(swept, 1)
    assert picture is not None
    top, below = drawn[0].axes
    data = [np.asarray(line.get_ydata()) for line in lines(top)]
    np.testing.assert_allclose(data[:3], swept["position_rmse_by_time"][1])
    np.testing.assert_allclose(data[3], np.sqrt(150.0))
    np.testing.assert_allclose(
        [line.get_ydata() for line in lines(below)], swept["nees_ratio_by_time"][1]
    )
    band = top.collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx(float(swept["position_rmse_by_time_high"][1, 0].max()))
    names = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert names == ["cv", "ca", "imm", "Cramér-Rao bound", "consistent"]


def test_ribbons_reach_one(swept: xr.Dataset, drawn: list[Figure]) -> None:
    picture = draw_time.ribbons(swept, 0)
    assert picture is not None
    (ax,) = drawn[0].axes
    first, second = (c.get_paths()[0].vertices for c in ax.collections)
    assert second[:, 1].max() == pytest.approx(1.0)
    np.testing.assert_allclose(
        np.unique(first[:, 1])[1:], np.unique(swept["mode_probability"][0, 2, :, 0])
    )
    assert "imm mostly" in picture.alt


def test_no_ribbons_of_single_models(gridded: xr.Dataset) -> None:
    assert draw_time.ribbons(gridded, 0) is None


def test_the_ranking_has_the_best_on_top(swept: xr.Dataset, drawn: list[Figure]) -> None:
    picture = draw_rank.ranking(swept, 3)
    assert picture is not None
    ax = drawn[0].axes[0]
    best_first = [["cv", "ca", "imm"][b] for b in lessons.order(swept, 3)]
    assert [t.get_text() for t in ax.get_yticklabels()] == best_first
    assert best_first[-1] == "cv"
    dots = [float(np.asarray(line.get_xdata())[0]) for line in ax.get_lines()[::3]]
    np.testing.assert_allclose(dots, np.sort(swept["position_rmse"].values[3]), rtol=1e-12)
    assert ax.get_ylim()[0] > ax.get_ylim()[1]


def test_lines_over_one_parameter(swept: xr.Dataset, drawn: list[Figure]) -> None:
    picture = draw_map.lines(swept, "turn", [0, 1, 2, 3], 0)
    assert picture is not None
    found = lines(drawn[0].axes[0])
    np.testing.assert_allclose(
        [line.get_ydata() for line in found], swept["position_rmse"].values.T
    )
    np.testing.assert_allclose(found[0].get_xdata(), [0.0, 1.0, 2.0, 4.0])
    assert "0: cv; 1: cv" in picture.alt


def test_the_criteria_map_tells_shares_and_standard_errors(
    swept: xr.Dataset, drawn: list[Figure]
) -> None:
    draw_rank.criteria(swept, "turn", [0, 1, 2, 3], 0)
    ax = drawn[0].axes[0]
    shown = np.asarray(ax.images[0].get_array())
    np.testing.assert_allclose(shown, 100.0 * swept["chosen"].values[:, :, 1].T)
    first = ax.texts[0].get_text()
    assert first.startswith(f"{shown[0, 0]:.0f}\n±")


def test_the_map_of_winners_has_their_colours(gridded: xr.Dataset, drawn: list[Figure]) -> None:
    picture = draw_map.winners(gridded, "grid", range(12), [0, 1])
    ax = drawn[0].axes[0]
    parts = [p for p in ax.patches if isinstance(p, Rectangle)]
    for i in range(12):
        noise, interval = gridded["scenario_value"].values[i]
        at = ([1.0, 2.0, 4.0, 8.0].index(interval), [0.5, 1.0, 2.0].index(noise))
        there = [
            to_hex(p.get_facecolor()).upper()
            for p in parts
            if abs(p.get_x() + p.get_width() / 2 - at[0]) < 0.5
            and abs(p.get_y() + 0.46 - at[1]) < 0.1
        ]
        assert there == [paper.colour(b) for b in lessons.undefeated(gridded, i)]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["0.5", "1", "2"]
    assert ax.get_xlabel() == "interval [s]"
    assert picture.alt.count(";") == 11


def test_more_parameters_make_more_maps(drawn: list[Figure]) -> None:
    points = {
        f"x {n} {s:g} {t:g}": {"layout": n, "noise_factor": s, "interval_s": t}
        for n in ("ring", "line")
        for s in (1.0, 2.0)
        for t in (1.0, 2.0)
    }
    given, shelf = study(points, [bank("a"), bank("b")], runs=20, base="x"), Shelf()
    for case in given.scenarios:
        shelf.add(case.name, 0, chunk(np.random.default_rng(1), 20, [1.0, 2.0]))
    data = results.collect(given, shelf)
    (picture,) = pictures.whole(data)
    assert picture.name == "winners-x"
    titles = [ax.get_title("left") for ax in drawn[0].axes]
    assert titles == ["layout ring", "layout line"]


@pytest.mark.parametrize("two", [True, False])
def test_what_tuning_costs(drawn: list[Figure], two: bool) -> None:
    data = results.collect(*tuned(runs=60, two=two))
    (picture,) = pictures.whole(data)
    over = np.exp(np.log(lessons.regret(data)).mean(axis=0))
    ax = drawn[0].axes[0]
    if two:
        np.testing.assert_allclose(np.asarray(ax.images[0].get_array()), over.reshape(3, 3))
    else:
        found = np.array([line.get_ydata() for line in lines(ax)])
        np.testing.assert_allclose(np.exp(np.log(found).mean(axis=0)), over)
    assert picture.name == "tuning"


def test_every_picture_is_one(swept: xr.Dataset) -> None:
    every = [*pictures.whole(swept), *pictures.of_scenario(swept, 2)]
    names = [picture.name for picture in every]
    assert names == ["sweep-turn", "criteria-turn", "ranking-003", "errors-003", "modes-003"]
    for picture in every:
        pixels = imread(io.BytesIO(picture.png), format="png")
        assert (pixels.shape[1], pixels.shape[0]) == picture.size
        assert np.std(pixels) > 0.05
        assert len(picture.alt) > 30
        assert picture.caption.endswith(".")
        assert (picture.scenario is None) == (picture.name[-3:] != "003")


def test_many_banks_leave_room(drawn: list[Figure]) -> None:
    given = study({"one": {}}, [bank(f"bank {b}") for b in range(12)], runs=15)
    shelf = Shelf()
    shelf.add("one", 0, chunk(np.random.default_rng(1), 15, [1.0 + b for b in range(12)]))
    data = results.collect(given, shelf)
    picture = draw_time.errors(data, 0)
    assert picture is not None
    assert "4 between are left out" in picture.caption
    assert len(lines(drawn[0].axes[0])) == paper.MOST
    assert len(lines(drawn[0].axes[0])[0].get_xdata()) == SCANS


def test_nothing_to_draw() -> None:
    given = study({"one": {}}, [bank("a")], runs=4)
    part = chunk(np.random.default_rng(1), 4, [1.0])
    for name, values in part.items():
        if values.dtype == float and values.shape == (1, 4):
            part[name] = np.full((1, 4), np.nan)
        if name.startswith("count_"):
            part[name] = np.zeros((1, SCANS))
    part["failed"][:] = True
    shelf = Shelf()
    shelf.add("one", 0, part)
    data = results.collect(given, shelf)
    assert list(pictures.of_scenario(data, 0)) == []
    assert list(pictures.whole(data)) == []
