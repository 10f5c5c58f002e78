"""The picture of a choice between motion models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imm_tdoa import plot
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Position, Static
from imm_tdoa.selection import Comparison, compare

TIMES = np.arange(12.0)


def found(targets: int, speed: float = 8.0) -> Comparison:
    rng = np.random.default_rng(0)
    p = np.stack([speed * TIMES, -3.0 * TIMES], axis=-1)
    z = p + rng.normal(0.0, 1.0, (targets, *p.shape))
    return compare(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
        Position(1.0),
        TIMES,
        z,
        birth_std={"velocity": 10.0, "acceleration": 3.0},
    )


def test_one_target(tmp_path: Path) -> None:
    """Both panels: nats behind the best, which lies at the top; the verdict beside them."""
    one = found(1).of(0)
    figure = plot.evidence(one, title="A title", path=tmp_path / "evidence.png")
    top, below, beside = figure.axes
    for ax, evidence in ((top, one.evidence), (below, one.windowed_evidence)):
        lines = {line.get_label(): np.asarray(line.get_ydata()) for line in ax.get_lines()}
        assert set(lines) == {
            "static\n(rejected by NIS)",
            "constant-velocity",
            "constant-acceleration",
        }
        drawn = np.stack(list(lines.values()), axis=-1)
        np.testing.assert_allclose(drawn, evidence.max(axis=-1, keepdims=True) - evidence)
        low, high = ax.get_ylim()
        assert low > drawn.max() > 0.0 >= high  # downwards
    assert top.get_title("left") == "A title\nevidence of the whole run so far"
    assert below.get_title("left") == "evidence of the last 3 scans alone"
    legend = beside.get_legend()
    assert legend is not None
    words = " ".join(text.get_text() for text in legend.get_texts())
    assert "verdict: constant-velocity" in words
    assert "velocity 10" in words
    assert (tmp_path / "evidence.png").stat().st_size > 20_000


def test_a_late_start_leaves_the_beginning_empty() -> None:
    one = found(1).of(0)
    z = np.stack([8.0 * TIMES, -3.0 * TIMES], axis=-1)
    z = np.stack([z, z])
    z[0, :4] = np.nan
    late = compare([Static(psd=0.0), ConstantVelocity(psd=0.0)], Position(1.0), TIMES, z)
    figure = plot.evidence(late.of(0))
    assert len(figure.axes[0].get_lines()[0].get_xdata()) == 8
    assert len(plot.evidence(one).axes[0].get_lines()[0].get_xdata()) == 12


@pytest.mark.parametrize("speed", [0.3, 8.0])
def test_many_targets(speed: float) -> None:
    """A dot per target in the row of its best model, hollow where undecided."""
    batch = found(40, speed)
    figure = plot.evidence(batch)
    ax = figure.axes[0]
    dots = [line for line in ax.get_lines() if line.get_linestyle() == "None"]
    drawn = np.concatenate([np.asarray(line.get_xdata()) for line in dots])
    np.testing.assert_allclose(np.sort(drawn), np.sort(batch.margin))
    hollow = [line for line in dots if line.get_markerfacecolor() == "white"]
    undecided = sum(len(np.asarray(line.get_xdata())) for line in hollow)
    assert undecided == batch.counts["imm"]
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == list(batch.names)
    assert f"{40 - undecided} of 40 targets decided" in ax.get_title("left")
    rows = np.concatenate([np.round(np.asarray(line.get_ydata())) for line in dots])
    np.testing.assert_array_equal(
        np.bincount(rows.astype(int), minlength=3), np.bincount(batch.best, minlength=3)
    )


def test_refusals() -> None:
    with pytest.raises(ValueError, match="expected at least one comparison"):
        plot.evidence({})
    with pytest.raises(ValueError, match="expected a mapping of single targets"):
        plot.evidence({"a": found(2)})
    other = compare([Static(psd=0.0)], Position(1.0), TIMES, np.zeros((12, 2)))
    with pytest.raises(ValueError, match="expected comparisons of the same models"):
        plot.evidence({"a": found(1).of(0), "b": other})
