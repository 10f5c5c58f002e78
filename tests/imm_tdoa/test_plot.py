"""Pictures: what is on them, that nothing covers anything, that they reach their files."""

from __future__ import annotations

import subprocess
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Ellipse

from imm_tdoa import IMM, Bank, Stations, Track, bounds, plot
from imm_tdoa.locate import gauss_newton
from imm_tdoa.plot import canvas
from imm_tdoa.plot.canvas import Clock, Unit
from imm_tdoa.plot.maps import Box, name_points, settle
from imm_tdoa.recording import Recording
from imm_tdoa.registry import load
from imm_tdoa.simulate import load as scenario
from imm_tdoa.simulate import simulate

T = np.arange(40.0)
PATH = np.stack([20.0 * T, 100.0 + 5.0 * T], axis=-1)
STATIONS = Stations(
    np.array([[-200.0, 0.0], [900.0, -100.0], [400.0, 700.0]]), names=("west", "east", "north")
)


def make_track(dims: int = 2, modes: int = 3, offset: float = 0.0) -> Track:
    models = [
        load("static")(psd=0.0),
        load("constant-velocity")(psd=1.0),
        load("constant-acceleration")(psd=0.1),
    ][3 - modes :]
    points = PATH + offset
    if dims == 3:
        points = np.concatenate([points, 300.0 + T[:, None]], axis=1)
    rng = np.random.default_rng(1)
    noisy = points + rng.normal(0.0, 5.0, points.shape)
    return IMM(Bank(models), load("position")(sigma=5.0, dims=dims)).run(T, noisy)


@pytest.fixture(scope="module")
def track() -> Track:
    return make_track()


@pytest.fixture(scope="module")
def ships() -> Recording:
    return simulate(scenario("two-ships"), seed=1)


def texts(figure: Figure) -> str:
    """All that the legends of a figure say."""
    legends = [ax.get_legend() for ax in figure.axes]
    return "\n".join(t.get_text() for box in legends if box is not None for t in box.get_texts())


def labelled(figure: Figure, ylabel: str) -> Axes:
    """The axes of which the y label starts so."""
    return next(ax for ax in figure.axes if ax.get_ylabel().startswith(ylabel))


def line(ax: Axes, label: str) -> Any:
    return next(x for x in ax.get_lines() if str(x.get_label()).startswith(label))


def points(drawn: Any) -> int:
    """Number of points of a line."""
    return len(drawn.get_xdata())


def test_track_shows_truth_stations_modes(track: Track, tmp_path: Path) -> None:
    file = tmp_path / "new folder" / "track.png"
    figure = plot.track(track, truth=(T, PATH), stations=STATIONS, title="Trial", path=file)
    area = labelled(figure, "y [")
    assert area.get_xlabel() == "x [m]"
    assert area.get_title(loc="left") == "Trial"
    assert area.get_aspect() == 1.0
    np.testing.assert_allclose(line(area, "truth").get_xydata(), PATH)
    np.testing.assert_allclose(line(area, "track").get_xydata(), track.position)
    np.testing.assert_allclose(line(area, "stations").get_xydata(), STATIONS.positions)
    written = {t.get_text() for t in area.texts}
    assert {"west", "east", "north"} <= written
    assert any(t.endswith(" s") for t in written)
    for word in ("truth", "track", "95 % uncertainty", "start, 0 s", "end, 39 s", *track.modes):
        assert word in texts(figure)
    ribbon = labelled(figure, "mode probability")
    assert len(ribbon.collections) == 3
    assert ribbon.get_xlabel() == "time [s]"
    assert ribbon.get_ylim() == (0.0, 1.0)
    picture = imread(file)
    assert picture.shape[0] > 800
    assert picture.shape[1] > 1200
    assert np.std(picture[..., :3]) > 0.05
    assert [f.name for f in file.parent.iterdir()] == ["track.png"]


