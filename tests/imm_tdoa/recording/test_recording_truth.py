"""Truth between its rows, over gaps, and where there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from imm_tdoa import Stations
from imm_tdoa.recording import Recording, Table, TruthScoring

STATIONS = Stations(np.array([[0.0, 0.0, 0.0], [1e3, 0.0, 0.0]]), names=("a", "b"))
TOA = Table({"time_s": [0.0], "emission": ["m"], "station": ["a"], "toa_s": [0.1]})
TIMES = np.array([0.0, 1.0, 2.5, 7.0])


def made(velocity: bool = False, d: int = 3, **more: Any) -> Recording:
    """A truth of two targets whose rows are mixed; that of ``car`` is a cubic in time."""
    p, v = cubic(TIMES)
    columns = {"time_s": np.repeat(TIMES, 2), "target": ["car", "bus"] * len(TIMES)}
    columns |= {f"{axis}_m": np.repeat(p[:, i], 2) + [0.0, 9.0] * 4 for i, axis in enumerate("xyz")}
    if velocity:
        columns |= {f"v{axis}_mps": np.repeat(v[:, i], 2) for i, axis in enumerate("xyz"[:d])}
    if d == 2:
        del columns["z_m"]
    return Recording(STATIONS, toa=TOA, truth=Table(columns), **more)


def cubic(t: Any) -> tuple[Any, Any]:
    t = np.asarray(t, dtype=float)[:, None]
    c = np.array([[1.0, -2.0, 3.0], [4.0, 0.5, -1.0], [0.3, 0.2, 0.1], [-0.02, 0.03, 0.01]])
    p = c[0] + c[1] * t + c[2] * t**2 + c[3] * t**3
    return p, c[1] + 2.0 * c[2] * t + 3.0 * c[3] * t**2


def test_at_its_rows_the_truth_is_what_they_say() -> None:
    recording = made()
    position, velocity = recording.truth_at("car", TIMES)
    np.testing.assert_array_equal(position, cubic(TIMES)[0])
    assert velocity is None
    np.testing.assert_array_equal(recording.truth_times("bus"), TIMES)
    np.testing.assert_array_equal(recording.truth_at("bus", TIMES)[0], cubic(TIMES)[0] + 9.0)


def test_a_straight_line_between_rows() -> None:
    t = np.array([-0.1, 0.25, 2.0, 6.9, 7.1])
    position, _ = made().truth_at("car", t)
    p = cubic(TIMES)[0]
    expected = np.stack([np.interp(t, TIMES, p[:, i]) for i in range(3)], axis=-1)
    np.testing.assert_allclose(position[1:4], expected[1:4], rtol=1e-14)
    assert np.isnan(position[[0, 4]]).all()


def test_with_velocities_a_cubic_comes_back_exactly() -> None:
    t = np.linspace(0.0, 7.0, 57)
    position, velocity = made(velocity=True).truth_at("car", t)
    assert velocity is not None
    np.testing.assert_allclose(position, cubic(t)[0], atol=1e-12)
    np.testing.assert_allclose(velocity, cubic(t)[1], atol=1e-12)


def test_over_a_long_gap_there_is_no_truth() -> None:
    t = np.array([0.0, 0.5, 1.0, 1.5, 2.5, 3.0, 6.0, 7.0])
    recording = made(velocity=True, truth_scoring=TruthScoring(max_gap_s=2.0))
    position, velocity = recording.truth_at("car", t)
    known = [True, True, True, True, True, False, False, True]
    np.testing.assert_array_equal(np.isfinite(position).all(axis=1), known)
    assert velocity is not None
    np.testing.assert_array_equal(np.isfinite(velocity).all(axis=1), known)


@pytest.mark.parametrize("velocity", [False, True])
def test_a_truth_without_heights(velocity: bool) -> None:
    flat = TruthScoring(axes=("x", "y"))
    position, speed = made(velocity, d=2, truth_scoring=flat).truth_at("car", [0.5, 8.0])
    np.testing.assert_array_equal(np.isfinite(position), [[True, True, False], [False] * 3])
    assert (speed is not None) == velocity
    if speed is not None:
        np.testing.assert_allclose(speed[0, :2], cubic([0.5])[1][0, :2])
        assert np.isnan(speed[0, 2])
    with pytest.raises(ValueError, match="truth: z_m: missing column"):
        made(velocity, d=2)


def test_targets_without_truth() -> None:
    bare = Recording(STATIONS, toa=TOA)
    assert bare.truth_times().shape == (0,)
    position, velocity = bare.truth_at(None, [1.0, 2.0])
    assert position.shape == (2, 3)
    assert np.isnan(position).all()
    assert velocity is None
    recording = made()  # two in the truth, one nameless in the measurements
    assert recording.targets == ("emitter",)
    assert np.isnan(recording.truth_at("emitter", [1.0])[0]).all()
    with pytest.raises(ValueError, match="target: no target 'lorry'; there are emitter"):
        recording.truth_at("lorry", [1.0])
    with pytest.raises(ValueError, match="times: expected shape"):
        recording.truth_at("car", 1.0)
