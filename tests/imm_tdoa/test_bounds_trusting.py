"""What trusting the receivers costs: against the formula written out, and against simulation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imm_tdoa import Stations, bounds
from imm_tdoa.locate import gauss_newton

PLACES = np.array([(0, 0), (1000, 0), (0, 1200), (-900, -700), (800, -1000)], float)
DRIFT = np.array([(10, 0), (0, -5), (3, 3), (-8, 2), (1, 1)], float)
AT, GOING = np.array([400.0, 300.0]), np.array([12.0, -7.0])
VARIANCE = np.array([1.0, 4.0, 9.0, 2.0, 5.0])


def rows(p, v, s, vs):
    away = p - s
    r = np.linalg.norm(away, axis=-1)
    rate = np.sum(away * (v - vs), axis=-1) / r
    return np.concatenate([r[1:] - r[0], rate[1:] - rate[0]])


def derivative(function, x, step=1e-4):
    columns = []
    for i in range(x.size):
        h = np.zeros(x.size)
        h[i] = step
        up, down = (function((x.ravel() + sign * h).reshape(x.shape)) for sign in (1, -1))
        columns.append((up - down) / (2 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("moving", [False, True])
def test_it_is_the_formula(moving):
    """C_0 + T Q_p T' + T_v Q_v T_v', Jacobians by differences (§3.6)."""
    Q, Qv = VARIANCE[:, None, None] * np.eye(2), 0.04 * VARIANCE[:, None, None] * np.eye(2)
    stations = Stations(PLACES, velocities=DRIFT, position_covariance=Q, velocity_covariance=Qv)
    n = 4 if moving else 2
    m = 8 if moving else 4
    x = np.concatenate([AT, GOING])
    J = derivative(lambda y: rows(y[:2], y[2:], PLACES, DRIFT), x)[:m, :n]
    Jp = derivative(lambda s: rows(AT, GOING, s, DRIFT), PLACES)[:m]
    Jv = derivative(lambda w: rows(AT, GOING, PLACES, w), DRIFT)[:m]
    R = np.zeros((8, 8))
    R[:4, :4], R[4:, 4:] = 0.25 * (np.eye(4) + 1.0), 0.01 * (np.eye(4) + 1.0)
    R = R[:m, :m]
    C0 = np.linalg.inv(J.T @ np.linalg.solve(R, J))
    T, Tv = C0 @ J.T @ np.linalg.solve(R, Jp), C0 @ J.T @ np.linalg.solve(R, Jv)
    Qp, Qw = np.diag(np.repeat(VARIANCE, 2)), np.diag(0.04 * np.repeat(VARIANCE, 2))
    more = {"velocity": GOING, "range_rate_sigma": 0.1} if moving else {}
    found = bounds.trusting_mse(stations, AT, toa_sigma=0.5, speed=1.0, **more)
    assert_allclose(found, C0 + T @ Qp @ T.T + Tv @ Qw @ Tv.T, rtol=1e-6)
    bound = bounds.crlb(stations, AT, toa_sigma=0.5, speed=1.0, **more)
    assert np.linalg.eigvalsh(found - bound)[0] > -1e-9 * np.trace(bound)


def test_simulated_fixes_that_trust_the_receivers_err_so_much():
    """3000 fixes, each with other receiver errors: the mean square within 5 standard errors."""
    rng = np.random.default_rng(3)
    stations = Stations(PLACES, position_covariance=VARIANCE[:, None, None] * np.eye(2))
    true = PLACES - np.sqrt(VARIANCE)[:, None] * rng.normal(size=(3000, 5, 2))
    r = np.linalg.norm(AT - true, axis=-1) + 0.5 * rng.normal(size=(3000, 5))
    z = r[:, 1:] - r[:, :1]
    fix = gauss_newton(Stations(PLACES), z, toa_sigma=0.5, speed=1.0, initial=AT)
    squares = np.sum((fix.position - AT) ** 2, axis=-1)
    expected = np.trace(bounds.trusting_mse(stations, AT, toa_sigma=0.5, speed=1.0))
    assert_allclose(squares.mean(), expected, atol=5.0 * squares.std() / np.sqrt(3000))


def test_pairs_that_close_loops_and_batches():
    stations = Stations(PLACES, position_covariance=VARIANCE[:, None, None] * np.eye(2))
    every = np.array([(i, j) for i in range(5) for j in range(i)])
    points = np.array([AT, AT + 50.0])
    base = bounds.trusting_mse(stations, points, toa_sigma=0.5, speed=1.0)
    assert base.shape == (2, 2, 2)
    loops = bounds.trusting_mse(stations, points, toa_sigma=0.5, speed=1.0, pairs=every)
    assert_allclose(loops, base, rtol=1e-9)


def test_stations_that_declare_nothing_are_refused():
    with pytest.raises(ValueError, match="stations: expected a position_covariance"):
        bounds.trusting_mse(Stations(PLACES), AT, toa_sigma=1.0)
    stations = Stations(PLACES, position_covariance=VARIANCE[:, None, None] * np.eye(2))
    with pytest.raises(ValueError, match="velocity: give velocity and"):
        bounds.trusting_mse(stations, AT, toa_sigma=1.0, velocity=GOING)
