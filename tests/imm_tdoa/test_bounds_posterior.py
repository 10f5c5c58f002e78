"""The bound of a whole track against published numbers and other derivations of it."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from bounds_cases import SQUARE, T3, spd
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imm_tdoa import Bank, Stations, bounds
from imm_tdoa.contract import Measurement
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Singer,
    Stack,
    Static,
)

C = 299_792_458.0
SOURCE_A = Stations([[0, 0], [100e3, 0], [-50e3, 86602.54037844388], [-50e3, -86602.54037844384]])
BIRTH = {"velocity": 5e3, "acceleration": 500.0}
EPOCHS = 2.0 * np.arange(21)


def source_a(speed: float, acceleration: float) -> np.ndarray:
    """Positions (3, 21, 2) of §5.3: targets along ±y, accelerations ∓x."""
    p = np.array([[300e3, 400e3], [350e3, 450e3], [250e3, 350e3]])
    v = speed * np.array([[0, 1], [0, -1], [0, 1.0]])
    a = acceleration * np.array([[-1, 0], [1, 0], [1, 0.0]])
    t = EPOCHS[:, None]
    return p[:, None] + v[:, None] * t + a[:, None] * t**2 / 2


# --- published and closed-form numbers -----------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "speed", "acceleration", "at", "mean_rms", "mean_error"),
    [
        (Static(psd=0.0), 0.0, 0.0, (0.868, 0.501, 0.370, 0.268), 0.418, 0.337),
        (ConstantVelocity(psd=0.0), 1e3, 0.0, (1.219, 0.893, 0.700, 0.527), 0.749, 0.603),
        (ConstantAcceleration(psd=0.0), 1e3, 100.0, (1.219, 1.115, 0.961, 0.779), 0.970, 0.781),
    ],
)
def test_source_a(model, speed, acceleration, at, mean_rms, mean_error):
    """§10: root-mean-square km at k = 1, 5, 10, 20, 20-step means, and mean errors (§5.3)."""
    path = source_a(speed, acceleration)
    bound = bounds.pcrlb(
        Bank([model], birth_std=BIRTH), TDOA(SOURCE_A, tdoa_sigma=1e-7), EPOCHS, path
    )
    rms = bound.position_rms / 1e3
    assert_allclose(rms.mean(axis=0)[[1, 5, 10, 20]], at, atol=6e-4)
    assert_allclose(rms[:, 1:].mean(), mean_rms, atol=6e-4)
    assert_allclose(bound.position_mean[:, 1:].mean() / 1e3, mean_error, atol=6e-4)
    single = bounds.crlb(SOURCE_A, path[:, 0], tdoa_sigma=1e-7)
    assert_allclose(bound.position_covariance[:, 0], single, rtol=1e-9)


def test_polynomial_regression():
    """§5.3: variance at the end of a line or parabola through n equally good fixes."""
    n = np.arange(1.0, 30.0)
    sigma, t = 3.0, 0.7 * n
    for model, order, ratio in (
        (Static(psd=0.0), 0, 1 / n),
        (ConstantVelocity(psd=0.0), 1, (4 * n - 2) / (n * (n + 1))),
        (
            ConstantAcceleration(psd=0.0),
            2,
            3 * (3 * n**2 - 3 * n + 2) / (n * (n + 1) * (n + 2)),
        ),
    ):
        nothing = np.diag(np.full(order + 1, np.inf))
        bound = bounds.pcrlb(
            model, Position(sigma, dims=1), t, np.zeros((29, 1)), covariance=nothing
        )
        assert_allclose(bound.position_rms, sigma * np.sqrt(ratio), rtol=1e-6)
        for k in range(order):  # a fix more for every order that is unknown
            assert np.isposinf(bound.covariance[k, k + 1 :, k + 1 :].diagonal()).all()
            assert np.isnan(bound.covariance[k, 0, -1])
        assert np.isfinite(bound.covariance[order:]).all()


# --- the same, by other means --------------------------------------------------------------------


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), dims=st.integers(1, 3), kind=st.integers(0, 3))
def test_a_linear_problem_is_the_kalman_filter_s_own_covariance(seed, dims, kind):
    rng = np.random.default_rng(seed)
    model = (
        Static(psd=2.0),
        ConstantVelocity(psd=0.5),
        ConstantAcceleration(std=0.1),
        Singer(std=2.0),
    )[kind]
    n, sigma, T = len(model.components(dims)), rng.uniform(0.5, 3.0, dims), 12
    t = np.cumsum(rng.choice([0.0, 0.3, 1.0, 7.0], T))
    present = rng.random((T, dims)) < 0.7
    P = spd(rng, n, 20.0)
    bound = bounds.pcrlb(
        model,
        Position(sigma, dims=dims),
        t,
        rng.normal(size=(T, dims)),
        covariance=P,
        present=np.where(present, 1.0, np.nan),
    )
    for k in range(T):
        if k:
            F = model.transition(t[k] - t[k - 1], dims)
            P = F @ P @ F.T + model.process_noise(t[k] - t[k - 1], dims)
        H, R = np.eye(dims, n)[present[k]], np.diag(sigma[present[k]] ** 2)
        P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
        assert_allclose(bound.covariance[k], P, rtol=1e-7, atol=1e-9 * np.abs(P).max())


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    order=st.integers(0, 2),
    start=st.sampled_from(["fix", "all", "nothing"]),
)
def test_without_process_noise_it_is_the_batch_information_carried_forward(seed, order, start):
    """Every row as a function of the initial state; nothing recursive."""
    rng = np.random.default_rng(seed)
    model = (Static, ConstantVelocity, ConstantAcceleration)[order](psd=0.0)
    n, T = 2 * (order + 1), 15
    t = 5.0 + np.cumsum(rng.uniform(0.5, 20.0, T))
    x0 = np.array([3e3, 4e3, 40.0, -30.0, 0.5, 0.2])[:n]
    F = model.transition(t - t[0], 2)
    path = F @ x0
    stations = Stations(SQUARE)
    measurement = TDOA(stations, toa_sigma=30e-9)
    present = rng.random((T, 3)) < 0.8
    prior = np.array([1e3, 1e3, 50.0, 50.0, 2.0, 2.0])[:n] ** 2
    information = np.diag(1.0 / prior)
    if start == "fix":
        information[:2] = 0.0
    elif start == "nothing":
        information[:] = 0.0
    covariance = {"fix": None, "all": np.diag(prior), "nothing": np.diag(np.full(n, np.inf))}[start]
    bank = Bank([model], birth_std={"velocity": 50.0, "acceleration": 2.0})
    bound = bounds.pcrlb(bank, measurement, t, path, covariance=covariance, present=present)
    for k in range(T):
        p = path[k, :2]
        u = (p - SQUARE) / np.linalg.norm(p - SQUARE, axis=-1, keepdims=True)
        H = np.zeros((3, n))
        H[:, :2] = u[1:] - u[0]
        R = (30e-9 * C) ** 2 * (np.eye(3) + 1.0)
        rows = present[k]
        H = H[rows] @ F[k]
        information = information + H.T @ np.linalg.solve(R[np.ix_(rows, rows)], H)
        scale = np.sqrt(np.diag(information))
        if np.any(scale == 0.0):
            continue
        unit = information / np.outer(scale, scale)
        if np.linalg.cond(unit) > 1e8:
            continue
        P = F[k] @ (np.linalg.inv(unit) / np.outer(scale, scale)) @ F[k].T
        s = np.sqrt(np.diag(P))
        assert_allclose(bound.covariance[k] / np.outer(s, s), P / np.outer(s, s), atol=1e-5)
    assert np.isfinite(bound.covariance[-1]).all()


def test_rows_one_at_a_time_add_up_to_a_position():
    """A pair at a time: infinite until the plane is spanned, then what one scan would give."""
    t = np.arange(6.0)
    p = np.array([3e3, 4e3])
    pairs = np.array([[[1, 0]], [[1, 0]], [[2, 0]], [[3, 2]], [[3, 1]], [[2, 0]]])
    measurement = TDOA(Stations(SQUARE), tdoa_sigma=30e-9)
    bound = bounds.pcrlb(Static(psd=0.0), measurement, t, np.tile(p, (6, 1)), pairs=pairs)
    assert np.isposinf(bound.position_rms[:2]).all()
    for k in range(2, 6):
        P = bounds.crlb(Stations(SQUARE), p, tdoa_sigma=30e-9, pairs=pairs[: k + 1, 0])
        if k == 2:
            u = (p - SQUARE) / np.linalg.norm(p - SQUARE, axis=-1, keepdims=True)
            H = np.array([u[a] - u[b] for a, b in pairs[: k + 1, 0]])
            P = (30e-9 * C) ** 2 * np.linalg.inv(H.T @ H)
            assert_allclose(bound.position_covariance[k], P, rtol=1e-7)
    H = np.array([u[a] - u[b] for a, b in pairs[:, 0]])
    P = (30e-9 * C) ** 2 * np.linalg.inv(H.T @ H)
    assert_allclose(bound.position_covariance[-1], P, rtol=1e-7)
    blind = bounds.pcrlb(
        ConstantVelocity(psd=1.0),
        measurement,
        t,
        np.tile(p, (6, 1)),
        present=np.zeros((6, 3), bool),
    )
    assert np.isposinf(blind.position_rms).all()
    assert np.isposinf(blind.position_mean).all()


def recursion(J, F, Q, information, k):
    """Tichavský's step (his equation 21) with explicit inverses; F (R, n, n) over trajectories."""
    W = np.linalg.inv(Q)
    D11 = np.mean(np.swapaxes(F, -1, -2) @ W @ F, axis=0)
    D12 = -np.mean(np.swapaxes(F, -1, -2), axis=0) @ W
    return W + information - D12.T @ np.linalg.solve(J + D11, D12)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), nonlinear=st.booleans())
