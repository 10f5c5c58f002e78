"""Whose message is whose: against every pair of target and message tried one by one."""

from __future__ import annotations

from itertools import permutations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares
from scipy.stats import chi2
from tracker_cases import BANK, PLACES, RING, SPEED, SPEEDS

from imm_tdoa import IMM, Stations, Tracker
from imm_tdoa.models import TOA, Height, Stack
from imm_tdoa.tracking import Scan, Unlabelled
from imm_tdoa.tracking.batches import select, whole
from imm_tdoa.tracking.bending import arrived, possible
from imm_tdoa.tracking.memory import Memory
from imm_tdoa.tracking.messages import choose, locate
from imm_tdoa.tracking.strangers import log_density

ARRIVALS = TOA(RING, sigma=70e-9)
NOISE = 70e-9 * SPEED
GATE, REGION = 0.9999, 25.0


def scene(seed, update):
    """Three targets, one of them hardly known; messages of two of them and of a stranger."""
    rng = np.random.default_rng(seed)
    imm = IMM(BANK, ARRIVALS, update=update)
    std = np.array([50.0, 200.0, 500.0])[:, None, None]
    off = rng.normal(size=(3, 2)) * std[:, 0]
    mean = np.concatenate([PLACES[:3] + off, SPEEDS[:3], np.zeros((3, 2))], axis=1)
    cov = np.zeros((3, 6, 6))
    cov[:, :2, :2] = std**2 * np.eye(2)
    cov[:, 2:4, 2:4], cov[:, 4:, 4:] = 100.0 * np.eye(2), np.eye(2)
    state = whole(imm.start(np.zeros(3), mean, cov))
    sent = PLACES[[2, 0, 3]]
    values = ARRIVALS.predict(sent, np.zeros_like(sent), 0.0) + rng.normal(size=(3, 7)) * 20.0
    values += rng.uniform(0.0, 1e4, (3, 1))  # nobody knows when they were sent
    emission = np.repeat(np.arange(3), 7)
    return imm, state, Unlabelled(values.ravel(), np.tile(np.arange(7), 3), emission=emission)


def least_misfit(state, n, z):
    """Least misfit to target n's position and a message, over all places and emission times."""
    x, root = state.mean[n, :2], np.linalg.inv(np.linalg.cholesky(state.covariance[n, :2, :2]))

    def off(theta):
        h = np.linalg.norm(theta[:2] * 1e3 - RING.positions, axis=-1) + theta[2] * 1e3
        return np.concatenate([(z * SPEED - h) / NOISE, root @ (theta[:2] * 1e3 - x)])

    best = None
    for start in (x, *(x + 6e3 * np.array(s) for s in ((1, 1), (1, -1), (-1, 1), (-1, -1)))):
        offset = np.mean(z * SPEED - np.linalg.norm(start - RING.positions, axis=-1))
        found = least_squares(off, np.append(start, offset) / 1e3, xtol=1e-12, ftol=1e-14)
        if best is None or found.cost < best.cost:
            best = found
    return 2.0 * best.cost, best.x[:2] * 1e3


def vague(count, seed, std=8e3):
    """Targets known to 8 km, and a message of each: where they are follows the prediction."""
    rng = np.random.default_rng(seed)
    imm = IMM(BANK, ARRIVALS, update="iekf")
    x = PLACES[rng.integers(0, 4, count)]
    mean = np.concatenate([x, np.zeros((count, 4))], axis=1)
    cov = np.zeros((count, 6, 6))
    cov[:, :2, :2] = std**2 * np.eye(2)
    cov[:, 2:4, 2:4], cov[:, 4:, 4:] = 100.0 * np.eye(2), np.eye(2)
    state = whole(imm.start(np.zeros(count), mean, cov))
    sent = x + std * rng.normal(size=(count, 2))
    values = ARRIVALS.predict(sent, np.zeros_like(sent), 0.0) + rng.normal(size=(count, 7)) * NOISE
    return imm, state, (values + rng.uniform(0.0, 1e4, (count, 1))) / SPEED


