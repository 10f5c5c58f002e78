"""Pictures of the reproduction of Source B: what is on them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imm_tdoa.reproduce import sequence_filter
from imm_tdoa.reproduce.sequence_filter import (
    Reproduction,
    geometries,
    moving,
    pictures,
    scenario,
)


@pytest.fixture(scope="module")
def result() -> Iterator[Reproduction]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenario, "EPOCHS", 40)
        patch.setattr(scenario, "LAST", 15)
        patch.setattr(moving, "EPOCHS", 40)
        patch.setattr(moving, "JUMP_EPOCH", 6)
        patch.setattr(moving, "JUMP_EPOCHS", 28)
        patch.setattr(geometries, "COUNT", 3)
        yield sequence_filter.compute(2, 3)


def test_the_spot(result: Reproduction) -> None:
    figure = pictures.spot(result)
    outcome = result.outcome("iso")
    before, after, close, _ = figure.axes
    place = outcome.case.place
    for ax, fixes in (
        (before, outcome.raw_fixes),
        (after, outcome.fixes),
        (close, outcome.fixes),
    ):
        drawn, target = (line.get_xydata() for line in ax.lines)
        np.testing.assert_allclose(drawn, fixes[-15:] - place)
        np.testing.assert_allclose(target, [[0.0, 0.0]])
        assert ax.get_aspect() == 1.0
    np.testing.assert_allclose(before.get_xlim(), after.get_xlim(), rtol=1e-3)
    assert np.ptp(close.get_xlim()) < np.ptp(after.get_xlim())
    assert f"{outcome.spots.shrink:.0f}-fold" in figure.get_suptitle()
    assert "not the target" in figure.get_suptitle()


def test_the_band(result: Reproduction) -> None:
    figure = pictures.band(result)
    before, after, _, width, error, _ = figure.axes
    middle = result.turn.truth.mean(axis=0)
    for ax, fixes in ((before, result.turn.raw_fixes), (after, result.turn.fixes)):
        truth, drawn = (line.get_xydata() for line in ax.lines)
        np.testing.assert_allclose(truth, result.turn.truth - middle)
        np.testing.assert_allclose(drawn, fixes - middle)
    bands = [b for b in result.bands if b.weights == "full"]
    assert [b.speed_mps for b in bands] == [1.0, 5.0, 20.0]
    raw, after_ = (line.get_ydata() for line in width.lines)
    np.testing.assert_allclose(raw, [b.raw_width_m for b in bands])
    np.testing.assert_allclose(after_, [b.width_m for b in bands])
    assert len(error.lines) == 3
    np.testing.assert_allclose(error.lines[2].get_ydata(), [b.lag_m for b in bands])
    assert f"lag {bands[0].lag_m:.2f} m" in figure.get_suptitle()


def test_what_kappa_foretells(result: Reproduction, tmp_path: Path) -> None:
    figure = pictures.prediction(result, tmp_path / "kappa.svg")
    assert (tmp_path / "kappa.svg").stat().st_size > 10_000
    ax = figure.axes[0]
    drawn = [line.get_xydata()[0] for line in ax.lines[2:5]]
    wanted = [[g.kappa, g.spots.shrink] for g in result.geometries]
    np.testing.assert_allclose(drawn, wanted)
    assert f"{result.right} of 3" in figure.get_suptitle()


def test_the_slow_turn_is_slow_and_comes_back(result: Reproduction) -> None:
    truth = result.turn.truth
    steps = np.linalg.norm(np.diff(truth, axis=0), axis=-1)
    assert np.all(steps <= moving.TURN_SPEED_MPS + 1e-9)
    assert np.all(steps > 0.99 * moving.TURN_SPEED_MPS)
    assert truth[-1, 1] - truth[0, 1] == pytest.approx(2.0 * moving.TURN_RADIUS_M)