def test_averaged_over_trajectories_it_is_tichavsky_s_recursion(seed, nonlinear):
    rng = np.random.default_rng(seed)
    R, T = 5, 8
    model = CoordinatedTurn(psd=2.0) if nonlinear else ConstantVelocity(psd=2.0)
    n = 5 if nonlinear else 4
    t = np.cumsum(rng.uniform(0.5, 3.0, T))
    x = np.zeros((R, T, n))
    x[:, 0] = rng.normal(
        [3e3, 4e3, 40.0, -30.0, 0.1][:n], [200.0, 200.0, 20.0, 20.0, 0.1][:n], (R, n)
    )
    for k in range(1, T):
        x[:, k] = model.propagate(x[:, k - 1], t[k] - t[k - 1])
    stations = Stations(SQUARE, velocities=np.zeros_like(SQUARE))
    measurement = Stack(TDOA(stations, toa_sigma=30e-9), FDOA(stations, range_rate_sigma=2.0))
    P0 = np.diag(np.array([300.0, 300.0, 20.0, 20.0, 0.1][:n]) ** 2)
    bound = bounds.pcrlb(model, measurement, t, x, covariance=P0, axis=0)
    J = np.linalg.inv(P0)
    for k in range(T):
        every = [bounds.fisher_information(measurement, y[:2], y[2:4], t[k]) for y in x[:, k]]
        information = np.zeros((n, n))
        information[:4, :4] = np.mean(every, axis=0)
        if k == 0:
            J = J + information
        else:
            dt = t[k] - t[k - 1]
            F = np.broadcast_to(model.jacobian(x[:, k - 1], dt), (R, n, n))
            J = recursion(J, F, model.process_noise(dt, 2), information, k)
        s = np.sqrt(np.diag(bound.covariance[k]))
        unit = bound.covariance[k] / np.outer(s, s)
        assert_allclose(unit @ (J * np.outer(s, s)), np.eye(n), atol=1e-6)