def test_ellipses_hold_95_percent(track: Track) -> None:
    """Axes and turn of an ellipse: its points have a Mahalanobis distance of 5.991."""
    area = labelled(plot.track(track), "y [")
    found = [p for p in area.patches if isinstance(p, Ellipse)]
    assert len(found) > 5
    for ellipse in found[:3]:
        row = int(np.argmin(np.linalg.norm(track.position - ellipse.get_center(), axis=1)))
        turn = np.linspace(0.0, 6.0, 20)
        circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        edge = ellipse.get_patch_transform().transform(circle) - track.position[row]
        P = track.position_covariance[row]
        d2 = np.einsum("ni,ij,nj->n", edge, np.linalg.inv(P), edge)
        np.testing.assert_allclose(d2, 5.991, rtol=0.01)


def test_one_mode_needs_no_ribbon_and_height_has_its_panel(track: Track) -> None:
    figure = plot.track(make_track(modes=1))
    assert not [ax for ax in figure.axes if ax.get_ylabel() == "mode probability"]
    tall = make_track(dims=3)
    panel = labelled(plot.track(tall), "z [m]")
    np.testing.assert_allclose(line(panel, "track").get_ydata(), tall.position[:, 2])
    assert len(panel.collections) == 1


def test_height_above_the_ellipsoid() -> None:
    data = simulate(scenario("drone-3d"), seed=1)
    assert data.frame is not None
    times = np.asarray(data.truth["time_s"])[:40] if data.truth is not None else T
    place, _ = data.truth_at(None, times)
    imm = IMM(Bank([load("constant-velocity")(psd=1.0)]), load("position")(sigma=1.0, dims=3))
    figure = plot.track(imm.run(times, place), data)
    panel = labelled(figure, "height above\nWGS84 ellipsoid")
    np.testing.assert_allclose(
        line(panel, "truth").get_ydata(), data.frame.height(place)[0], atol=1e-6
    )


def test_far_stations_do_not_squash_the_map(track: Track) -> None:
    away = Stations(STATIONS.positions + np.array([2e7, 0.0]), names=STATIONS.names)
    figure = plot.track(track, stations=away)
    low, high = labelled(figure, "y [").get_xlim()
    assert high - low < 3000.0
    assert "3 stations not shown: 20\u202f000 km away" in " ".join(texts(figure).split("\n"))
    near = Stations(20.0 * STATIONS.positions, names=STATIONS.names)
    figure = plot.track(track, stations=near)
    small = next(ax for ax in figure.axes if ax.get_title(loc="left") == "all stations")
    assert {t.get_text() for t in small.texts} == set(STATIONS.names)
    assert small.get_xlim()[0] < -4.0
    assert small.get_xlabel() == "x [km]"


def test_gross_errors_do_not_squash_the_map(track: Track) -> None:
    """Without truth too: what lies far off most of the track is left out, and said."""
    means = tuple(mean.copy() for mean in track.mode_means)
    for mean in means:
        mean[0, :2] = 1e7
    wild = attrs.evolve(track, mode_means=means)
    for truth in (None, (T, PATH)):
        figure = plot.track(wild, truth=truth)
        low, high = labelled(figure, "y [").get_xlim()
        assert high - low < 3000.0
        assert "1 of 40 track points lie outside the map" in " ".join(texts(figure).split())


def test_many_tracks_share_a_map(ships: Recording) -> None:
    tracks = {name: make_track(offset=300.0 * i) for i, name in enumerate(ships.targets)}
    figure = plot.track(tracks, ships)
    assert "tracks (2)" in texts(figure)
    assert set(ships.targets) <= {t.get_text() for ax in figure.axes for t in ax.texts}
    crowd = {str(i): make_track(offset=100.0 * i) for i in range(20)}
    figure = plot.track(crowd)
    assert "tracks (20)" in texts(figure)
    assert not labelled(figure, "y [").texts
    with pytest.raises(ValueError, match="expected at least one track, got none"):
        plot.track({})


def test_track_refuses_what_is_no_map() -> None:
    imm = IMM(Bank([load("static")(psd=0.0)]), load("position")(sigma=5.0, dims=2))
    batch = imm.run(T[:3], np.zeros((4, 3, 2)))
    with pytest.raises(ValueError, match=r"expected one track, got a batch of shape \(4,\)"):
        plot.track(batch)
    imm = IMM(Bank([load("static")(psd=0.0)]), load("position")(sigma=5.0, dims=1))
    with pytest.raises(ValueError, match="this track has 1"):
        plot.track(imm.run(T[:3], np.zeros((3, 1))))