@pytest.mark.parametrize("update", ["ekf", "iekf"])
@pytest.mark.parametrize("seed", range(3))
def test_the_likeliest_pairs_within_the_gate(seed, update):
    """Pairs that cannot pass the gate are not tried: with them the answer is the same."""
    imm, state, scan = scene(seed, update)
    got = choose(imm, ARRIVALS, state, scan, GATE, REGION, exclusive=True)
    z = scan.values.reshape(3, 7) / SPEED
    imm = IMM(BANK, ARRIVALS, update="iekf")  # an extended filter iterates here too
    after = [[imm.step(select(state, [n]), 0.0, z[[e]]) for e in range(3)] for n in range(3)]
    gate = chi2.ppf(GATE, 6)  # seven arrivals, one unknown emission time
    misfit = np.array([[least_misfit(state, n, z[e])[0] for e in range(3)] for n in range(3)])
    cost = np.array([[-2.0 * a.log_likelihood[0] for a in row] for row in after])
    cost = np.where(misfit <= gate, cost, np.inf)
    best = None
    for order in permutations([0, 1, 2, -1, -1, -1], 3):
        pairs = [(n, e) for n, e in enumerate(order) if e >= 0]
        total = sum(cost[n, e] for n, e in pairs)
        key = (-len(pairs), total)
        if np.isfinite(total) and (best is None or key < best[0]):
            best = key, order
    expected = np.full((3, 7), -1)
    for n, e in enumerate(best[1]):
        if e >= 0:
            expected[n] = 7 * e + np.arange(7)
            assert_allclose(got.state.mean[n], after[n][e].mean[0], rtol=1e-9, atol=1e-6)
        else:
            assert_array_equal(got.state.mean[n], state.mean[n])
    assert_array_equal(got.members, expected)
    assert_array_equal(expected[:, 0], [7, -1, 0])


def test_without_messages_nothing_changes():
    imm, state, scan = scene(0, "iekf")
    nothing = Unlabelled(scan.values * np.nan, scan.row, emission=scan.emission)
    got = choose(imm, ARRIVALS, state, nothing, GATE, REGION, exclusive=True)
    assert np.all(got.members == -1)
    assert_array_equal(got.state.mean, state.mean)


def test_the_contradiction_is_the_least_misfit_of_message_and_prediction():
    imm, state, z = vague(12, 1)
    after = whole(imm.step(state, state.time, z))
    expected = [least_misfit(state, n, z[n])[0] for n in range(12)]
    got = arrived(ARRIVALS, state, after, z).taken.nis
    assert_allclose(got, expected, rtol=1e-4)
    assert np.median(after.taken.nis / expected) > 10.0  # linearised at the prediction


def test_where_the_measurement_is_straight_nothing_changes():
    imm, state, z = vague(12, 2, std=30.0)
    after = whole(imm.step(state, state.time, z))
    # over 30 m ranges from 5 km and more bend by 0.1 m at most, 1/200 of their noise
    assert_allclose(arrived(ARRIVALS, state, after, z).taken.nis, after.taken.nis, rtol=0.05)


def test_a_vague_target_passes_its_own_message_as_often_as_the_gate_says():
    count = 400
    imm, state, z = vague(count, 3)
    after = whole(imm.step(state, state.time, z))
    nis = arrived(ARRIVALS, state, after, z).taken.nis
    # seven arrivals less one emission time: chi-square of 6, whose mean has this deviation
    assert abs(np.mean(nis) - 6.0) < 4.0 * np.sqrt(2.0 * 6.0 / count)
    limit = chi2.ppf(GATE, 6)
    assert np.count_nonzero(nis > limit) <= 2  # more than 2 of 400: once in 10^5
    assert np.mean(after.taken.nis > limit) > 0.5
    assert possible(ARRIVALS, state, z, GATE)[nis <= limit].all()


@pytest.mark.parametrize("std", [30.0, 1e3, 8e3])
def test_nothing_within_the_gate_is_called_impossible(std):
    imm, state, z = vague(300, 4, std)
    z = z[np.random.default_rng(5).permutation(300)]  # mostly another's
    after = whole(imm.step(state, state.time, z))
    within = arrived(ARRIVALS, state, after, z).taken.nis <= chi2.ppf(GATE, 6)
    assert possible(ARRIVALS, state, z, GATE)[within].all()
    if std < 1e3:
        assert np.mean(possible(ARRIVALS, state, z, GATE)) < 0.5  # four places


