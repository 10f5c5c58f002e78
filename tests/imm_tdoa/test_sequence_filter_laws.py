"""The sequence filter's laws, and what it makes of gaps, leaps and moving stations."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sequence_cases import FIELD, PLACE, SIGMA, C, course, differences

from imm_tdoa import SequenceFilter, Stations, locate
from imm_tdoa.contract import Array
from imm_tdoa.sequence_filter import FilteredSequence

seeds = st.integers(0, 2**31)


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