def test_each_trajectory_by_itself_is_the_batch():
    rng = np.random.default_rng(5)
    t = np.stack([np.arange(6.0), 2.0 * np.arange(6.0)])
    x = rng.normal([3e3, 4e3, 20.0, 5.0, 0.05], 1.0, (3, 2, 6, 5)) * [1, 1, 1, 1, 0.02]
    present = rng.random((2, 6, 3)) < 0.8
    model = CoordinatedTurn(psd=1.0)
    measurement = TDOA(Stations(SQUARE), toa_sigma=30e-9)
    batch = bounds.pcrlb(model, measurement, t, x, present=present)
    assert batch.position_rms.shape == (3, 2, 6)
    for i, j in np.ndindex(3, 2):
        one = bounds.pcrlb(model, measurement, t[j], x[i, j], present=present[j])
        assert_allclose(batch.covariance[i, j], one.covariance, rtol=1e-9)
    averaged = bounds.pcrlb(model, measurement, t, x, present=present, axis=0)
    for j in range(2):
        one = bounds.pcrlb(model, measurement, t[j], x[:, j], present=present[j], axis=(-1,))
        assert_allclose(averaged.covariance[j], one.covariance, rtol=1e-9)
    assert_allclose(averaged.times, t)
    both = bounds.pcrlb(model, measurement, t[0], x, axis=(0, 1))
    assert both.covariance.shape == (6, 5, 5)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_sequence_of_modes_is_one_linear_model_of_all_that_begins(seed):
    """Each birth is an unknown of its own; what ends stays in the position it leaves behind."""
    rng = np.random.default_rng(seed)
    T, birth = 12, {"velocity": 60.0, "acceleration": 3.0}
    models = [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)]
    bank = Bank(models, birth_std=birth, names=("still", "straight", "curved"))
    modes = [int(m) for m in rng.integers(0, 3, T)]
    t = np.cumsum(rng.uniform(0.1, 3.0, T))
    sigma = 4.0
    bound = bounds.pcrlb(
        bank,
        Position(sigma, dims=1),
        t,
        np.zeros((T, 1)),
        modes=modes,
        covariance=[[100.0]],
    )
    assert bound.modes == tuple(bank.names[m] for m in modes)
    size, used = 1 + 2 * T, 1
    prior = np.ones(size)
    prior[0] = 100.0
    maps = np.zeros((3, size))  # position, velocity, acceleration by the unknowns
    maps[0, 0] = 1.0
    information, order = np.zeros((size, size)), 0
    for k in range(T):
        for o in range(order + 1, modes[k] + 1):
            maps[o] = 0.0
            maps[o, used], prior[used] = 1.0, (birth["velocity"], birth["acceleration"])[o - 1] ** 2
            used += 1
        order = modes[k]
        maps[order + 1 :] = 0.0
        if k:
            dt = t[k] - t[k - 1]
            maps = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]]) @ maps
        information += np.outer(maps[0], maps[0]) / sigma**2
        P = maps @ np.linalg.inv(np.diag(1.0 / prior) + information) @ maps.T
        n = order + 1
        assert_allclose(bound.covariance[k, :n, :n], P[:n, :n], rtol=1e-6, atol=1e-9)
        assert np.isnan(bound.covariance[k, n:]).all()
        assert np.isnan(bound.covariance[k, :, n:]).all()
    named = bounds.pcrlb(
        bank, Position(sigma, dims=1), t, np.zeros((T, 1)), modes=bound.modes, covariance=[[100.0]]
    )
    assert_allclose(named.covariance, bound.covariance)


