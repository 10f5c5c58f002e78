"""Cramér-Rao bounds and dilution of precision against published values and other derivations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imm_tdoa import Stations, bounds
from imm_tdoa.models import FDOA, TDOA, TOA, RangeRate, Stack

C = 299_792_458.0
SENSORS = np.array(
    [(0, 0), (-5, 8), (4, 6), (-2, 4), (7, 3), (-7, 5), (2, 5), (-4, 2), (3, 3), (1, 8)], float
)
LINE = np.array([(-(i - 1) if i % 2 else i, 0) for i in range(1, 11)], float)
HO_XU = np.array(
    [(300, 100, 150), (400, 150, 100), (300, 500, 200), (350, 200, 100), (-100, -100, -100)], float
)
HO_XU_VELOCITY = np.array(
    [(30, -20, 20), (-30, 10, 20), (10, -20, 10), (10, 20, 30), (-20, 10, 10)], float
)
FAR, NEAR = (2000.0, 2500.0, 3000.0), (600.0, 650.0, 550.0)
VELOCITY = (-20.0, 15.0, 40.0)


def as_printed(value, printed):
    """Whether `value` rounds to `printed`."""
    decimals = len(printed.partition(".")[2])
    assert_allclose(value, float(printed), rtol=0, atol=0.5 * 10.0**-decimals * (1 + 1e-9))


@pytest.mark.parametrize(
    ("array", "variance", "row"),
    [
        (SENSORS, 1e-3, "1.9794 .6884 .1451 .1334 .1143 .1054 .1032 .09432"),
        (LINE, 1e-4, "7.2819 1.1000 .3548 .1219 .06123 .02840 .01750 .009599"),
    ],
)
def test_the_bounds_of_chan_and_ho(array, variance, row):
    """Tables I and II of the 1994 paper (§12.1), to the printed digits, M = 3 … 10 stations."""
    for M, printed in zip(range(3, 11), row.split(), strict=True):
        C = bounds.crlb(
            Stations(array[:M]), [8.0, 22.0], toa_sigma=np.sqrt(variance / 2), speed=1.0
        )
        as_printed(np.trace(C), printed)


@pytest.mark.parametrize(
    ("source", "decibel", "position", "velocity"),
    [
        (FAR, -30, "25.941", "21.772"),
        (FAR, -20, "82.034", "68.849"),
        (FAR, -10, "259.41", "217.72"),
        (FAR, 0, "820.34", "688.49"),
        (NEAR, -30, ".7886", ".4093"),
        (NEAR, -20, "2.4937", "1.2945"),
        (NEAR, -10, "7.886", "4.093"),
        (NEAR, 0, "24.94", "12.94"),
    ],
)
def test_the_bounds_of_ho_and_xu(source, decibel, position, velocity):
    """Time and frequency differences (§12.2): variance sigma_d², its tenth for range rates.

    The near velocity at -10 dB, ten times that at -30 dB, is 4.0935 before rounding.
    """
    variance = 10.0 ** (decibel / 10.0)
    C = bounds.crlb(
        Stations(HO_XU, velocities=HO_XU_VELOCITY),
        source,
        toa_sigma=np.sqrt(variance / 2),
        velocity=VELOCITY,
        range_rate_sigma=np.sqrt(0.1 * variance / 2),
        speed=1.0,
    )
    as_printed(np.sqrt(np.trace(C[:3, :3])), position)
    as_printed(np.sqrt(np.trace(C[3:, 3:])), velocity)


@pytest.mark.parametrize("N", [3, 4, 6, 10])
@pytest.mark.parametrize("radius", [1.0, 5e4])
def test_a_uniform_angular_array_has_trace_four_sigma_squared_over_n(N, radius):
    """§3.6: equal arrival noise, stations evenly around the emitter; the least of all arrays."""
    angle = 0.3 + 2.0 * np.pi * np.arange(N) / N
    s = radius * np.column_stack([np.cos(angle), np.sin(angle)]) + [10.0, -7.0]
    C = bounds.crlb(Stations(s), [10.0, -7.0], toa_sigma=3.0, speed=1.0)
    assert_allclose(np.trace(C), 4.0 * 9.0 / N, rtol=1e-9)
    other = bounds.crlb(Stations(s * [1.0, 0.7]), [10.0, -7.0], toa_sigma=3.0, speed=1.0)
    assert np.trace(other) > 4.0 * 9.0 / N


SOLIDS = {
    "tetrahedron": [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)],
    "octahedron": [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)],
    "cube": [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)],
}


@pytest.mark.parametrize("solid", SOLIDS)
def test_a_balanced_array_in_space_has_trace_nine_sigma_squared_over_n(solid):
    corners = np.array(SOLIDS[solid], float)
    C = bounds.crlb(Stations(800.0 * corners), np.zeros(3), toa_sigma=2.0, speed=1.0)
    assert_allclose(np.trace(C), 9.0 * 4.0 / len(corners), rtol=1e-9)


def predicted(q, v, s, vs):
    """Range and range-rate differences against station 0, fit for complex-step derivatives."""
    r = np.sqrt(np.sum((q - s) ** 2, axis=-1))
    rate = np.sum((q - s) * (v - vs), axis=-1) / r
    return np.concatenate([r[1:] - r[0], rate[1:] - rate[0]])


def complex_step(f, x):
    """Exact Jacobian of f at x."""
    step = 1e-30
    columns = [f(x + 1j * step * e).imag / step for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("source", [FAR, NEAR])
@pytest.mark.parametrize("velocity_errors", [False, True])
def test_receiver_errors_are_what_joint_estimation_of_the_receivers_leaves(source, velocity_errors):
    """§3.5: the joint information of emitter and receivers, receivers eliminated by blocks."""
    rng = np.random.default_rng(3)
    K = len(HO_XU)

    def spread(scale):
        A = rng.normal(size=(K, 3, 3))
        return scale * (A @ A.swapaxes(-1, -2) + 0.1 * np.eye(3))

    Qp, Qv = spread(0.1), spread(0.01)
    stations = Stations(
        HO_XU,
        velocities=HO_XU_VELOCITY,
        position_covariance=Qp,
        velocity_covariance=Qv if velocity_errors else None,
    )
    variance = 1e-3
    C = bounds.crlb(
        stations,
        source,
        toa_sigma=np.sqrt(variance / 2),
        velocity=VELOCITY,
        range_rate_sigma=np.sqrt(0.1 * variance / 2),
        speed=1.0,
    )

    def h(x):
        q, v, s, vs = x[:3], x[3:6], x[6 : 6 + 3 * K], x[6 + 3 * K :]
        return predicted(q, v, s.reshape(K, 3), vs.reshape(K, 3))

    J = complex_step(h, np.concatenate([source, VELOCITY, HO_XU.ravel(), HO_XU_VELOCITY.ravel()]))
    D = 0.5 * variance * (np.eye(K - 1) + 1.0)
    Q = np.block([[D, np.zeros_like(D)], [np.zeros_like(D), 0.1 * D]])
    joint = J.T @ np.linalg.solve(Q, J)
    n = 6
    if not velocity_errors:
        joint = joint[: n + 3 * K, : n + 3 * K]
    for i in range(K):
        at = slice(n + 3 * i, n + 3 * i + 3)
        joint[at, at] += np.linalg.inv(Qp[i])
        if velocity_errors:
            at = slice(n + 3 * (K + i), n + 3 * (K + i) + 3)
            joint[at, at] += np.linalg.inv(Qv[i])
    schur = joint[:n, :n] - joint[:n, n:] @ np.linalg.solve(joint[n:, n:], joint[n:, :n])
    unit = np.sqrt(np.diag(C))
    assert_allclose(C @ schur, np.eye(n), atol=1e-8 * np.max(np.outer(unit, 1 / unit)))


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), dims=st.sampled_from([2, 3]))
def test_no_bound_depends_on_the_reference(seed, dims):
    rng = np.random.default_rng(seed)
    S = dims + 1 + int(rng.integers(0, 4))
    s = rng.uniform(-1e3, 1e3, (S, dims))
    p = rng.uniform(-3e3, 3e3, dims)
    sigma = rng.uniform(1e-8, 1e-7, S)
    u = (p - s) / np.linalg.norm(p - s, axis=-1, keepdims=True)
    w = 1.0 / (C * sigma) ** 2
    one = w @ u
    free = u.T @ (w[:, None] * u) - np.outer(one, one) / w.sum()  # §1.1, reference-free
    if np.linalg.cond(free) > 1e6:
        return
    order = rng.permutation(S)
    tree = np.array([[order[i], order[rng.integers(0, i)]] for i in range(1, S)])
    star = np.array([[i, S - 1] for i in range(S - 1)])
    for pairs in ("reference", "adjacent", star, tree, np.concatenate([star, tree])):
        bound = bounds.crlb(Stations(s), p, toa_sigma=sigma, pairs=pairs)
        assert_allclose(bound @ free, np.eye(dims), atol=1e-6)


def test_arrivals_and_their_differences_carry_the_same_information():
    stations = Stations(HO_XU, velocities=HO_XU_VELOCITY)
    p, v = np.array(NEAR), np.array(VELOCITY)
    differenced = Stack(TDOA(stations, toa_sigma=1e-9), FDOA(stations, range_rate_sigma=0.1))
    raw = Stack(TOA(stations, sigma=1e-9), RangeRate(stations, sigma=0.1))
    assert_allclose(
        bounds.fisher_information(differenced, p, v, 0.0),
        bounds.fisher_information(raw, p, v, 0.0),
        rtol=1e-9,
        atol=1e-9,
    )


def test_a_bound_for_independent_differences():
    p = np.array([300.0, 200.0])
    s = np.array([(0, 0), (900, 0), (0, 900), (800, 1000)], float)
    u = (p - s) / np.linalg.norm(p - s, axis=-1, keepdims=True)
    H = u[1:] - u[0]
    sigma = np.array([1.0, 2.0, 3.0])
    expected = np.linalg.inv(H.T @ np.diag(sigma**-2) @ H)
    assert_allclose(bounds.crlb(Stations(s), p, tdoa_sigma=sigma, speed=1.0), expected, rtol=1e-9)


def test_bounds_take_batches_and_moving_stations():
    s = np.array([(0, 0), (900, 0), (0, 900), (800, 1000)], float)
    drift = np.array([10.0, -5.0])
    moving = Stations(np.stack([s, s + 10.0 * drift]), times=[0.0, 10.0])
    p = np.array([[300.0, 200.0], [1500.0, 300.0]])
    batch = bounds.crlb(moving, p, toa_sigma=1e-9, time=4.0)
    for one, where in zip(batch, p, strict=True):
        fixed = bounds.crlb(Stations(s + 4.0 * drift), where, toa_sigma=1e-9)
        assert_allclose(one, fixed, rtol=1e-9)


def test_a_station_not_heard_is_left_out():
    s = np.array([(0, 0), (900, 0), (0, 900), (800, 1000), (-500, 300)], float)
    late = np.stack([s, s])
    late[0, 4] = np.nan
    stations = Stations(late, times=[0.0, 1.0])
    p = [300.0, 250.0]
    for time, kept in ((0.0, s[:4]), (1.0, s)):
        C = bounds.crlb(stations, p, toa_sigma=1e-9, time=time)
        assert_allclose(C, bounds.crlb(Stations(kept), p, toa_sigma=1e-9), rtol=1e-9)
        dilution = bounds.gdop(stations, p, time=time)
        assert_allclose(dilution, bounds.gdop(Stations(kept), p), rtol=1e-9)


@pytest.mark.parametrize(
    ("stations", "position"),
    [
        ([(0, 0), (1, 0), (3, 0)], (7.0, 0.0)),
        ([(0, 0), (1, 0), (3, 0), (9, 0)], (5.0, 0.0)),
        ([(0, 0), (1, 0)], (4.0, 5.0)),
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0), (5, 0, 0), (9, 0, 0)], (4.0, 5.0, 6.0)),
        ([(0, 0, 0), (1, 0, 0), (2, 3, 0), (5, 1, 0), (9, 0, 0)], (4.0, 5.0, 0.0)),
        ([(0, 0, 0), (1, 0, 2), (2, 3, 0)], (4.0, 5.0, 0.0)),
    ],
)
def test_a_geometry_that_determines_no_position_is_refused(stations, position):
    """In line with the stations, too few of them, all in a line or plane with it."""
    stations = Stations(np.array(stations, float))
    with pytest.raises(ValueError, match=rf"stations: these {len(stations)} stations do not"):
        bounds.crlb(stations, position, toa_sigma=1e-9)
    assert bounds.gdop(stations, position) == np.inf


def test_the_refusal_names_the_place():
    stations = Stations([(0.0, 0.0), (1.0, 0.0), (3.0, 0.0)])
    with pytest.raises(ValueError, match=r"emitter at \[7.0, 0.0\]"):
        bounds.crlb(stations, [[1.0, 5.0], [7.0, 0.0]], toa_sigma=1e-9)


def test_two_dimensions_of_velocity_need_range_rates():
    stations = Stations(SENSORS)
    with pytest.raises(ValueError, match="velocity: give velocity and range_rate_sigma together"):
        bounds.crlb(stations, [8.0, 22.0], toa_sigma=1e-9, velocity=[1.0, 2.0])
    with pytest.raises(ValueError, match="position: expected shape"):
        bounds.crlb(stations, [8.0, 22.0, 0.0], toa_sigma=1e-9)
    with pytest.raises(ValueError, match="exactly one of toa_sigma"):
        bounds.crlb(stations, [8.0, 22.0])


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), dims=st.sampled_from([2, 3]))
def test_dilution_of_precision_is_the_bound_for_unit_noise(seed, dims):
    rng = np.random.default_rng(seed)
    S = dims + 1 + int(rng.integers(0, 5))
    stations = Stations(rng.uniform(-1e3, 1e3, (S, dims)))
    p = rng.uniform(-5e3, 5e3, (2, 3, dims))
    dilution = bounds.gdop(stations, p)
    assert dilution.shape == (2, 3)
    bound = bounds.crlb(stations, p, toa_sigma=4e-9)
    expected = np.sqrt(np.einsum("...ii->...", bound)) / (4e-9 * C)
    assert_allclose(dilution, expected, rtol=1e-6)


def test_dilution_grows_with_the_square_of_the_distance():
    """Far away the range is known from the curvature of the wave front alone."""
    angle = 2.0 * np.pi * np.arange(5) / 5
    stations = Stations(np.column_stack([np.cos(angle), np.sin(angle)]))
    near, far = bounds.gdop(stations, [[2e3, 3e2], [2e4, 3e3]])
    assert_allclose(far / near, 100.0, rtol=1e-3)
