"""Pictures of the reproduction: what is on them."""

from __future__ import annotations

import numpy as np
import pytest

from imm_tdoa.reproduce import motion_form
from imm_tdoa.reproduce.motion_form import pictures, pictures_switching
from imm_tdoa.reproduce.motion_form import switching_target as module
from imm_tdoa.reproduce.motion_form.whole import MotionForm


@pytest.fixture(scope="module")
def result() -> MotionForm:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "levels", lambda model, per_decade=3: [0.0, 1e-3, 1e-1])
        return motion_form.compute(3, 2)


def test_a_scenario(result: MotionForm) -> None:
    figure = pictures.of_scenario(result.table, "scenario-2")
    row = result.table.row("scenario-2")
    assert row.sample is not None
    assert row.estimate is not None
    assert f"{row.sample.mean_km:.3f}" in figure.get_suptitle()
    assert "10.618" in figure.get_suptitle()
    assert "our reconstruction" in figure.get_suptitle()
    *maps, whole, errors, _ = figure.axes
    assert len(maps) == 3
    widths = [np.ptp(ax.get_xlim()) for ax in maps]
    np.testing.assert_allclose(widths, widths[0], rtol=0.06)  # axis labels take some room
    for ax, path, found in zip(maps, row.motion.truth(), row.estimate, strict=True):
        true, drawn = (line.get_xydata() for line in ax.lines)
        np.testing.assert_allclose(true, path[:, :2] / 1e3)
        np.testing.assert_allclose(drawn, found / 1e3)
        assert ax.get_aspect() == 1.0
    assert whole.get_aspect() == 1.0
    assert errors.get_ylabel() == "position error [km]"
    assert errors.get_ylim()[1] > row.sample.errors_km.mean(axis=0).max()


def test_switching_targets(result: MotionForm) -> None:
    figure = pictures_switching.over_time(result)
    top, ribbon = (ax for ax in figure.axes if ax.axison)
    assert f"{result.switching.imms['birth'].mean_km:.3f}" in figure.get_suptitle()
    drawn = [line.get_ydata() for line in top.lines]
    for sample in (*result.switching.imms.values(), result.sweep.best.sample):
        assert any(np.array_equal(sample.over_time_km, y) for y in drawn)
    assert [t.get_text() for t in top.texts] == list(pictures_switching.PHASES)
    assert ribbon.get_ylim() == (0.0, 1.0)
    assert top.get_xlim() == ribbon.get_xlim() == (2.0, 90.0)


def test_the_sweep(result: MotionForm) -> None:
    figure = pictures_switching.sweep(result)
    ax, side = figure.axes
    best = result.sweep.best
    (ring,) = [line for line in ax.lines if line.get_markersize() == 12.0]
    assert ring.get_xdata()[0] in (best.process_noise, [best.process_noise])
    assert ax.get_xticklabels()[0].get_text() == "none"
    legend = side.get_legend()
    assert legend is not None
    assert any("km²/s⁵" in text.get_text() for text in legend.get_texts())
