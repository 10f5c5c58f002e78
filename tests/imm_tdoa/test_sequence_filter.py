"""Filtering sequences of time differences: against a plain loop and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sequence_cases import FIELD, PLACE, SIGMA, C, course, differences

import imm_tdoa
from imm_tdoa import SequenceFilter, Stations, locate
from imm_tdoa.contract import Array
from imm_tdoa.sequence_filter import scalar, steady_gain, steady_lag


def by_hand(stations: Stations, tdoa: Array, stage: SequenceFilter) -> dict[str, Array]:
    """The source's steps for one run, number by number; positions by locate.gauss_newton."""
    R = 2.0 * (C * SIGMA) ** 2
    T, m = tdoa.shape
    factor = {"iso": 2.0 / stations.dims, "bound": 4.0}
    state, P, Q = [np.nan] * m, [np.nan] * m, [np.nan] * m
    last: Array | None = None
    out: dict[str, list[Any]] = {k: [] for k in ("used", "P", "K", "Q", "gated", "position")}
    for k in range(T):
        used, gains, gates = [np.nan] * m, [0.0] * m, [False] * m
        begins = [False] * m
        for i in range(m):
            z = C * tdoa[k, i]
            if np.isnan(state[i]):
                if np.isnan(z):
                    continue
                state[i], P[i], gains[i], begins[i] = z, R, 1.0, True
                used[i] = z
                continue
            P[i] += Q[i]
            if np.isnan(z):
                used[i] = state[i]
                continue
            K = P[i] / (P[i] + R)
            nu, S = z - state[i], P[i] + R
            state[i] += K * nu
            P[i] *= 1.0 - K
            gains[i] = K
            if stage.test == "posterior":
                gates[i] = abs(state[i] - z) > 3.0 * np.sqrt(R)
            else:
                gates[i] = abs(nu) > 3.0 * np.sqrt(S)
            used[i] = z if gates[i] else state[i]
            if gates[i] and stage.reset_on_gate:
                state[i], P[i] = z, R
        there = np.where(np.isfinite(tdoa[k]), used, np.nan) / C
        place = np.full(stations.dims, np.nan)
        if np.count_nonzero(np.isfinite(there)) >= stations.dims:
            fix = locate.gauss_newton(stations, there, toa_sigma=SIGMA, pairs="adjacent")
            place = fix.position
        if last is not None and np.isfinite(place).all():
            step = place - last
            u = (place - stations.positions) / np.linalg.norm(
                place - stations.positions, axis=-1, keepdims=True
            )
            for i in range(m):
                along = (u[i] - u[i + 1]) @ step
                Q[i] = along**2 if stage.rule == "proj" else factor[stage.rule] * step @ step
        for i in range(m):
            Q[i] = R if begins[i] else Q[i]
        last = place if np.isfinite(place).all() else last
        row = {"used": used, "P": P, "K": gains, "Q": Q, "gated": gates, "position": place}
        for name, value in row.items():
            out[name].append(np.array(value))
    return {name: np.array(value) for name, value in out.items()}


@pytest.mark.parametrize("rule", ["iso", "proj", "bound"])
@pytest.mark.parametrize(
    ("test", "reset"), [("posterior", False), ("posterior", True), ("innovation", False)]
)
def test_the_source_step_by_step(rule: Any, test: Any, reset: bool) -> None:
    """A target that creeps, leaps and creeps on; a pair late, one with a gap, an epoch missing."""
    stations = Stations(FIELD)
    truth = course(16)
    truth[8:] += 60.0
    tdoa = differences(FIELD, truth, 3)
    tdoa[:2, 1] = tdoa[5:7, 2] = tdoa[11] = np.nan
    stage = SequenceFilter(stations, toa_sigma=SIGMA, rule=rule, test=test, reset_on_gate=reset)
    found, hand = stage.run(np.arange(16.0), tdoa), by_hand(stations, tdoa, stage)
    assert np.any(hand["gated"]) or rule == "bound"  # whose gain is high
    assert_allclose(C * found.coloured_tdoa, hand["used"], atol=1e-5)
    assert_allclose(C**2 * found.variance, hand["P"], rtol=1e-5)
    assert_allclose(found.gain, hand["K"], rtol=1e-5)
    assert_allclose(C**2 * found.process_noise, hand["Q"], rtol=1e-4)
    assert_array_equal(found.gated, hand["gated"])
    assert_allclose(found.position, hand["position"], atol=1e-5)
    assert_array_equal(found.measured, np.isfinite(tdoa))
    assert np.isnan(found.position[11]).all()


def test_in_three_dimensions() -> None:
    """Two thirds of the squared increment; the same loop by hand."""
    rng = np.random.default_rng(7)
    stations = Stations(rng.uniform(-2e3, 2e3, (6, 3)))
    truth = np.array([100.0, -200.0, 300.0]) + 3.0 * np.arange(10.0)[:, None]
    tdoa = differences(stations.positions, truth, 5)
    stage = SequenceFilter(stations, toa_sigma=SIGMA)
    found, hand = stage.run(np.arange(10.0), tdoa), by_hand(stations, tdoa, stage)
    assert_allclose(found.position, hand["position"], atol=1e-5)
    assert_allclose(found.gain, hand["K"], rtol=1e-5)