def test_a_singular_transition_is_no_obstacle():
    """What F forgets is forgotten; no inverse of F is taken."""

    @attrs.frozen
    class Forgetting(ConstantVelocity):
        """A velocity that is drawn anew at every step, and moves nothing."""

        def transition(self, dt, dims):
            F = np.zeros((*np.shape(dt), 2 * dims, 2 * dims))
            F[..., :dims, :dims] = np.eye(dims)
            return F

    bound = bounds.pcrlb(
        Forgetting(psd=0.0),
        Position(2.0, dims=1),
        np.arange(4.0),
        np.zeros((4, 1)),
        covariance=np.diag([np.inf, 9.0]),
    )
    assert_allclose(bound.covariance[0], np.diag([4.0, 9.0]))
    assert_allclose(bound.covariance[3], np.diag([1.0, 0.0]), atol=1e-12)


def test_information_of_offsets_and_redundant_rows_enters_once():
    stations = Stations(SQUARE)
    t, x = np.arange(5.0), np.linspace([3e3, 4e3, 10.0, 5.0], [3.1e3, 4.05e3, 10.0, 5.0], 5)
    model = ConstantVelocity(psd=1.0)
    raw = bounds.pcrlb(model, TOA(stations, sigma=30e-9), t, x)
    loop = np.array([[1, 0], [2, 0], [3, 0], [2, 1]])
    differenced = bounds.pcrlb(model, TDOA(stations, toa_sigma=30e-9, pairs=loop), t, x)
    assert_allclose(raw.covariance, differenced.covariance, rtol=1e-6, atol=1e-9)


def test_velocities_alone_can_be_measured():
    """A row of pure velocity says nothing of the position of a mode, and all of its velocity."""

    class Speed(Measurement):
        dims, size = 1, 1

        def predict(self, position, velocity, time):
            return velocity

        def jacobian(self, position, velocity, time):
            H = np.broadcast_to(np.eye(1), (*position.shape[:-1], 1, 1))
            return np.zeros_like(H), H

        def noise_covariance(self, position, velocity, time):
            return 4.0 * np.eye(1)

    bound = bounds.pcrlb(ConstantVelocity(psd=0.0), Speed(), T3, np.zeros((3, 2)))
    birth = 100.0**-2
    assert_allclose(bound.covariance[:, 1, 1], 1.0 / (birth + 0.25 * np.arange(1, 4)), rtol=1e-9)
    assert np.isposinf(bound.position_rms).all()