def test_error_against_its_bound(track: Track, tmp_path: Path) -> None:
    figure = plot.error(track, truth=(T, PATH), title="Trial", path=tmp_path / "error.png")
    ax = labelled(figure, "position error [m]")
    distance = np.linalg.norm(track.position - PATH, axis=1)
    np.testing.assert_allclose(line(ax, "error").get_ydata(), distance)
    first, second = ax.get_title(loc="left").split("\n")
    assert first == "Trial"
    assert "of 40 position errors inside the track's own 95 % bound; RMSE" in second
    share = int(second.split(" %")[0])
    assert 85 <= share <= 100
    assert imread(tmp_path / "error.png").shape[1] > 1200


def test_error_beside_the_least_possible(track: Track) -> None:
    model = load("constant-velocity")(psd=1.0)
    bound = bounds.pcrlb(model, load("position")(sigma=5.0, dims=2), T, PATH)
    figure = plot.error(track, truth=(T, PATH), bound=bound)
    drawn = line(labelled(figure, "position error [m]"), "least possible RMS error")
    np.testing.assert_allclose(drawn.get_xdata(), T)
    np.testing.assert_allclose(drawn.get_ydata(), bound.position_rms)
    assert drawn.is_dashed()
    assert "least possible RMS error" in texts(figure)
    rms = np.where(T < 3.0, np.inf, 1e4)
    alone = labelled(plot.error(track, bound=(T, rms)), "95 % bound [km]")
    drawn = line(alone, "least possible RMS error").get_ydata()
    assert np.isnan(drawn[:3]).all()
    np.testing.assert_allclose(drawn[3:], 10.0)
    assert alone.get_ylim()[1] > 10.0
    with pytest.raises(ValueError, match="bound: expected a single track to compare with, got 2"):
        plot.error({"a": track, "b": track}, truth=None, bound=bound)
    with pytest.raises(ValueError, match="bound: expected one error for each of the 40 times"):
        plot.error(track, bound=(T, rms[:-1]))
    with pytest.raises(ValueError, match=r"bound: expected a PosteriorBound or \(times, rms\)"):
        plot.error(track, bound=rms)  # type: ignore[arg-type]


def test_error_without_truth_shows_bound_and_consistency(track: Track) -> None:
    figure = plot.error(track)
    assert labelled(figure, "95 % bound [m]").get_title(loc="left").startswith("no truth")
    ax = labelled(figure, "NIS / its 95 % limit")
    shown = sum(points(x) for x in ax.get_lines() if str(x.get_label())[0] != "_")
    assert shown == np.count_nonzero(track.nis_dof > 0)
    assert "scans as foreseen (95 % expected)" in ax.get_title(loc="left")


def test_errors_of_several_targets(ships: Recording) -> None:
    tracks = {}
    for name in ships.targets:
        times = ships.truth_times(name)[:50]
        place, _ = ships.truth_at(name, times)
        imm = IMM(Bank([load("constant-velocity")(psd=1.0)]), load("position")(sigma=5.0, dims=2))
        tracks[name] = imm.run(times, place + 3.0)
    figure = plot.error(tracks, ships)
    ax = labelled(figure, "position error [m]")
    assert "of 100 errors of 2 targets" in ax.get_title(loc="left")
    assert sum(points(x) for x in ax.get_lines()[:2]) == 100
    assert plot.error(tracks).axes[0].get_title(loc="left").startswith("no truth")


def test_calibration_counts() -> None:
    figure = plot.calibration([1.0, 2.0, 3.0, 4.0], [0.5, 2.5, 1.0, 3.0])
    assert figure.axes[0].get_title(loc="left").startswith("75 % of 4 errors of fixes")
    with pytest.raises(ValueError, match=r"distance: expected shape \(2,\), got \(3,\)"):
        plot.calibration([1.0, 2.0], [1.0, 2.0, 3.0])