def test_without_process_noise_a_running_mean() -> None:
    """P_0 = Q_0 = R: the first value weighs half, the others one; P = R / (k + 1/2)."""
    T, R = 40, 2.0 * SIGMA**2
    tdoa = differences(FIELD, np.broadcast_to(PLACE, (T, 2)), 1)
    stage = SequenceFilter(Stations(FIELD), toa_sigma=SIGMA, multiplier=0.0, gate=None)
    found = stage.run(np.arange(float(T)), tdoa)
    k = np.arange(float(T))[:, None]
    total = np.cumsum(tdoa, axis=0) - 0.5 * tdoa[0]
    mean = np.where(k > 0.0, total / (k + 0.5), tdoa[0])
    assert_allclose(found.coloured_tdoa, mean, rtol=1e-9)
    expected = np.where(k > 0.0, R / (k + 0.5), R)
    assert_allclose(found.variance, np.broadcast_to(expected, mean.shape), rtol=1e-12)
    assert found.gain[1] == pytest.approx(2.0 / 3.0)


@pytest.mark.parametrize("q", [1e-4, 0.03, 1.0, 40.0])
def test_steady_gain_and_lag(q: float) -> None:
    """§6.3: K settles at (sqrt(q² + 4q) - q)/2, and a ramp is followed (1 - K)/K steps late."""
    R, rate = 2.5, 0.7
    x, P = np.array(0.0), np.array(R)
    for k in range(1, int(20.0 / np.sqrt(q)) + 200):
        step = scalar.update(x, P + q * R, np.array(rate * k), np.array(R))
        x, P = step.x, step.P
    K = steady_gain(q)
    assert_allclose(step.K, K, rtol=1e-8)
    assert_allclose(K**2, q * (1.0 - K), rtol=1e-9)
    assert_allclose(rate * k - x, steady_lag(rate, K), rtol=1e-6)


def test_the_floor_is_a_steady_gain() -> None:
    """No feedback, a floor: the process noise is constant, and so in the end is the gain."""
    T, floor = 120, 1e-9
    tdoa = differences(FIELD, np.broadcast_to(PLACE, (T, 2)), 2)
    stage = SequenceFilter(Stations(FIELD), toa_sigma=SIGMA, multiplier=0.0, floor=floor)
    found = stage.run(np.arange(float(T)), tdoa)
    assert_allclose(found.process_noise[1:], floor**2, rtol=1e-12)
    assert_allclose(found.gain[-1], steady_gain(floor**2 / (2.0 * SIGMA**2)), rtol=1e-6)


def test_positions_are_gauss_newtons() -> None:
    stations = Stations(FIELD)
    truth = course(12)
    tdoa = differences(FIELD, truth, 9, (3,))
    tdoa[1, 4, 2] = np.nan
    for weights in ("full", "diagonal"):
        stage = SequenceFilter(stations, toa_sigma=SIGMA, weights=weights)  # type: ignore[arg-type]
        found = stage.run(np.arange(12.0), tdoa)
        sigma = {"toa_sigma": SIGMA} if weights == "full" else {"tdoa_sigma": SIGMA}
        used = np.where(found.measured, found.coloured_tdoa, np.nan)
        for values, positions in ((used, found.position), (tdoa, found.raw_position)):
            fix = locate.gauss_newton(stations, values, pairs="adjacent", **sigma)
            assert_allclose(positions, fix.position, atol=1e-5)
        if weights == "full":  # at the first epoch nothing is filtered yet
            assert_allclose(found.covariance[:, 0], fix.covariance[:, 0], rtol=1e-4)


def test_covariance_of_a_running_mean_is_that_of_the_fixes() -> None:
    """400 runs of a target that stands, Q = 0: the covariance is what the positions have."""
    tdoa = differences(FIELD, np.broadcast_to(PLACE, (25, 2)), 11, (400,))
    for weights in ("full", "diagonal"):
        stage = SequenceFilter(
            Stations(FIELD),
            toa_sigma=SIGMA,
            multiplier=0.0,
            gate=None,
            weights=weights,  # type: ignore[arg-type]
        )
        found = stage.run(np.arange(25.0), tdoa)
        error = found.position[:, -1] - PLACE
        nees = np.einsum("ri,rij,rj->r", error, np.linalg.inv(found.covariance[:, -1]), error)
        assert abs(nees.mean() - 2.0) < 4.0 * 2.0 / np.sqrt(400.0)


def test_lazy_and_public() -> None:
    assert imm_tdoa.SequenceFilter is SequenceFilter
    assert "SequenceFilter" in imm_tdoa.__all__
