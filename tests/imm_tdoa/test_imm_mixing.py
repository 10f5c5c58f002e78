"""Mixing states of unequal size: by hand, by brute force, and modes that cannot be reached."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from imm_oracles import mixture_moments
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank
from imm_tdoa.mixing import mix
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Position, Static


def state_1d(bank, means, covariances, probability):
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [0.0], [[1.0]])
    return attrs.evolve(
        state,
        means=tuple(np.array(m, float) for m in means),
        covariances=tuple(np.array(P, float) for P in covariances),
        log_mode_probability=np.log(probability),
    )


@pytest.mark.parametrize(
    ("mixing", "x", "P"),
    [
        # static N(1, 4), weight 1/4; CV N([3, 2], [[1, .5], [.5, 2]]), weight 3/4, into CV.
        # position: mean 2.5, variance (4 + 1.5²)/4 + 3(1 + .5²)/4 = 2.5, whatever the rule
        ("birth", [2.5, 1.5], [[2.5, 1.125], [1.125, 27.25]]),  # velocity from N(0, 10²)
        ("zero", [2.5, 1.5], [[2.5, 1.125], [1.125, 2.25]]),  # velocity 0
        ("unbiased", [2.5, 2.0], [[2.5, 0.375], [0.375, 2.0]]),  # velocity from N(2, 2)
    ],
)
def test_static_and_cv_mixed_by_hand(mixing, x, P):
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0)],
        transition=[[0.5, 0.5], [0.5, 0.5]],
        mixing=mixing,
        birth_std={"velocity": 10.0},
    )
    state = state_1d(bank, [[1.0], [3.0, 2.0]], [[[4.0]], [[1.0, 0.5], [0.5, 2.0]]], [0.25, 0.75])
    means, covariances, log_c = mix(state, bank.chain(1.0), mixing)
    assert_allclose(means[0], [2.5], rtol=1e-15)  # CV -> static keeps the position's marginal
    assert_allclose(covariances[0], [[2.5]], rtol=1e-15)
    assert_allclose(means[1], x, rtol=1e-15)
    assert_allclose(covariances[1], P, rtol=1e-15)
    assert_allclose(np.exp(log_c), [0.5, 0.5], rtol=1e-15)


def test_mixing_leaves_an_unreachable_mode_as_it_was():
    bank = Bank([ConstantVelocity(psd=0.0), Static(psd=0.0)], transition=[[1, 0], [1, 0]])
    state = state_1d(bank, [[3.0, 2.0], [7.0]], [np.eye(2), [[4.0]]], [0.5, 0.5])
    means, covariances, log_c = mix(state, bank.chain(1.0), "birth")
    assert_array_equal(means[1], [7.0])
    assert_array_equal(covariances[1], [[4.0]])
    assert_array_equal(np.exp(log_c), [1.0, 0.0])


@pytest.mark.parametrize("mixing", ["birth", "unbiased", "zero"])
def test_three_orders_mixed_by_brute_force(mixing):
    rng = np.random.default_rng(4)

    def spd(n):
        A = rng.normal(size=(n, n))
        return A @ A.T + np.eye(n)

    xs = [rng.normal(size=n) for n in (1, 2, 3)]
    Ps = [spd(n) for n in (1, 2, 3)]
    Pi = rng.dirichlet(np.ones(3), size=3)
    mu = np.array([0.2, 0.3, 0.5])
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
        transition=Pi,
        mixing=mixing,
        birth_std={"velocity": 3.0, "acceleration": 2.0},
    )
    means, covariances, log_c = mix(state_1d(bank, xs, Ps, mu), Pi, mixing)
    assert_allclose(np.exp(log_c), mu @ Pi, rtol=1e-14)
    birth = [0.0, 9.0, 4.0]
    for j in range(3):
        lifted = []
        for i in range(3):
            c, n = min(i, j) + 1, j + 1
            x, P = np.zeros(n), np.zeros((n, n))
            x[:c], P[:c, :c] = xs[i][:c], Ps[i][:c, :c]
            if mixing == "birth":
                P[range(c, n), range(c, n)] = birth[c:n]
            elif mixing == "unbiased":
                x[c:], P[c:, c:] = xs[j][c:], Ps[j][c:, c:]
            lifted.append((x, P))
        w = mu * Pi[:, j] / (mu @ Pi)[j]
        x, P = mixture_moments(list(w), [a for a, _ in lifted], [b for _, b in lifted])
        assert_allclose(means[j], x, rtol=1e-12)
        assert_allclose(covariances[j], P, rtol=1e-12)


def test_up_and_down_again_changes_nothing():
    """Static -> CA -> static: the position's marginal survives; static -> CA fills v and a."""
    bank = Bank([Static(psd=0.0), ConstantAcceleration(psd=0.0)], transition=[[0, 1], [1, 0]])
    start = state_1d(bank, [[5.0], [0.0] * 3], [[[2.0]], np.eye(3)], [1.0, 1e-300])
    means, covariances, log_c = mix(start, bank.chain(1.0), "birth")
    assert_allclose(means[1], [5.0, 0.0, 0.0], rtol=1e-15)
    assert_allclose(covariances[1], np.diag([2.0, 100.0**2, 10.0**2]), rtol=1e-15)
    up = attrs.evolve(start, means=means, covariances=covariances, log_mode_probability=log_c)
    means, covariances, log_c = mix(up, bank.chain(1.0), "birth")
    assert_allclose(means[0], [5.0], rtol=1e-15)
    assert_allclose(covariances[0], [[2.0]], rtol=1e-15)


