"""The enumeration of mode histories, judged by golden numbers and by one dense Gaussian."""

from __future__ import annotations

from itertools import pairwise, product

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Static,
)
from imm_tdoa.testing import exact_posterior

GOLDEN = [  # ALGORITHMS §14.1, exact columns
    (0.7866390984, -2.18038616),
    (0.8265765989, -3.79151223),
    (0.8478112051, -5.38556751),
    (0.8684552498, -6.87509827),
]
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [2e3, 2e3], [0.0, 2e3], [1e3, -9e2]])


def two_modes() -> IMM:
    bank = Bank(
        [ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)],
        transition=[[0.95, 0.05], [0.1, 0.9]],
        prior=[0.8, 0.2],
    )
    return IMM(bank, Position(1.0, dims=1))


def posterior(imm, start, times, values, **settings):
    return exact_posterior(imm.bank, imm.measurement, start, times, values, **settings)


def test_the_golden_columns():
    imm = two_modes()
    start = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    found = posterior(imm, start, [1.0, 2.0, 3.0, 4.0], np.array([[0.5], [1.1], [1.8], [2.4]]))
    mu, log_l = np.array(GOLDEN).T
    assert_allclose(found.filtered.mode_probability[:, 0], mu, atol=1e-10)
    assert_allclose(found.log_likelihood, log_l, atol=1e-8)
    assert_allclose(found.filtered.mode_probability.sum(axis=-1), 1.0, rtol=1e-14)
    assert_allclose(found.smoothed.mode_probability.sum(axis=-1), 1.0, rtol=1e-14)
    for name in ("mean", "covariance", "log_mode_probability"):
        last = getattr(found.filtered, name)[-1]
        assert_allclose(getattr(found.smoothed, name)[-1], last, rtol=1e-12, atol=1e-12)


# --- one dense Gaussian per history ---------------------------------------------------------------

ORDER = {"static": 1, "cv": 2, "ca": 3}


def motion(kind, dt):
    """F and Q of a unit-density polynomial model in 1-D, from the defining integral."""
    n = ORDER[kind]
    F = np.array([[dt ** (b - a) / [1, 1, 2][b - a] if b >= a else 0.0 for b in range(n)]
                  for a in range(n)])  # fmt: skip
    nodes, weights = np.polynomial.legendre.leggauss(8)
    Q = np.zeros((n, n))
    for s, w in zip((nodes + 1.0) / 2.0 * dt, weights * dt / 2.0, strict=True):
        g = np.array([s ** (n - 1 - a) / [1, 1, 2][n - 1 - a] for a in range(n)])
        Q += w * np.outer(g, g)
    return F, Q


def dense(kinds, prior, Pi, P0, birth, times, z, sigma):
    """Filtered and smoothed moments and probabilities by conditioning one joint Gaussian each.

    The joint of all states of a history, each in three components (those a mode lacks are zero),
    is written down block by block, and conditioned on the measurements in one solve.
    """
    T, r = len(times), len(kinds)
    steps = np.diff(times, prepend=0.0)
    out = {}
    for until in range(1, T + 1):
        weight, means, seconds = [], [], []
        for history in product(range(r), repeat=until + 1):
            n0 = ORDER[kinds[history[0]]]
            size = 3 * (until + 1)
            A, D = np.eye(size), np.zeros((size, size))  # A x = noise with covariance D
            D[:n0, :n0] = P0[:n0, :n0]
            log_w = np.log(prior[history[0]])
            for k, (i, j) in enumerate(pairwise(history)):
                ni, nj = ORDER[kinds[i]], ORDER[kinds[j]]
                F, Q = motion(kinds[j], steps[k])
                common = min(ni, nj)
                lift = np.zeros((nj, 3))
                lift[:common, :common] = np.eye(common)
                born = np.diag([birth[c] if c >= ni else 0.0 for c in range(nj)])
                now, before = slice(3 * (k + 1), 3 * (k + 1) + nj), slice(3 * k, 3 * k + 3)
                A[now, before] = -F @ lift
                D[now, now] = Q + F @ born @ F.T
                log_w += np.log(Pi[i, j])
            inverse = np.linalg.inv(A)
            C = inverse @ D @ inverse.T
            at = [3 * (k + 1) for k in range(until) if np.isfinite(z[k])]
            seen = np.array([z[k] for k in range(until) if np.isfinite(z[k])])
            S = C[np.ix_(at, at)] + sigma**2 * np.eye(len(at))
            gain = C[:, at] @ np.linalg.inv(S)
            log_w -= 0.5 * (seen @ np.linalg.solve(S, seen) + np.linalg.slogdet(2 * np.pi * S)[1])
            weight.append(np.exp(log_w))
            mean = gain @ seen
            means.append(mean)
            seconds.append(C - gain @ C[at] + np.outer(mean, mean))
        w = np.array(weight) / np.sum(weight)
        m = np.einsum("h,ha->a", w, means)
        V = np.einsum("h,hab->ab", w, seconds) - np.outer(m, m)
        digits = np.array(list(product(range(r), repeat=until + 1)))
        mu = np.array([[w[digits[:, k + 1] == j].sum() for j in range(r)] for k in range(until)])
        out[until] = (m.reshape(-1, 3)[1:], V, mu, float(np.log(np.sum(weight))))
    return out


