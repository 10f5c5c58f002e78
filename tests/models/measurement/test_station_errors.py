"""Receivers that are not where they say: R is H_s Q_s H_s' and the sensor's own (§1.4).

H_s is taken independently, by moving one coordinate of one station at a time.
"""

from __future__ import annotations

import attrs
import numpy as np
import pytest

from imm_tdoa import Stations
from imm_tdoa.models import FDOA, TDOA, TOA, RangeRate, Stack

C = 299792458.0
PLACES = np.array([[0.0, 0.0, 20.0], [9e3, 1e3, 60.0], [2e3, 8e3, 10.0], [-7e3, -5e3, 90.0]])
SPEEDS = np.array([[0.0, 0.0, 1.0], [30.0, 5.0, 0.0], [-20.0, 15.0, 2.0], [3.0, -40.0, 5.0]])
P = np.array([4e3, -6e3, 3e3])
V = np.array([120.0, 80.0, -5.0])


def unsure(*, position: bool = True, velocity: bool = True) -> Stations:
    """Four stations with full covariance blocks."""
    A = np.random.default_rng(3).normal(size=(2, 4, 3, 3))
    Q = A @ np.swapaxes(A, -1, -2)
    return Stations(
        PLACES,
        velocities=SPEEDS,
        position_covariance=100.0 * Q[0] if position else None,
        velocity_covariance=0.04 * Q[1] if velocity else None,
    )


def expected(model, build, stations, sensor):
    """sensor + sum over stations and coordinates, by central differences of `build(...)`."""
    R = np.array(sensor, dtype=float)
    for field, covariance, h in (
        ("positions", stations.position_covariance, 1.0),
        ("velocities", stations.velocity_covariance, 0.1),
    ):
        if covariance is None:
            continue
        for s in range(len(stations)):
            J = np.zeros((model.size, 3))
            for axis in range(3):
                ends = []
                for sign in (1.0, -1.0):
                    moved = np.array(getattr(stations, field))
                    moved[s, axis] += sign * h
                    there = build(attrs.evolve(stations, **{field: moved}))
                    ends.append(there.predict(P, V, 0.0))
                J[:, axis] = (ends[0] - ends[1]) / (2.0 * h)
            R += J @ covariance[s] @ J.T
    return R


def differences(sigma2):
    """Covariance of differences against station 0."""
    return np.diag(sigma2[1:]) + sigma2[0]


SIGMA = np.array([10.0, 20.0, 30.0, 40.0])  # m
RATE = np.array([0.1, 0.2, 0.3, 0.4])  # m/s
BUILD = {
    "tdoa": (lambda s: TDOA(s, toa_sigma=SIGMA / C), differences(SIGMA**2)),
    "tdoa independent": (lambda s: TDOA(s, tdoa_sigma=10.0 / C), 100.0 * np.eye(3)),
    "toa": (lambda s: TOA(s, sigma=SIGMA / C), np.diag(SIGMA**2)),
    "fdoa": (lambda s: FDOA(s, range_rate_sigma=RATE), differences(RATE**2)),
    "range rate": (lambda s: RangeRate(s, sigma=RATE), np.diag(RATE**2)),
}


def agree(R, reference):
    scale = np.sqrt(np.outer(np.diag(reference), np.diag(reference)))
    assert np.all(np.abs(R - reference) <= 1e-6 * scale)


@pytest.mark.parametrize("name", BUILD)
@pytest.mark.parametrize("which", [(True, True), (True, False), (False, True), (False, False)])
def test_one_model(name, which):
    build, sensor = BUILD[name]
    stations = unsure(position=which[0], velocity=which[1])
    model = build(stations)
    R = model.noise_covariance(P, V, 0.0)
    agree(R, expected(model, build, stations, sensor))
    if not any(which):
        np.testing.assert_allclose(R, sensor)


def both(first, second):
    """Builder and sensor covariance of two models of the same stations."""
    (one, a), (two, b) = BUILD[first], BUILD[second]
    zero = np.zeros((len(a), len(b)))
    return lambda s: (one(s), two(s)), np.block([[a, zero], [zero.T, b]])


@pytest.mark.parametrize("names", [("tdoa", "fdoa"), ("toa", "range rate"), ("fdoa", "tdoa")])
def test_a_stack_shares_the_errors_of_its_stations(names):
    pair, sensor = both(*names)

    def build(s):
        return Stack(*pair(s))

    stations = unsure()
    model = build(stations)
    R = model.noise_covariance(P, V, 0.0)
    reference = expected(model, build, stations, sensor)
    agree(R, reference)
    m = pair(stations)[0].size
    corner = np.abs(R[:m, m:]) / np.sqrt(np.outer(np.diag(R)[:m], np.diag(R)[m:]))
    assert corner.max() > 0.05  # the shared part is no trifle


def test_a_stack_within_a_stack_shares_them_too():
    stations = unsure()
    tdoa, fdoa, toa = (BUILD[name][0](stations) for name in ("tdoa", "fdoa", "toa"))
    nested = Stack(Stack(tdoa, fdoa), toa)
    flat = Stack(tdoa, fdoa, toa)
    assert nested.models == flat.models
    R = nested.noise_covariance(P, V, 0.0)
    np.testing.assert_array_equal(R, flat.noise_covariance(P, V, 0.0))
    assert np.any(R[:3, 6:] != 0.0)
    np.testing.assert_array_equal(nested.offset_group, [-1] * 6 + [0] * 4)


def test_other_stations_have_errors_of_their_own():
    """Two arrays, equal in value, are two arrays: their errors are independent."""
    one, two = unsure(), unsure()
    stack = Stack(BUILD["tdoa"][0](one), BUILD["fdoa"][0](two))
    R = stack.noise_covariance(P, V, 0.0)
    assert not np.any(R[:3, 3:])


def test_batches_of_emitters():
    stations = unsure()
    stack = Stack(BUILD["tdoa"][0](stations), BUILD["fdoa"][0](stations))
    p, v = np.stack([P, P + 500.0]), np.stack([V, -V])
    many = stack.noise_covariance(p, v, np.zeros(2))
    for i in range(2):
        np.testing.assert_allclose(many[i], stack.noise_covariance(p[i], v[i], 0.0), rtol=1e-12)


def test_stack_rows_groups_and_pairs():
    """Rows in the order of the models; offset groups kept apart; pairs handed out in order."""
    stations = unsure()
    toa, rate = BUILD["toa"][0](stations), BUILD["range rate"][0](stations)
    tdoa, fdoa = BUILD["tdoa"][0](stations), BUILD["fdoa"][0](stations)
    stack = Stack(toa, rate)
    assert stack.offset_group.tolist() == [0] * 4 + [1] * 4
    np.testing.assert_array_equal(
        stack.predict(P, V, 0.0), [*toa.predict(P, V, 0.0), *rate.predict(P, V, 0.0)]
    )
    np.testing.assert_array_equal(stack.scale, [C] * 4 + [1.0] * 4)
    other = Stack(tdoa, toa, fdoa).with_pairs([[0, 1], [2, 1], [3, 1], [1, 0], [2, 0], [3, 0]])
    assert other.models[0].pairs.tolist() == [[0, 1], [2, 1], [3, 1]]
    assert other.models[1] is toa
    assert other.models[2].pairs.tolist() == [[1, 0], [2, 0], [3, 0]]
    with pytest.raises(ValueError, match="pairs: expected 6 pairs for this stack, got 3"):
        Stack(tdoa, fdoa).with_pairs([[0, 1], [2, 1], [3, 1]])
