"""The gain of the loop from fix to process noise: kappa, and the multiplier that follows it."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sequence_cases import PLACE, SIGMA, C, differences, ring

from imm_tdoa import SequenceFilter, Stations
from imm_tdoa.sequence_filter import kappa
from imm_tdoa.sequence_filter.loop_gain import increment_factor, process_noise


@pytest.mark.parametrize("d", [2, 3])
def test_the_mean_square_of_a_difference_of_cosines(d: int) -> None:
    """E[(cos a - cos b)²] = 2/d for independent isotropic directions: why iso is iso."""
    N = 200_000
    u = np.random.default_rng(d).standard_normal((2, N, d))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    e = np.eye(d)[0]
    Q = process_noise("proj", np.broadcast_to(3.0 * e, (N, d)), (u[0] - u[1])[:, None, :])
    error = float(np.std(Q) / np.sqrt(N))
    assert abs(Q.mean() - 9.0 * 2.0 / d) < 4.0 * error
    assert increment_factor("iso", d) == 2.0 / d
    assert_array_equal(process_noise("iso", 3.0 * e, np.zeros((4, d))), np.full(4, 18.0 / d))
    assert_array_equal(process_noise("bound", 3.0 * e, np.zeros((4, d))), np.full(4, 36.0))
    assert np.all(Q <= 36.0)


def test_weights_of_correlated_differences() -> None:
    """§6.4: .95 m by equal weights, .71 m by T_N^-1; and as many metres as kappa says."""
    tick, T = 10e-9, 300
    sd = C * tick / np.sqrt(6.0)
    rng = np.random.default_rng(4)
    stations = ring()
    arrival = np.linalg.norm(PLACE - stations.positions, axis=-1) / C
    arrival = arrival + tick * rng.uniform(-0.5, 0.5, (20, T, 6))
    tdoa = arrival[..., :-1] - arrival[..., 1:]
    for weights, published in (("diagonal", 0.95), ("full", 0.71)):
        predicted = sd * np.sqrt(kappa(stations, PLACE, weights=weights))  # type: ignore[arg-type]
        assert abs(predicted - published) < 0.006
        stage = SequenceFilter(stations, tick=tick, weights=weights)  # type: ignore[arg-type]
        found = stage.run(np.arange(8.0), tdoa.reshape(-1, 8, 5))
        square = np.sum((found.raw_position - PLACE) ** 2, axis=-1)
        error = np.std(square) / np.sqrt(square.size)
        assert abs(np.mean(square) - predicted**2) < 4.0 * error


def test_kappa() -> None:
    stations = ring()
    rng = np.random.default_rng(0)
    places = np.array([PLACE, [0.0, 0.0], [2500.0, 700.0]])
    one = kappa(stations, places)
    assert_allclose(kappa(stations, PLACE), one[0])
    assert_allclose(kappa(stations, places, multiplier=0.25), 0.25 * one)
    assert_allclose(kappa(stations, places, "bound"), 4.0 * one)
    assert_allclose(kappa(Stations(1e-3 * stations.positions), 1e-3 * places), one)
    assert_allclose(one[1], 1.0 / 3.0)  # in the middle of a regular ring of six
    assert np.all(kappa(stations, places, weights="diagonal") >= one)
    assert_allclose(
        kappa(stations, [PLACE, [2500.0, 700.0]], weights="diagonal"), [0.61, 7.3], rtol=0.04
    )
    stage = SequenceFilter(stations, toa_sigma=SIGMA)
    assert_allclose(stage.kappa(places), one)
    auto = attrs.evolve(stage, multiplier="auto")
    assert_allclose(auto.kappa(places), 0.5)
    moving = Stations(
        np.stack([stations.positions, 2.0 * stations.positions]), times=np.array([0.0, 10.0])
    )
    assert_allclose(kappa(moving, places, time=0.0), one)
    assert_allclose(kappa(moving, 2.0 * places, time=10.0), one)
    # by random numbers: how far a fix moves when every difference moves by its own noise
    u = (PLACE - stations.positions) / np.linalg.norm(
        PLACE - stations.positions, axis=-1, keepdims=True
    )
    G = u[:-1] - u[1:]
    arrivals = rng.standard_normal((100_000, 6)) / np.sqrt(2.0)
    moves = (arrivals[:, :-1] - arrivals[:, 1:]) @ np.linalg.pinv(G).T
    square = np.sum(moves**2, axis=-1)
    error = np.std(square) / np.sqrt(len(square))
    assert abs(square.mean() - kappa(stations, PLACE, weights="diagonal")) < 4.0 * error


def test_kappa_of_proj() -> None:
    """With no difference to spare the fix undoes the projection: exactly 1. Else about as much."""
    rng = np.random.default_rng(3)
    for d in (2, 3):
        least = Stations(rng.uniform(-2e3, 2e3, (d + 1, d)))
        assert_allclose(kappa(least, rng.uniform(-3e3, 3e3, (5, d)), "proj"), 1.0, rtol=1e-6)
        more = Stations(rng.uniform(-2e3, 2e3, (d + 4, d)))
        found = kappa(more, rng.uniform(-3e3, 3e3, (50, d)), "proj")
        assert np.all((found > 0.1) & (found < 1.5))
        assert np.median(found) < 1.0 < np.max(kappa(more, rng.uniform(-3e3, 3e3, (50, d))))


def test_kappa_where_there_is_no_fix() -> None:
    """On the line through stations in one line nothing is known across it."""
    line = Stations(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [5.0, 0.0]]))
    assert np.isnan(kappa(line, [9.0, 0.0]))
    assert np.isfinite(kappa(line, [3.0, 4.0]))


def test_the_multiplier_follows_the_geometry() -> None:
    truth = np.linspace([200.0, 0.0], [3000.0, 500.0], 12)
    stations = ring()
    tdoa = differences(stations.positions, truth, 1, (4,))
    stage = SequenceFilter(stations, toa_sigma=SIGMA, multiplier="auto")
    found = stage.run(np.arange(12.0), tdoa)
    assert_allclose(found.multiplier * kappa(stations, found.position), 0.5, rtol=1e-9)
    step = np.sum(np.diff(found.position, axis=-2) ** 2, axis=-1)
    Q = C**2 * found.process_noise[:, 1:, 0]
    assert_allclose(Q, found.multiplier[:, 1:] * step, rtol=1e-6)