@pytest.mark.parametrize("kinds", [("static", "cv"), ("cv", "ca"), ("static", "ca"), ("ca", "cv")])
def test_unequal_states_against_one_dense_gaussian(kinds):
    rng = np.random.default_rng(4)
    models = {"static": Static, "cv": ConstantVelocity, "ca": ConstantAcceleration}
    Pi = np.array([[0.8, 0.2], [0.35, 0.65]])
    bank = Bank(
        [models[k](psd=1.0) for k in kinds],
        transition=Pi,
        prior=[0.4, 0.6],
        birth_std={"velocity": 2.0, "acceleration": 0.7},
    )
    imm = IMM(bank, Position(0.8, dims=1))
    times, z = np.array([0.5, 1.5, 1.9, 3.0]), 3.0 * rng.normal(size=4)
    z[2] = np.nan
    n = max(ORDER[k] for k in kinds)
    root = rng.normal(size=(n, n))
    P0 = root @ root.T + np.eye(n)
    found = posterior(imm, imm.start(0.0, np.zeros(n), P0), times, z[:, None])
    want = dense(kinds, [0.4, 0.6], Pi, P0, [0.0, 4.0, 0.49], times, z, 0.8)
    for k in range(4):
        m, V, mu, log_l = want[k + 1]
        assert_allclose(found.filtered.mean[k], m[k, :n], rtol=1e-9, atol=1e-10)
        block = slice(3 * (k + 1), 3 * (k + 1) + n)
        assert_allclose(found.filtered.covariance[k], V[block, block], rtol=1e-9, atol=1e-10)
        assert_allclose(found.filtered.mode_probability[k], mu[k], rtol=1e-9)
        assert_allclose(found.log_likelihood[k], log_l, rtol=1e-10)
        m, V, mu, _ = want[4]
        assert_allclose(found.smoothed.mean[k], m[k, :n], rtol=1e-9, atol=1e-10)
        assert_allclose(found.smoothed.covariance[k], V[block, block], rtol=1e-9, atol=1e-10)
        assert_allclose(found.smoothed.mode_probability[k], mu[k], rtol=1e-9)


# --- against the filter where it is exact ---------------------------------------------------------