@pytest.mark.parametrize("update", ["ekf", "iekf"])
def test_a_vague_target_takes_its_message_where_strangers_are_few(update):
    imm, state, z = vague(20, 6)
    once = attrs.evolve(imm, update="ekf").step(state, state.time, z).taken.nis
    # the least far off of those that a gate refuses which is linearised at the prediction
    away = np.linalg.norm(imm.step(state, state.time, z).mean - state.mean, axis=-1)
    own = np.argmin(np.where(once > chi2.ppf(GATE, 6), away, np.inf))
    assert once[own] > chi2.ppf(GATE, 6)
    assert away[own] < 16e3
    state, z = select(state, [own]), z[[own]]
    imm = attrs.evolve(imm, update=update)
    scan = Unlabelled(z[0] * SPEED, np.arange(7), emission=np.zeros(7, dtype=np.int64))
    misfit, place = least_misfit(state, 0, z[0])
    assert misfit < chi2.ppf(GATE, 6)
    few, many = np.log(1.0 / (400e3) ** 2), np.log(1.0 / (8e3) ** 2)
    got = choose(imm, ARRIVALS, state, scan, GATE, REGION, few, exclusive=True)
    assert_array_equal(got.members, [np.arange(7)])
    assert_allclose(got.state.mean[0, :2], place, atol=1.0)
    assert_allclose(got.state.taken.nis, misfit, rtol=1e-4)
    got = choose(imm, ARRIVALS, state, scan, GATE, REGION, many, exclusive=True)
    assert_array_equal(got.members, [np.full(7, -1)])
    assert_array_equal(got.state.mean, state.mean)


def test_strangers_are_as_dense_as_remembered_fixes():
    rng = np.random.default_rng(8)
    none = Memory.none(2, 7)
    apart = np.sqrt(np.mean(np.sum(RING.positions**2, axis=-1)))  # the ring's centre is 0
    region = np.log(2.0 * np.pi * apart**2)
    assert log_density(ARRIVALS, none, 0.0) == pytest.approx(-region)

    def seen(places):
        return attrs.evolve(none, strangers=places)

    two = seen(PLACES[:2])
    assert log_density(ARRIVALS, two, 0.0) == pytest.approx(np.log(2.0) - region)
    places = rng.normal(size=(4000, 2)) * [20e3, 5e3] + [3e3, 1e3]
    places[:40] += 1e7  # wild fixes say nothing of the others
    expected = np.log(4000.0) - np.log(2.0 * np.pi * 20e3 * 5e3)
    # the median deviation of n normal values errs by 1.17/sqrt(n), 1 % wild ones by 2 %
    assert abs(log_density(ARRIVALS, seen(places), 0.0) - expected) < 4 * 1.17 * 0.0224 + 0.04


def test_a_message_at_too_few_stations_begins_no_track_and_is_counted():
    rng = np.random.default_rng(9)

    def message(k, target, heard):
        place = PLACES[target] + SPEEDS[target] * 2.0 * k
        seen = ARRIVALS.predict(place, np.zeros(2), 0.0) + NOISE * rng.normal(size=7)
        emission = np.zeros(len(heard), dtype=np.int64)
        return Scan(2.0 * k, seen[heard] / SPEED, np.array(heard), emission=emission, sweep=False)

    tracker = Tracker(BANK, ARRIVALS)
    for k in range(12):
        tracker.step(message(k, 0, [0, 1, 2, 3, 4]))
        tracks = tracker.step(message(k, 1, [1, 2]))  # two dimensions and a time need three
    assert tracks.names == ("1",)
    assert tracks.ignored == {"messages at too few stations to begin a track": 12}
    before = tracks.lives["1"].rows
    tracks = tracker.step(message(12, 0, [3, 4]))  # fits the track
    assert tracks.lives["1"].rows == before + 2
    assert tracks.ignored == {"messages at too few stations to begin a track": 12}


def test_a_height_stands_in_for_a_station():
    stations = Stations(np.concatenate([RING.positions, np.zeros((7, 1))], axis=1))
    both = Stack(TOA(stations, sigma=70e-9), Height(sigma=10.0))
    members = np.full((4, 8), -1)
    members[0, :4] = members[1, :3] = members[2, [0, 1, 2, 7]] = members[3, [0, 1, 7]] = 0
    assert_array_equal(locate(both, members), [True, False, True, False])


def test_a_station_that_is_nowhere_rules_nothing_out():
    _, state, z = vague(20, 10)
    places = np.stack([RING.positions, RING.positions])
    places[:, 3] = np.nan
    stations = Stations(places, times=np.array([-10.0, 10.0]))
    arrivals = TOA(stations, sigma=70e-9)
    state = whole(IMM(BANK, arrivals).start(np.zeros(20), state.mean, state.covariance))
    assert possible(arrivals, state, z, GATE).all()