def test_an_unreachable_mode_keeps_its_state_and_weighs_nothing():
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantVelocity(psd=1.0)],
        transition=[[0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [1.0, 0.0, 0.0]],
        prior=[0.5, 0.5, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [3.0], [[4.0]])
    for k in range(5):
        state = imm.step(state, k + 1.0, [3.0 + 0.1 * k])
        assert state.mode_probability[2] == 0.0
        assert np.isneginf(state.log_mode_probability[2])
        assert all(np.isfinite(x).all() for x in state.means)
        assert np.isfinite(state.mean).all()
    without = IMM(Bank(bank.models[:2], transition=[[0.5, 0.5], [0.5, 0.5]]), Position(1.0, dims=1))
    other = without.start(0.0, [3.0], [[4.0]])
    for k in range(5):
        other = without.step(other, k + 1.0, [3.0 + 0.1 * k])
    assert_allclose(state.mean, other.mean, rtol=1e-14)
    assert_allclose(state.log_likelihood, other.log_likelihood, rtol=1e-14)


def test_a_mode_that_becomes_reachable_comes_back_from_the_others():
    bank = Bank(
        [ConstantVelocity(psd=0.0), ConstantVelocity(psd=5.0)],
        transition=[[0.9, 0.1], [0.2, 0.8]],
        prior=[1.0, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.start(0.0, [0.0, 1.0], np.eye(2))
    assert_array_equal(state.mode_probability, [1.0, 0.0])
    assert_allclose(imm.step(state, 1.0, [np.nan]).mode_probability, [0.9, 0.1], rtol=1e-14)


def test_unequal_dimensions_leave_proper_covariances_where_overwriting_would_not():
    """Writing the small mode's block into the big mode's covariance makes it indefinite."""
    P_big = np.array([[100.0, 99.0], [99.0, 100.0]])
    overwritten = P_big.copy()
    overwritten[0, 0] = 1.0
    assert np.linalg.eigvalsh(overwritten)[0] < -30.0
    for mixing in ("birth", "unbiased", "zero"):
        bank = Bank(
            [Static(psd=0.0), ConstantVelocity(psd=0.0)],
            transition=[[0.1, 0.9], [0.5, 0.5]],
            mixing=mixing,
        )
        state = state_1d(bank, [[0.0], [0.0, 0.0]], [[[1.0]], P_big], [0.999, 0.001])
        _, covariances, _ = mix(state, bank.chain(1.0), mixing)
        for P in covariances:
            assert np.linalg.eigvalsh(P)[0] >= -1e-12 * np.trace(P)
