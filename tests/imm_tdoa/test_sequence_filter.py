"""Filtering sequences of time differences: against closed forms, a plain loop, and its own laws."""

from __future__ import annotations

import pickle
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import imm_tdoa
from imm_tdoa import IMM, Bank, SequenceFilter, Stations, locate
from imm_tdoa.contract import Array
from imm_tdoa.models import TDOA, ConstantVelocity, Static
from imm_tdoa.sequence_filter import FilteredSequence, kappa, scalar, steady_gain, steady_lag
from imm_tdoa.sequence_filter.loop_gain import increment_factor, process_noise

C = 299_792_458.0
SIGMA = 3e-9
PLACE = np.array([350.0, -350.0])
FIELD = np.array([[2e3, 100.0], [900.0, 1.8e3], [-1.1e3, 1.6e3], [-1.9e3, -200.0], [300.0, -2e3]])
seeds = st.integers(0, 2**31)


def ring(count: int = 6) -> Stations:
    angle = 2.0 * np.pi * np.arange(count) / count
    return Stations(2000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def differences(
    positions: Array, truth: Array, seed: int, runs: tuple[int, ...] = (), sigma: float = SIGMA
) -> Array:
    """Adjacent differences (*runs, T, S - 1), s; positions of stations (S, d) or (T, S, d)."""
    distance = np.linalg.norm(truth[:, None] - positions, axis=-1)
    noise = np.random.default_rng(seed).normal(0.0, sigma, (*runs, *distance.shape))
    arrival = distance / C + noise
    return arrival[..., :-1] - arrival[..., 1:]


def course(T: int, speed: float = 4.0) -> Array:
    return PLACE + speed * np.arange(float(T))[:, None] * np.array([0.6, 0.8])


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


@settings(deadline=None, max_examples=10)
@given(seed=seeds, auto=st.booleans(), rule=st.sampled_from(["iso", "proj", "bound"]))
def test_a_batch_is_its_runs(seed: int, auto: bool, rule: Any) -> None:
    rng = np.random.default_rng(seed)
    tdoa = differences(FIELD, course(8), seed, (2, 2))
    tdoa[rng.random(tdoa.shape) < 0.1] = np.nan
    stage = SequenceFilter(
        Stations(FIELD), toa_sigma=SIGMA, rule=rule, multiplier="auto" if auto else 1.0
    )
    times = np.arange(8.0)
    found = stage.run(times, tdoa)
    one, swapped = stage.run(times, tdoa[1, 0]), stage.run(times, tdoa[::-1])
    for field in attrs.fields(FilteredSequence):
        name = field.name
        if name in ("times", "_measurement"):
            continue
        value = getattr(found, name)
        scale = 1e-9 if "tdoa" in name else 1e-18 if name in ("variance", "process_noise") else 1.0
        assert_allclose(getattr(one, name), value[1, 0], atol=1e-5 * scale, err_msg=name)
        assert_allclose(getattr(swapped, name), value[::-1], atol=1e-5 * scale, err_msg=name)
    same = stage.run(np.broadcast_to(times, (2, 2, 8)), tdoa)
    assert_allclose(same.position, found.position, atol=1e-6)


@settings(deadline=None, max_examples=10)
@given(
    seed=seeds,
    angle=st.floats(0.0, 6.0),
    shift=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
)
def test_moved_turned_and_reversed(seed: int, angle: float, shift: tuple[float, float]) -> None:
    """Positions go where the stations go; the order of stations may be turned about."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    tdoa = differences(FIELD, course(8), seed)
    times = np.arange(8.0)
    found = SequenceFilter(Stations(FIELD), toa_sigma=SIGMA).run(times, tdoa)
    moved = SequenceFilter(Stations(FIELD @ turn.T + shift), toa_sigma=SIGMA).run(times, tdoa)
    assert_allclose(moved.position, found.position @ turn.T + shift, atol=1e-4)
    back = SequenceFilter(Stations(FIELD[::-1]), toa_sigma=SIGMA).run(times, -tdoa[:, ::-1])
    assert_allclose(back.position, found.position, atol=1e-4)
    assert_allclose(back.gain, found.gain[:, ::-1], atol=1e-6)


@settings(deadline=None, max_examples=10)
@given(seed=seeds, length=st.floats(1e-3, 1e3), clock=st.floats(1e-3, 1e3))
def test_units(seed: int, length: float, clock: float) -> None:
    """Lengths in other units, times in others again: the same positions, gains and gates."""
    tdoa = differences(FIELD, course(8), seed)
    times = np.arange(8.0)
    plain = SequenceFilter(Stations(FIELD), toa_sigma=SIGMA, floor=1e-11).run(times, tdoa)
    other = SequenceFilter(
        Stations(FIELD * length),
        toa_sigma=SIGMA * clock,
        floor=1e-11 * clock,
        speed=C * length / clock,
    ).run(times, tdoa * clock)
    assert_allclose(other.position, plain.position * length, rtol=1e-6, atol=1e-5 * length)
    assert_allclose(other.gain, plain.gain, rtol=1e-5, atol=1e-9)
    assert_allclose(other.variance, plain.variance * clock**2, rtol=1e-5)
    assert_array_equal(other.gated, plain.gated)


def test_what_is_missing_is_only_predicted() -> None:
    tdoa = differences(FIELD, course(10, 0.0), 6)
    tdoa[5] = np.nan
    tdoa[7, 0] = np.nan
    stage = SequenceFilter(Stations(FIELD), toa_sigma=SIGMA)
    found = stage.run(np.arange(10.0), tdoa)
    assert_array_equal(found.coloured_tdoa[5], found.coloured_tdoa[4])
    assert_allclose(found.variance[5], found.variance[4] + found.process_noise[4], rtol=1e-12)
    assert_array_equal(found.process_noise[5], found.process_noise[4])
    assert_array_equal(found.gain[5], 0.0)
    assert np.isnan(found.position[5]).all()
    assert np.isnan(found.covariance[5]).all()
    assert np.isnan(found.raw_position[5]).all()
    assert found.coloured_tdoa[7, 0] == found.coloured_tdoa[6, 0]
    assert np.isfinite(found.position[7]).all()
    assert not np.any(found.gated[5])
    nothing = stage.run(np.arange(3.0), np.full((3, 4), np.nan))
    assert np.isnan(nothing.position).all()
    assert np.isnan(nothing.coloured_tdoa).all()


@pytest.mark.parametrize("test", ["posterior", "innovation"])
def test_the_gate_when_the_target_leaps(test: Any) -> None:
    truth = np.concatenate([course(30, 0.0), course(10, 0.0) + 50.0])
    tdoa = differences(FIELD, truth, 8, (10,))
    times, stations = np.arange(40.0), Stations(FIELD)

    def error(**arguments: Any) -> tuple[Array, FilteredSequence]:
        found = SequenceFilter(stations, toa_sigma=SIGMA, test=test, **arguments).run(times, tdoa)
        return np.linalg.norm(found.position - truth, axis=-1).max(axis=0), found

    gated, found = error()
    assert np.all(gated[30:] < 8.0)
    assert np.all(found.gated[:, 30].any(axis=-1))
    assert_allclose(found.coloured_tdoa[found.gated], tdoa[found.gated], rtol=1e-14)
    seconds = 3.0 * np.sqrt(2.0) * SIGMA
    if test == "posterior":
        assert_array_equal(error(gate_s=seconds)[1].gated, found.gated)
    else:
        assert np.all(error(gate_s=seconds)[1].gated >= found.gated)
    loose, open_ = error(gate_s=1.0), error(gate=None)
    assert not np.any(loose[1].gated)
    assert_array_equal(loose[1].position, open_[1].position)
    assert open_[0][30] > 40.0
    assert error(multiplier=0.0, gate=None)[0][39] > 30.0
    _, anew = error(multiplier=0.0, reset_on_gate=True)
    assert_allclose(anew.variance[anew.gated], 2.0 * SIGMA**2, rtol=1e-12)


def test_stations_that_move() -> None:
    """A target that stands, stations that do not: nothing lags, because the prediction follows."""
    T = 40
    times = np.arange(float(T))
    speed = np.random.default_rng(2).normal(0.0, 40.0, FIELD.shape)
    path = FIELD + times[:, None, None] * speed
    stations = Stations(path, times=times)
    exact = differences(path, np.broadcast_to(PLACE, (T, 2)), 0, sigma=0.0)
    stage = SequenceFilter(stations, toa_sigma=SIGMA, multiplier=0.0, gate=None)
    found = stage.run(times, exact)
    assert_allclose(C * found.coloured_tdoa, C * exact, atol=1e-6)
    assert_allclose(found.position, np.broadcast_to(PLACE, (T, 2)), atol=1e-6)
    noisy = differences(path, np.broadcast_to(PLACE, (T, 2)), 3, (200,))
    found = stage.run(times, noisy)
    size = [
        np.sqrt(np.mean(np.sum((p[:, -1] - PLACE) ** 2, axis=-1)))
        for p in (found.position, found.raw_position)
    ]
    assert size[0] < 0.3 * size[1]  # 1/sqrt(40) where the geometry stays the same
    gone = path.copy()
    gone[20:, 4] = np.nan
    found = SequenceFilter(Stations(gone, times=times), toa_sigma=SIGMA).run(times, exact)
    assert not np.any(found.measured[20:, 3])
    assert_allclose(found.position[30], PLACE, atol=1e-3)


def test_receiver_errors_weigh_but_do_not_filter() -> None:
    """They last: R of the scalar filters leaves them out, the fix does not."""
    truth = course(6)
    tdoa = differences(FIELD, truth, 5)
    some = np.zeros((5, 2, 2))
    some[0] = 25.0 * np.eye(2)
    stations = Stations(FIELD, position_covariance=some)
    found = SequenceFilter(stations, toa_sigma=SIGMA).run(np.arange(6.0), tdoa)
    plain = SequenceFilter(Stations(FIELD), toa_sigma=SIGMA).run(np.arange(6.0), tdoa)
    assert_array_equal(found.variance[0], plain.variance[0])
    fix = locate.gauss_newton(stations, found.coloured_tdoa, pairs="adjacent", toa_sigma=SIGMA)
    assert_allclose(found.position, fix.position, atol=1e-5)
    assert np.max(np.abs(found.position - plain.position)) > 1e-3


def test_ways_to_give_the_noise() -> None:
    times, tdoa = np.arange(8.0), differences(FIELD, course(8), 4)
    stations = Stations(FIELD)

    def gains(**noise: Any) -> Array:
        return SequenceFilter(stations, **noise).run(times, tdoa).gain

    usual = gains(toa_sigma=SIGMA)
    assert_allclose(gains(tick=SIGMA * np.sqrt(12.0)), usual, rtol=1e-9)
    assert_allclose(gains(tick=SIGMA * np.sqrt(24.0), r_factor=1.0 / 12.0), usual, rtol=1e-9)
    assert_allclose(gains(tick=SIGMA * np.sqrt(6.0), r_factor=1.0 / 3.0), usual, rtol=1e-9)
    assert_allclose(gains(toa_sigma=np.full(5, SIGMA)), usual, rtol=1e-9)
    sampled = np.full((8, 5), SIGMA)
    assert_allclose(gains(toa_sigma=sampled, sigma_times=times), usual, rtol=1e-9)
    each = np.sqrt(2.0) * SIGMA
    own = gains(tdoa_sigma=each)
    assert_allclose(gains(tdoa_sigma=np.full(4, each)), own, rtol=1e-9)
    equal = SequenceFilter(stations, toa_sigma=SIGMA, weights="diagonal").run(times, tdoa)
    assert_allclose(own, equal.gain, rtol=1e-6)  # the same weights; only the covariance differs


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


def test_coloured_output_is_no_measurement() -> None:
    times, tdoa = np.arange(8.0), differences(FIELD, course(8), 4)
    tdoa[3, 1] = np.nan
    stations = Stations(FIELD)
    found = SequenceFilter(stations, toa_sigma=SIGMA).run(times, tdoa)
    for name in ("values", "tdoa", "measurements"):
        with pytest.raises(AttributeError, match="coloured"):
            getattr(found, name)
    with pytest.raises(AttributeError, match="no attribute 'speed'"):
        found.speed  # noqa: B018
    assert repr(found) == (
        "FilteredSequence(8 epochs, 4 differences; coloured, no measurements for a tracker)"
    )
    measurement = TDOA(stations, toa_sigma=SIGMA, pairs="adjacent")
    imm = IMM(Bank([Static(psd=0.0), ConstantVelocity(psd=1.0)], mean_sojourn=60.0), measurement)
    with pytest.raises(
        ValueError, match=r"values: expected numbers, got FilteredSequence.*coloured"
    ):
        imm.run(times, found)
    with pytest.warns(UserWarning, match="coloured"):
        model, stamps, values, pairs = found.scans()
    assert pairs is None
    assert_array_equal(stamps, times)
    assert_array_equal(np.isnan(values), np.isnan(tdoa))
    assert_array_equal(values[0], tdoa[0])
    R = model.noise_covariance(PLACE, 0.0 * PLACE, 0.0)
    assert_allclose(R, measurement.noise_covariance(PLACE, 0.0 * PLACE, 0.0))
    assert_array_equal(pickle.loads(pickle.dumps(found)).position, found.position)
    assert "3 runs" not in repr(found)
    many = SequenceFilter(stations, toa_sigma=SIGMA).run(times, np.stack([tdoa] * 3))
    assert "3 runs, 8 epochs" in repr(many)


def test_raw_noise_is_what_filtered_values_are_worth() -> None:
    """`scans` keeps R: of a smoother with gain K, K/(2-K) R times (2-K)/K for the correlation.

    The mean of many filtered values then has the variance that a tracker takes it to have.
    """
    K, T, runs = 0.2, 400, 4000
    z = np.random.default_rng(5).standard_normal((runs, T))
    x = np.zeros((runs, T))
    for k in range(1, T):
        x[:, k] = x[:, k - 1] + K * (z[:, k] - x[:, k - 1])
    last = x[:, 100:]
    assert_allclose(np.var(last), K / (2.0 - K), rtol=0.05)
    assert_allclose(np.var(last.mean(axis=1)) * 300, 1.0, atol=4.0 * np.sqrt(2.0 / runs))


def test_lazy_and_public() -> None:
    assert imm_tdoa.SequenceFilter is SequenceFilter
    assert "SequenceFilter" in imm_tdoa.__all__


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "sigma: give exactly one of tick, toa_sigma, tdoa_sigma, got none"),
        (
            {"tick": 1e-9, "toa_sigma": 1e-9},
            "sigma: give exactly one of tick, toa_sigma, tdoa_sigma, got tick, toa_sigma",
        ),
        ({"tick": 0.0}, "tick: expected a number above 0, got 0.0"),
        ({"tick": 1e-9, "r_factor": -1}, "r_factor: expected a number above 0, got -1"),
        ({"tick": 1e-9, "sigma_times": [0.0]}, "sigma_times: a clock tick does not change"),
        ({"toa_sigma": -1e-9}, "toa_sigma: expected standard deviations above 0"),
        ({"toa_sigma": [1e-9, 1e-9]}, "toa_sigma: expected one number or 5 of them, got (2,)"),
        ({"tick": 1e-9, "rule": "isotropic"}, "rule: expected one of 'iso', 'proj', 'bound', got"),
        ({"tick": 1e-9, "multiplier": -1.0}, "multiplier: expected a number of at least 0"),
        ({"tick": 1e-9, "multiplier": "much"}, "multiplier: expected one number, got 'much', or"),
        ({"tick": 1e-9, "floor": -1e-12}, "floor: expected a number of at least 0, got -1e-12"),
        ({"tick": 1e-9, "gate": 0.0}, "gate: expected a number above 0, got 0.0"),
        ({"tick": 1e-9, "gate_s": "x"}, "gate_s: expected one number, got 'x'"),
        ({"tick": 1e-9, "test": "prior"}, "test: expected one of 'posterior', 'innovation'"),
        ({"tick": 1e-9, "weights": "own"}, "weights: expected one of 'full', 'diagonal'"),
        ({"tick": 1e-9, "reset_on_gate": "no"}, "reset_on_gate: expected one of True, False"),
        ({"tick": 1e-9, "speed": 0.0}, "speed: expected a number above 0"),
    ],
)
def test_bad_settings(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        SequenceFilter(Stations(FIELD), **arguments)
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("stations", "message"),
    [
        (Stations(FIELD[:2]), "stations: expected at least 3 in 2 dimensions, got 2"),
        (Stations(np.eye(3)), "stations: expected at least 4 in 3 dimensions, got 3"),
        (FIELD, "stations: expected Stations, got array"),
    ],
)
def test_bad_stations(stations: Any, message: str) -> None:
    for make in (lambda: SequenceFilter(stations, tick=1e-9), lambda: kappa(stations, PLACE)):
        with pytest.raises(ValueError) as raised:
            make()
        assert str(raised.value).startswith(message)


@pytest.mark.parametrize(
    ("times", "tdoa", "message"),
    [
        ([0.0, 2.0, 1.0], np.zeros((3, 4)), "times: expected times that do not decrease"),
        ([0.0, np.nan, 1.0], np.zeros((3, 4)), "times: expected finite numbers"),
        ([], np.zeros((0, 4)), "times: expected at least one scan"),
        ([0.0, 1.0], np.zeros((3, 4)), "tdoa: expected shape (..., 2, 4), got (3, 4)"),
        ([0.0, 1.0], np.zeros((2, 5)), "tdoa: expected shape (..., 2, 4), got (2, 5)"),
        ([0.0, 1.0], np.full((2, 4), np.inf), "tdoa: infinite values are refused"),
        ([0.0, 1.0], "abc", "tdoa: expected numbers"),
    ],
)
def test_bad_sequences(times: Any, tdoa: Any, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        SequenceFilter(Stations(FIELD), tick=1e-9).run(times, tdoa)
    assert str(raised.value).startswith(message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rule": "any"}, "rule: expected one of"),
        ({"weights": "any"}, "weights: expected one of"),
        ({"multiplier": -0.5}, "multiplier: expected a number of at least 0"),
        ({"position": [1.0, 2.0, 3.0]}, "position: expected shape (..., 2,), got (3,)"),
        ({"position": [np.nan, 2.0]}, "position: expected finite numbers"),
    ],
)
def test_kappa_of_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        kappa(ring(), **{"position": PLACE, **arguments})
    assert str(raised.value).startswith(message)