def test_gdop_shows_what_bounds_gdop_says(tmp_path: Path) -> None:
    extent = (-500.0, 1200.0, -400.0, 900.0)
    figure = plot.gdop(STATIONS, extent=extent, path=tmp_path / "gdop.png")
    ax = labelled(figure, "y [m]")
    mesh = ax.collections[0]
    shown = np.asarray(mesh.get_array())
    x0, x1 = ax.get_xlim()
    y0, y1 = ax.get_ylim()
    assert x0 <= extent[0] < extent[1] <= x1
    x, y = np.linspace(x0, x1, shown.shape[1]), np.linspace(y0, y1, shown.shape[0])
    for i, j in ((0, 0), (20, 40), (shown.shape[0] - 1, 7)):
        assert shown[i, j] == pytest.approx(bounds.gdop(STATIONS, np.array([x[j], y[i]])))
    assert {t.get_text() for t in ax.texts} >= set(STATIONS.names)
    assert "dilution with all 3" in texts(figure).replace("\n", " ")
    assert imread(tmp_path / "gdop.png").shape[0] > 800


def test_gdop_marks_fixes_and_mirrors() -> None:
    """Three stations in the plane: a target behind one of them has a mirror solution."""
    at = np.array([[-260.0, -40.0], [300.0, 200.0]])
    tdoa = load("tdoa")(STATIONS, toa_sigma=1e-9)
    z = tdoa.predict(at, np.zeros_like(at), 0.0) / tdoa.speed
    fix = gauss_newton(STATIONS, z, toa_sigma=1e-9)
    figure = plot.gdop(STATIONS, fix, truth=at)
    assert "fixes (2)" in texts(figure)
    assert "truth" in texts(figure)
    assert ("mirror solutions" in texts(figure)) == fix.ambiguous
    marked = line(labelled(figure, "y ["), "fixes").get_xydata()
    np.testing.assert_allclose(marked, fix.position)
    with_gap = np.concatenate([at, [[np.nan, np.nan]]])
    assert "fixes (2)" in texts(plot.gdop(STATIONS, with_gap))


def test_gdop_of_stations_that_fix_nothing() -> None:
    flat = Stations(np.array([[0.0, 0.0], [1000.0, 0.0]]))
    figure = plot.gdop(flat, extent=(0.0, 1000.0, 100.0, 900.0))
    assert "no position is determined here" in figure.axes[0].get_title(loc="left")


def test_gdop_refuses_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="extent: expected"):
        plot.gdop(STATIONS, extent=(1.0, 0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="fixes: expected shape"):
        plot.gdop(STATIONS, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="needs 2 or 3 dimensions"):
        plot.gdop(Stations(np.array([[0.0], [1.0]])))


def test_scene_shows_stations_and_truth(ships: Recording, tmp_path: Path) -> None:
    figure = plot.scene(ships, path=tmp_path / "scene.svg")
    for name in ships.targets:
        assert f"truth of {name}" in texts(figure)
    assert "stations" in texts(figure)
    assert (tmp_path / "scene.svg").read_text("utf-8").lstrip().startswith("<?xml")


def test_names_do_not_cover_each_other() -> None:
    """Stations in a crowd: what is written does not overlap when drawn, the rest is left out."""
    figure = canvas.figure(6.0, 6.0)
    ax = figure.add_subplot()
    rng = np.random.default_rng(2)
    points = rng.normal(0.0, 40.0, (150, 2))
    ax.plot(*points.T, "^")
    settle(figure, [(ax, Box.of(points), Unit(100.0))])
    boxes = name_points(figure, ax, points, [f"station-{i}" for i in range(150)])
    assert 20 < len(boxes) == len(ax.texts) < 150
    figure.draw_without_rendering()
    drawn = [text.get_window_extent() for text in ax.texts]
    assert not any(a.overlaps(b) for a, b in combinations(drawn, 2))
    frame = ax.get_window_extent()
    assert all(frame.x0 - 1 <= b.x0 and b.x1 <= frame.x1 + 1 for b in drawn)


def test_units_and_clocks() -> None:
    assert Unit(4999.0).text(120.0) == "120 m"
    assert Unit(5000.0).text(1234.0) == "1.23 km"
    assert Unit(100.0).text(4530.0) == "4530 m"
    assert Clock(np.array([0.0, 50.0])).label == "time [s]"
    late = Clock(np.array([68441.5, 68500.0]))
    assert late.label == "time after 68441.5 s [s]"
    assert late(68442.0) == 0.5


def test_pyplot_stays_out() -> None:
    """A picture from a library must not touch pyplot's global state."""
    program = "import sys, imm_tdoa.plot; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
