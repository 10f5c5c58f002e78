"""Motion models against second formulations: matrix exponentials, quadrature, rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from imm_tdoa.models import (
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Singer,
    Static,
)
from imm_tdoa.testing.strategies import numbers, states, time_steps

quick = settings(max_examples=30, deadline=None, database=None, derandomize=True)


def companion(order, tau=np.inf):
    """Generator A and input B of one axis: a chain of integrators, its last state decaying."""
    A = np.diag(np.ones(order), 1)
    A[-1, -1] = -1.0 / tau
    return A, np.eye(order + 1)[:, -1:]


def van_loan(A, B, q, dt):
    """F and Q of dx = A x dt + B dw from one matrix exponential (Van Loan 1978)."""
    n = len(A)
    M = np.block([[-A, q * B @ B.T], [np.zeros((n, n)), A.T]])
    E = expm(M * dt)
    F = E[n:, n:].T
    return F, F @ E[:n, n:]


POLYNOMIAL = [(Static, 0), (ConstantVelocity, 1), (ConstantAcceleration, 2)]


@pytest.mark.parametrize(("cls", "order"), POLYNOMIAL)
@pytest.mark.parametrize("dt", [0.05, 1.0, 7.3])
@pytest.mark.parametrize("dims", [1, 2, 3])
def test_polynomial_models_against_van_loan(cls, order, dt, dims):
    F, Q = van_loan(*companion(order), 0.7, dt)
    model = cls(psd=0.7)
    np.testing.assert_allclose(model.transition(dt, dims), np.kron(F, np.eye(dims)), atol=1e-14)
    expected = np.kron(Q, np.eye(dims))
    np.testing.assert_allclose(model.process_noise(dt, dims), expected, rtol=1e-9, atol=1e-18)


def test_continuous_noise_against_the_table():
    """ALGORITHMS §2, written out for dt = 2, psd = 3."""
    cv = 3.0 * np.array([[8 / 3, 4 / 2], [4 / 2, 2.0]])
    ca = 3.0 * np.array([[32 / 20, 16 / 8, 8 / 6], [16 / 8, 8 / 3, 4 / 2], [8 / 6, 4 / 2, 2.0]])
    np.testing.assert_allclose(Static(psd=3.0).process_noise(2.0, 1), [[6.0]])
    np.testing.assert_allclose(ConstantVelocity(psd=3.0).process_noise(2.0, 1), cv, rtol=1e-14)
    np.testing.assert_allclose(ConstantAcceleration(psd=3.0).process_noise(2.0, 1), ca, rtol=1e-14)


def test_piecewise_constant_noise_against_the_table():
    """std² g g', ALGORITHMS §2; a static model's step has no time unit."""
    g2, g3 = np.array([2.0, 2.0]), np.array([2.0, 2.0, 1.0])  # dt = 2
    np.testing.assert_allclose(Static(std=3.0).process_noise(2.0, 1), [[9.0]])
    np.testing.assert_allclose(
        ConstantVelocity(std=3.0).process_noise(2.0, 1), 9.0 * np.outer(g2, g2)
    )
    np.testing.assert_allclose(
        ConstantAcceleration(std=3.0).process_noise(2.0, 1), 9.0 * np.outer(g3, g3)
    )
    np.testing.assert_allclose(
        CoordinatedTurn(std=3.0, turn_rate_psd=0.1).process_noise(2.0, 2)[np.ix_([1, 3], [1, 3])],
        9.0 * np.outer(g2, g2),
    )


def test_blocked_layout_in_three_dimensions():
    """x y z vx vy vz: the block of axis i is at (i, i + 3); other axes are untouched."""
    Q = ConstantVelocity(psd=1.0).process_noise(1.0, 3)
    assert Q[1, 4] == 0.5
    assert Q[1, 3] == Q[0, 1] == 0.0
    assert ConstantVelocity(psd=1.0).components(3) == ("x", "y", "z", "vx", "vy", "vz")
    assert ConstantAcceleration(psd=1.0).components(2) == ("x", "y", "vx", "vy", "ax", "ay")


@pytest.mark.parametrize("tau", [0.3, 20.0, 300.0])
@pytest.mark.parametrize("ratio", [0.01, 0.4, 0.6, 0.999, 1.0, 1.001, 5.0])
def test_singer_against_van_loan(tau, ratio):
    """On both sides of the switch between quadrature (dt < tau) and the closed form."""
    dt = ratio * tau
    F, Q = van_loan(*companion(2, 1.0 / ratio), 0.4 * dt, 1.0)  # in units of dt: well scaled
    unit = np.array([dt**2, dt, 1.0])
    model = Singer(psd=0.4, time_constant=tau)
    np.testing.assert_allclose(
        model.transition(dt, 1) * unit / unit[:, None], F, rtol=1e-10, atol=1e-14
    )
    Q *= np.outer(unit, unit)
    np.testing.assert_allclose(model.process_noise(dt, 1), Q, rtol=1e-10)


@pytest.mark.parametrize("dt", [0.01, 3.0, 19.0, 21.0, 200.0])
def test_singer_noise_against_quadrature(dt):
    """Q = psd int F(s) b b' F(s)' ds, adaptively."""
    model = Singer(psd=0.4, time_constant=20.0)

    def integrand(s):
        column = model.transition(s, 1)[:, -1]
        return 0.4 * np.outer(column, column)

    Q, _ = quad_vec(integrand, 0.0, dt, epsrel=1e-11, epsabs=0.0)
    np.testing.assert_allclose(model.process_noise(dt, 1), Q, rtol=1e-9)


def test_singer_limits():
    """Slow: constant acceleration. Long: the acceleration has its stationary variance."""
    slow, dt = Singer(psd=0.2, time_constant=1e7), 3.0
    ca = ConstantAcceleration(psd=0.2)
    np.testing.assert_allclose(slow.transition(dt, 2), ca.transition(dt, 2), rtol=1e-6)
    np.testing.assert_allclose(slow.process_noise(dt, 2), ca.process_noise(dt, 2), rtol=1e-6)
    stationary = Singer(std=3.0, time_constant=2.0).process_noise(100.0, 1)
    assert stationary[2, 2] == pytest.approx(9.0, rel=1e-12)
    twin = Singer(psd=2.0 * 9.0 / 2.0, time_constant=2.0).process_noise(100.0, 1)
    np.testing.assert_allclose(stationary, twin, rtol=1e-14)


@quick
@given(states(("x", "y", "vx", "vy", "omega")), time_steps())
def test_turn_against_a_complex_rotation(x, dt):
    """p + v (e^(i omega dt) - 1) / (i omega), v e^(i omega dt) in the complex plane."""
    p, v, omega = x[0] + 1j * x[1], x[2] + 1j * x[3], x[4]
    turn = np.exp(1j * omega * dt)
    arc = np.expm1(1j * omega * dt) / (1j * omega) if omega else dt
    end, speed = p + v * arc, v * turn
    y = CoordinatedTurn(psd=1.0).propagate(x, dt)
    scale = abs(p) + abs(v) * dt
    np.testing.assert_allclose(y[:2], [end.real, end.imag], rtol=0, atol=1e-12 * scale + 1e-300)
    np.testing.assert_allclose(y[2:4], [speed.real, speed.imag], rtol=0, atol=1e-12 * abs(v))
    assert y[4] == omega
    assert np.hypot(*y[2:4]) == pytest.approx(abs(v))


def test_turn_in_three_dimensions_against_integration():
    """z moves straight on; x and y as the differential equation says."""
    x = np.array([10.0, -5.0, 100.0, 30.0, 4.0, -2.0, 0.07])

    def rate(_, s):
        vx, vy, vz, omega = s[3:]
        return [vx, vy, vz, -omega * vy, omega * vx, 0.0, 0.0]

    found = solve_ivp(rate, (0.0, 25.0), x, rtol=1e-11, atol=1e-11).y[:, -1]
    y = CoordinatedTurn(psd=1.0).propagate(x, 25.0)
    np.testing.assert_allclose(y, found, rtol=1e-8)


@quick
@given(numbers(-0.06, 0.06, decimals=6), numbers(-30.0, 30.0), numbers(-30.0, 30.0))
def test_turn_jacobian_where_series_and_closed_form_meet(angle, vx, vy):
    """Derivatives by omega against those of the complex formula, at dt = 1, down to zero."""
    F = CoordinatedTurn(psd=1.0).jacobian(np.array([0.0, 0.0, vx, vy, angle]), 1.0)
    a = 1j * angle
    # d/d omega of v (e^a - 1)/a is i v g'(a), g = (e^a - 1)/a = sum a^k / (k + 1)!
    terms = [1 / 2, 1 / 3, 1 / 8, 1 / 30, 1 / 144, 1 / 840, 1 / 5760]
    slope = 1j * (vx + 1j * vy) * sum(t * a**k for k, t in enumerate(terms))
    np.testing.assert_allclose(F[:2, -1], [slope.real, slope.imag], rtol=0, atol=1e-10)


def test_turn_noise():
    """That of constant velocity, and a random walk of omega."""
    Q = CoordinatedTurn(psd=2.0, turn_rate_psd=0.3).process_noise(4.0, 3)
    np.testing.assert_allclose(Q[:6, :6], ConstantVelocity(psd=2.0).process_noise(4.0, 3))
    assert Q[6, 6] == pytest.approx(1.2)
    assert not np.any(Q[6, :6])
    with pytest.raises(ValueError, match="dims: CoordinatedTurn needs 2 or 3 dimensions, got 1"):
        CoordinatedTurn(psd=1.0).process_noise(1.0, 1)


def test_states_of_no_length_that_fits():
    with pytest.raises(ValueError, match="x: ConstantVelocity has 2 components per axis"):
        ConstantVelocity(psd=1.0).propagate(np.zeros(3), 1.0)
    with pytest.raises(ValueError, match=r"x: CoordinatedTurn has 5 components \(2-D\) or 7"):
        CoordinatedTurn(psd=1.0).propagate(np.zeros(6), 1.0)