@pytest.mark.parametrize("model", [ConstantVelocity(psd=1.0), CoordinatedTurn(psd=1.0)])
@pytest.mark.parametrize("kind", [TDOA, TOA])
def test_one_mode_is_the_filter(model, kind):
    """Extended Kalman filter with missing rows and shared offsets: one history, nothing merged."""
    rng = np.random.default_rng(7)
    stations = Stations(CORNERS)
    measurement = TOA(stations, sigma=20e-9) if kind is TOA else TDOA(stations, toa_sigma=20e-9)
    imm = IMM(Bank([model]), measurement)
    t = np.array([1.0, 2.0, 2.0, 4.5, 5.0])
    path = np.array([800.0, 700.0]) + t[:, None] * [20.0, -7.0]
    toa = np.linalg.norm(path[:, None] - CORNERS, axis=-1) / 299_792_458.0
    toa += 20e-9 * rng.normal(size=toa.shape)
    values = toa if kind is TOA else toa[:, 1:] - toa[:, :1]
    values[1, 2] = values[3, 0] = np.nan
    values[2] = np.nan
    start = imm.start(0.0, [790.0, 710.0], 400.0 * np.eye(2))
    track, found = imm.run(t, values, start=start), posterior(imm, start, t, values)
    assert_allclose(found.filtered.mean, track.mean, rtol=1e-9, atol=1e-9)
    assert_allclose(found.filtered.covariance, track.covariance, rtol=1e-8, atol=1e-9)
    assert_allclose(found.log_likelihood, track.log_likelihood, rtol=1e-10)


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_a_batch_is_its_targets_and_the_order_of_modes_is_nothing(seed):
    rng = np.random.default_rng(seed)
    models = [Static(psd=0.1), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)]
    Pi = rng.dirichlet(np.ones(3), size=3)
    prior, order = rng.dirichlet(np.ones(3)), rng.permutation(3)
    imm = IMM(Bank(models, transition=Pi, prior=prior), Position(1.0))
    other = IMM(
        Bank([models[j] for j in order], transition=Pi[np.ix_(order, order)], prior=prior[order]),
        imm.measurement,
    )
    t = np.cumsum(rng.choice([0.0, 1.0, 2.5], size=(2, 3)), axis=1)
    z = 3.0 * rng.normal(size=(2, 3, 2))
    z[0, 1] = np.nan
    mean = rng.normal(size=(2, 2))
    both = posterior(imm, imm.start(0.0, mean, np.eye(2)), t, z)
    for b in range(2):
        one = posterior(other, other.start(0.0, mean[b], np.eye(2)), t[b], z[b])
        assert_allclose(both.log_likelihood[b], one.log_likelihood, rtol=1e-10)
        for part in ("filtered", "smoothed"):
            many, single = getattr(both, part), getattr(one, part)
            assert_allclose(many.mean[b], single.mean, rtol=1e-8, atol=1e-9)
            assert_allclose(many.covariance[b], single.covariance, rtol=1e-8, atol=1e-9)
            assert_allclose(
                many.mode_probability[b][:, order], single.mode_probability, rtol=1e-8, atol=1e-12
            )


# --- refusals -------------------------------------------------------------------------------------


def test_refusals_say_what_was_wrong():
    imm = two_modes()
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match=r"times: 2 modes over 17 scans have 2\^18 = 262144"):
        posterior(imm, start, np.arange(1.0, 18.0), np.zeros((17, 1)))
    with pytest.raises(ValueError, match=r"have 3 x 2\^5 = 96 histories, expected at most 90"):
        posterior(imm, start, np.arange(1.0, 5.0), np.zeros((3, 4, 1)), limit=90)
    with pytest.raises(ValueError, match="do not decrease"):
        posterior(imm, start, [2.0, 1.0], np.zeros((2, 1)))
    with pytest.raises(ValueError, match="at least one scan"):
        posterior(imm, start, np.zeros(0), np.zeros((0, 1)))
    with pytest.raises(ValueError, match="times: expected shape"):
        posterior(imm, start, [1.0], np.zeros((2, 1)))
    bank = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)], mixing="unbiased")
    unequal = IMM(bank, imm.measurement)
    with pytest.raises(ValueError, match="no law of the emitter"):
        posterior(unequal, unequal.start(0.0, [0.0], [[1.0]]), [1.0], [[0.0]])
    with pytest.raises(ValueError, match="start: expected a state of this bank's modes"):
        posterior(unequal, start, [1.0], [[0.0]])


def test_unreachable_modes_have_no_probability():
    bank = Bank(
        [ConstantVelocity(psd=1.0), ConstantVelocity(psd=9.0)],
        transition=[[1.0, 0.0], [0.0, 1.0]],
        prior=[1.0, 0.0],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    found = posterior(imm, imm.start(0.0, [0.0], [[1.0]]), [1.0, 2.0], [[0.3], [np.nan]])
    assert_allclose(found.smoothed.mode_probability, [[1.0, 0.0]] * 2, rtol=0, atol=0)
    assert attrs.asdict(found.filtered, recurse=False)["mean"].shape == (2, 2)
    assert np.all(np.isfinite(found.smoothed.covariance))
