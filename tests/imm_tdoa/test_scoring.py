"""A track against the truth: which times count, and the figures by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from imm_tdoa import IMM, Bank, Stations, Track
from imm_tdoa.recording import Recording, Table, TruthScoring
from imm_tdoa.registry import load
from imm_tdoa.scoring import Errors, against_points, against_truth, pooled


def track_through(times: Sequence[float], points: Sequence[Sequence[float]]) -> Track:
    """A track whose rows are (nearly) `points`: fixes of 0.1 m against a very loose model."""
    dims = len(points[0])
    imm = IMM(
        Bank([load("constant-velocity")(psd=1e6)]),
        load("position")(sigma=0.1, dims=dims),
    )
    return imm.run(np.array(times), np.array(points))


def recording(times: Sequence[float], points: Sequence[Sequence[float]], **more: Any) -> Recording:
    """A recording of which only the truth matters."""
    d = len(points[0])
    place = np.arange(4.0 * d).reshape(4, d) ** 2
    columns: dict[str, Any] = {"time_s": times, "target": ["t"] * len(times)}
    columns |= {f"{a}_m": [p[i] for p in points] for i, a in enumerate("xyz"[:d])}
    columns |= more.pop("speeds", {})
    return Recording(
        Stations(place * 1000.0, names=("a", "b", "c", "d")),
        tdoa=Table(
            {
                "time_s": [0.0],
                "station": ["a"],
                "reference": ["b"],
                "tdoa_s": [0.0],
                "target": ["t"],
            }
        ),
        truth=Table(columns),
        **more,
    )


T = [0.0, 1.0, 2.0, 3.0, 4.0]
LINE = [[10.0 * t, -5.0 * t] for t in T]


def test_figures_by_hand() -> None:
    track = track_through(T, LINE)
    truth = [[x + 3.0, y - 4.0] for x, y in LINE]
    speeds = {"vx_mps": [9.0] * 5, "vy_mps": [-5.0] * 5}
    found = against_truth(track, recording(T, truth, speeds=speeds))
    assert found is not None
    np.testing.assert_array_equal(found.times, T)
    np.testing.assert_allclose(found.distance, 5.0, atol=0.05)
    figures = found.summary()
    assert figures["position_rmse_m"] == pytest.approx(5.0, abs=0.05)
    assert figures["position_median_m"] == pytest.approx(5.0, abs=0.05)
    assert figures["horizontal_rmse_m"] == figures["position_rmse_m"]
    expected = np.mean(
        [e @ np.linalg.solve(P, e) for e, P in zip(found.position, found.covariance, strict=True)]
    )
    assert figures["mean_nees"] == pytest.approx(float(expected), rel=1e-9)
    v = track.velocity - np.array([9.0, -5.0])
    assert figures["velocity_rmse_mps"] == pytest.approx(
        float(np.sqrt(np.mean(np.sum(v**2, axis=1)))), rel=1e-9
    )


def test_truth_times_that_the_track_has_are_the_times() -> None:
    """Truth at every other row: those rows count, nothing is interpolated."""
    found = against_truth(track_through(T, LINE), recording(T[::2], LINE[::2]))
    assert found is not None
    np.testing.assert_array_equal(found.times, [0.0, 2.0, 4.0])


def test_truth_of_its_own_clock_is_interpolated() -> None:
    times = [-0.5, 1.5, 3.5]
    found = against_truth(
        track_through(T, LINE), recording(times, [[10.0 * t, -5.0 * t] for t in times])
    )
    assert found is not None
    np.testing.assert_array_equal(found.times, [0.0, 1.0, 2.0, 3.0])
    assert np.max(found.distance) < 0.1


def test_gaps_in_the_truth_are_not_bridged() -> None:
    times = [-0.5, 0.6, 3.5, 4.5]
    points = [[10.0 * t, -5.0 * t] for t in times]
    scoring = TruthScoring(max_gap_s=1.5)
    found = against_truth(track_through(T, LINE), recording(times, points, truth_scoring=scoring))
    assert found is not None
    np.testing.assert_array_equal(found.times, [0.0, 4.0])


def test_of_several_rows_at_one_time_the_last_counts() -> None:
    times = [0.0, 1.0, 1.0, 2.0]
    points = [[0.0, 0.0], [90.0, 0.0], [10.0, 0.0], [20.0, 0.0]]
    track = track_through(times, points)
    found = against_truth(track, recording([0.0, 1.0, 2.0], [[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]))
    assert found is not None
    np.testing.assert_array_equal(found.times, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(found.position[1], track.position[2] - [10.0, 0.0])


def test_axes_that_the_truth_may_be_used_on() -> None:
    points = [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0], [3.0, 4.0, 5.0]]
    track = track_through(T[:3], points)
    wrong_height = [[x, y, z + 50.0] for x, y, z in points]
    flat = TruthScoring(axes=("x", "y"))
    data = recording(T[:3], wrong_height, truth_scoring=flat)
    found = against_truth(track, data)
    assert found is not None
    assert found.axes == ("x", "y")
    assert found.position.shape == (3, 2)
    assert found.covariance.shape == (3, 2, 2)
    assert found.summary()["position_rmse_m"] == found.summary()["horizontal_rmse_m"]
    assert np.max(found.distance) < 1.0
    whole = against_truth(track, recording(T[:3], wrong_height))
    assert whole is not None
    figures = whole.summary()
    assert figures["position_rmse_m"] == pytest.approx(50.0, abs=0.5)
    assert figures["horizontal_rmse_m"] == pytest.approx(0.0, abs=0.5)


def test_no_time_in_common_is_none() -> None:
    track = track_through(T, LINE)
    assert against_truth(track, recording([10.0, 11.0], LINE[:2])) is None
    assert against_points(track, [10.0, 11.0], LINE[:2]) is None


def test_points_instead_of_a_recording() -> None:
    found = against_points(track_through(T, LINE), [0.0, 4.0], [LINE[0], LINE[4]])
    assert found is not None
    assert len(found.times) == 5
    assert np.max(found.distance) < 0.1
    with pytest.raises(ValueError, match="position: expected shape"):
        against_points(track_through(T, LINE), [0.0, 4.0], [[0.0, 0.0, 0.0]] * 2)


def test_bound_holds_about_95_percent() -> None:
    """Errors drawn from the covariance: the bound holds 95 %, within 4 binomial sigmas."""
    rng = np.random.default_rng(5)
    N = 4000
    A = rng.normal(size=(N, 2, 2))
    P = A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(2)
    e = np.einsum("nij,nj->ni", np.linalg.cholesky(P), rng.normal(size=(N, 2)))
    errors = Errors(np.arange(float(N)), e, P, None, ("x", "y"))
    share = np.mean(errors.distance <= errors.bound)
    assert abs(share - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / N) + 0.01  # Satterthwaite is near


def test_pooled_is_everything_together() -> None:
    a = against_truth(track_through(T, LINE), recording(T, [[x + 3.0, y] for x, y in LINE]))
    b = against_truth(track_through(T, LINE), recording(T, [[x, y + 4.0] for x, y in LINE]))
    assert a is not None
    assert b is not None
    assert pooled([a, b]).summary()["position_rmse_m"] == pytest.approx(
        np.sqrt((3.0**2 + 4.0**2) / 2.0), abs=0.05
    )
