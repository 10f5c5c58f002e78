"""Pictures of tracks that nobody named: the map, lives, rows in their colours, GOSPA."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import attrs
import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Tracker, following, plot
from imm_tdoa.models import ConstantVelocity, Position
from imm_tdoa.plot import canvas, colours
from imm_tdoa.recording import Table, unlabelled, without_labels
from imm_tdoa.simulate import load, simulate
from imm_tdoa.tracking import Life, Silence


def legend(figure: Figure) -> list[str]:
    boxes = [box for ax in figure.axes if (box := ax.get_legend()) is not None]
    return [t.get_text() for box in boxes for t in box.get_texts()]


def written(figure: Figure) -> set[str]:
    return {t.get_text() for ax in figure.axes for t in ax.texts}


@pytest.fixture(scope="module")
def pair() -> Any:
    """Two emitters, one of which falls silent: recording, scans, tracks, following."""
    made = load("parallel")
    near, far = made.targets
    far = attrs.evolve(far, passes_m=None, at_s=None, position_m=(-3000.0, -900.0))
    short = attrs.evolve(far, legs=[attrs.evolve(far.legs[0], duration_s=40.0)])
    data = simulate(attrs.evolve(made, targets=[near, short]), seed=1)
    found = unlabelled(data)
    bank = Bank([ConstantVelocity(psd=0.01)], birth_std={"velocity": 30.0})
    tracker = Tracker(bank, found.measurement, deletion=Silence(hits=1, scans=6))
    found = attrs.evolve(found, scans=found.scans[:40])
    tracks = tracker.run(found.scans)
    beside = following.follow(tracks, data, [s.time for s in found.scans], cutoff=40.0)
    return data, found, tracks, beside


def test_the_map_tells_the_living_from_the_ended(pair: Any) -> None:
    data, _, tracks, _ = pair
    figure = plot.track(tracks, data)
    said = legend(figure)
    assert "2 tracks, by number" in said
    assert "truth (2 emitters)" in said
    assert "ended, last heard (1)" in said
    assert "still followed (1)" in said
    assert {"1", "2"} <= written(figure)


def test_an_ended_track_is_drawn_until_it_was_last_heard(pair: Any) -> None:
    _, _, tracks, _ = pair
    (gone,) = [name for name, life in tracks.lives.items() if life.ended is not None]
    shown, coasting, trial = colours.stretches(tracks[gone], tracks.lives[gone])
    life = tracks.lives[gone]
    assert tracks[gone].times[shown][-1] == life.heard < life.ended
    assert_array_equal(trial, tracks[gone].times < life.confirmed)
    assert coasting[~shown[1:]].all()


def test_lives_are_drawn_from_birth_to_end(pair: Any) -> None:
    data, _, tracks, beside = pair
    figure = plot.lives(tracks, beside, title=data.title)
    ax = figure.axes[0]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["1", "2"]
    said = "\n".join(legend(figure))
    assert "ended (1):\nfewer than 1 of 6 scans heard it" in said
    for n, name in enumerate(tracks):
        life, colour = tracks.lives[name], colours.of_tracks(tracks)[name]
        own = [x for x in ax.lines if x.get_color() == colour and len(x.get_xdata()) == 2]
        ends = [t for line in own for t in line.get_xdata()]
        assert min(ends) == life.born
        assert max(ends) == (tracks.time if life.ended is None else life.ended)
        assert {y for line in own for y in line.get_ydata()} == {n}
    behind = [x for x in ax.lines if x.get_color() == canvas.TRUTH]
    assert len(behind) == 2
    without = plot.lives(tracks)
    assert not any("emitter" in text for text in legend(without))


def test_emitters_that_nobody_followed_have_lines_of_their_own(pair: Any) -> None:
    data, found, tracks, _ = pair
    truth = {name: data.truth[name] for name in data.truth}
    truth["y_m"] = truth["y_m"] + 1e5
    away = attrs.evolve(data, truth=Table(truth))
    beside = following.follow(tracks, away, [s.time for s in found.scans], cutoff=40.0)
    figure = plot.lives(tracks, beside)
    labels = [t.get_text() for t in figure.axes[0].get_yticklabels()]
    assert labels == ["1", "2", *(f"({name})" for name in beside.targets)]
    assert any("never followed" in text for text in legend(figure))


def test_rows_are_in_the_colour_of_their_track(pair: Any) -> None:
    data, found, tracks, _ = pair
    figure = plot.claims(tracks, data, found)
    assert figure is not None
    paint = colours.of_tracks(tracks)
    drawn: dict[str, int] = {}
    for ax in figure.axes:
        for dots in ax.collections:
            faces = [to_hex(c).upper() for c in dots.get_facecolors()]  # type: ignore[attr-defined]
            faces = faces * len(dots.get_offsets()) if len(faces) == 1 else faces  # type: ignore[arg-type]
            for face in faces:
                drawn[face] = drawn.get(face, 0) + 1
    for name, colour in paint.items():
        assert drawn[colour] == len(tracks.taken(name)[0])
        assert f"track {name} ({drawn[colour]})" in legend(figure)
    every = sum(len(scan) for scan in found.scans)
    assert sum(drawn.values()) == every


def test_rows_of_arrival_times_are_differences_of_their_emission() -> None:
    data = without_labels(simulate(load("two-ships"), seed=1))
    found = unlabelled(data)
    found = attrs.evolve(found, scans=found.scans[:12])
    bank = Bank([ConstantVelocity(psd=0.01)], birth_std={"velocity": 10.0})
    tracks = Tracker(bank, found.measurement).run(found.scans)
    figure = plot.claims(tracks, data, found)
    assert figure is not None
    reference = {ax.get_title(loc="left").split(" - ")[1] for ax in figure.axes if ax.lines}
    assert len(reference) == 1
    places = data.stations.positions
    numbers = {name: i for i, name in enumerate(data.stations.names)}
    for ax in figure.axes:
        if not ax.collections:
            continue
        a, b = (numbers[n] for n in ax.get_title(loc="left").split(" - "))
        limit = 1e6 * np.linalg.norm(places[a] - places[b]) / data.speed_mps
        for dots in ax.collections:
            xy = np.asarray(dots.get_offsets())
            assert np.all(np.abs(xy[:, 1]) < limit + 1.0)


def test_gospa_is_drawn_as_it_is(pair: Any) -> None:
    data, _, _, beside = pair
    figure = plot.gospa(beside, title=data.title)
    line = next(x for x in figure.axes[0].lines if x.get_label() == "GOSPA")
    assert_allclose(line.get_ydata(), beside.gospa.distance)
    assert_allclose(line.get_xdata(), beside.times)
    counts = {str(x.get_label()): x.get_ydata() for x in figure.axes[2].lines}
    assert_array_equal(counts["emitters"], beside.present.sum(axis=0))
    assert_array_equal(counts["tracks"], beside.alive.sum(axis=0))
    assert any("cutoff 40" in text for text in legend(figure))


def test_colours_differ_and_those_used_twice_are_far_apart() -> None:
    apart = [
        np.linalg.norm(np.subtract(to_rgb(a), to_rgb(b)))
        for i, a in enumerate(colours.PALETTE)
        for b in colours.PALETTE[:i]
    ]
    assert min(apart) > 0.2
    n = len(colours.PALETTE)
    bank = Bank([ConstantVelocity(psd=1.0)])
    imm = IMM(bank, Position(sigma=1.0))
    tracks = {
        str(k): imm.run([0.0, 1.0], np.array([[100.0 * k, 0.0], [100.0 * k, 1.0]]))
        for k in range(2 * n)
    }
    paint = list(colours.of_tracks(tracks).values())
    assert paint[:n] == list(colours.PALETTE)
    same = [abs(i - j) for i in range(2 * n) for j in range(i) if paint[i] == paint[j]]
    assert min(same) >= n // 2
    assert all(a != b for a, b in pairwise(paint))


def test_a_gap_is_longer_than_usual() -> None:
    """Rows at 0, 1, 2, 3, 7, 8: scans 4 to 6 were coasted; a single scan missed is no gap."""
    values = np.stack([np.arange(10.0), np.zeros(10)], axis=-1)
    values[[4, 5, 6]] = np.nan
    track = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(sigma=1.0)).run(np.arange(10.0), values)
    life = Life("1", 0.0, 2.0, 9.0, None, "", 10, 7, 7)
    shown, coasting, trial = colours.stretches(track, life)
    assert shown.all()
    assert_array_equal(np.flatnonzero(coasting), [3, 4, 5, 6])
    assert_array_equal(np.flatnonzero(trial), [0, 1])
    values[2] = np.nan
    values[[4, 5, 6]] = 1.0
    track = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(sigma=1.0)).run(np.arange(10.0), values)
    assert not colours.stretches(track, life).coasting.any()


def test_no_tracks_are_refused(pair: Any) -> None:
    _, found, _, _ = pair
    none = Tracker(Bank([ConstantVelocity(psd=1.0)]), found.measurement).run([])
    with pytest.raises(ValueError, match="track: expected at least one track, got none"):
        plot.track(none)
    with pytest.raises(ValueError, match="tracks: expected at least one track, got none"):
        plot.lives(none)
