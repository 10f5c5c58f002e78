"""One Gaussian: prediction, update, missing rows, shared offsets, data snooping."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_oracles import correct, log_normal
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import gaussian

seeds = st.integers(0, 2**32 - 1)


def spd(rng, n, scale=1.0):
    A = rng.normal(size=(n, n + 2))
    return scale * A @ A.T


def problem(seed, n, m):
    rng = np.random.default_rng(seed)
    x, P = rng.normal(size=n), spd(rng, n)
    return rng, x, P, rng.normal(size=m), rng.normal(size=(m, n)), spd(rng, m)


def test_wrap_lands_in_the_half_open_interval_and_changes_by_whole_turns():
    angle = np.linspace(-20.0, 20.0, 4001)
    w = gaussian.wrap(angle)
    assert np.all((w >= -np.pi) & (w < np.pi))
    assert_allclose((angle - w) / (2 * np.pi), np.round((angle - w) / (2 * np.pi)), atol=1e-12)
    assert gaussian.wrap(np.array(np.pi)) == -np.pi
    assert gaussian.wrap(np.array(-np.pi)) == -np.pi


def test_predicted_covariance_is_exactly_symmetric():
    rng = np.random.default_rng(0)
    P, F, Q = spd(rng, 6), rng.normal(size=(6, 6)), spd(rng, 6)
    C = gaussian.predict_covariance(P, F, Q)
    assert_allclose(C, F @ P @ F.T + Q, rtol=1e-12)
    assert_array_equal(C, C.T)


@settings(deadline=None, max_examples=40)
@given(seed=seeds, n=st.integers(1, 6), m=st.integers(1, 5), data=st.data())
def test_missing_rows_are_as_if_cut_out(seed, n, m, data):
    present = np.array(data.draw(st.lists(st.booleans(), min_size=m, max_size=m)))
    _, x, P, nu, H, R = problem(seed, n, m)
    dirty = np.where(present, nu, np.nan)
    got = gaussian.update(x, P, dirty, H, R, present)
    want = correct(x, P, nu[present], H[present], R[np.ix_(present, present)])
    assert_allclose(got.x, want[0], rtol=1e-9, atol=1e-9)
    assert_allclose(got.P, want[1], rtol=1e-8, atol=1e-8 * np.trace(P))
    assert_allclose(got.log_likelihood, want[2], rtol=1e-9, atol=1e-9)
    assert_array_equal(got.P, got.P.T)
    if not present.any():
        assert_array_equal(got.x, x)
        assert_array_equal(got.P, gaussian.symmetric(P))
        assert (got.log_likelihood, got.nis) == (0.0, 0.0)


@settings(deadline=None, max_examples=20)
@given(seed=seeds)
def test_a_batch_is_its_elements(seed):
    rng = np.random.default_rng(seed)
    x, nu, H = rng.normal(size=(3, 4)), rng.normal(size=(3, 2)), rng.normal(size=(3, 2, 4))
    P, R = np.stack([spd(rng, 4) for _ in range(3)]), np.stack([spd(rng, 2) for _ in range(3)])
    present = rng.uniform(size=(3, 2)) < 0.6
    whole = gaussian.update(x, P, nu, H, R, present)
    for b in range(3):
        one = gaussian.update(x[b], P[b], nu[b], H[b], R[b], present[b])
        for got, want in zip(whole, one, strict=True):
            assert_allclose(got[b], want, rtol=1e-13, atol=1e-13)


def test_log_likelihood_stays_finite_far_out_in_the_tail():
    u = gaussian.update(
        np.zeros(1), np.eye(1), np.array([1e4]), np.eye(1), np.eye(1), np.array([True])
    )
    assert_allclose(u.log_likelihood, -0.5 * (1e8 / 2 + np.log(2) + np.log(2 * np.pi)), rtol=1e-15)


def test_a_singular_innovation_covariance_is_named():
    with pytest.raises(ValueError, match="innovation covariance: not positive definite"):
        gaussian.update(
            np.zeros(2),
            np.zeros((2, 2)),
            np.zeros(1),
            np.ones((1, 2)),
            np.zeros((1, 1)),
            np.array([True]),
        )


GROUPS = st.lists(st.sampled_from([-1, 0, 1]), min_size=2, max_size=6)


def projected_precision(S, present, group):
    """S^-1 of the present rows, unknown offsets of the groups projected out, in full size."""
    m = len(group)
    W = np.zeros((m, m))
    i = np.flatnonzero(present)
    W[np.ix_(i, i)] = np.linalg.inv(S[np.ix_(i, i)])
    A = np.stack([(group == g) & present for g in (0, 1)], axis=1).astype(float)
    A = A[:, A.any(axis=0)]
    if A.size:
        W = W - W @ A @ np.linalg.inv(A.T @ W @ A) @ A.T @ W
    return W


@settings(deadline=None, max_examples=60)
@given(seed=seeds, group=GROUPS, data=st.data())
def test_offset_contrast_keeps_the_reference_free_information(seed, group, data):
    """T R T' on what remains carries W - W1 1'W / 1'W1 (ALGORITHMS §1.1), and its likelihood."""
    m = len(group)
    present = np.array(data.draw(st.lists(st.booleans(), min_size=m, max_size=m)))
    group = np.array(group)
    _, _, _, nu, H, R = problem(seed, 3, m)
    T, kept = gaussian.offset_contrast(np.diag(R), present, group)
    W = projected_precision(R, present, group)
    k = np.flatnonzero(kept)
    TH, Tnu = (T @ np.where(present[:, None], H, 0.0))[k], (T @ np.where(present, nu, 0.0))[k]
    both = present[:, None] & present
    RT = (T @ np.where(both, R, 0.0) @ T.T)[np.ix_(k, k)]
    assert len(k) == present.sum() - sum(np.any(present & (group == g)) for g in (0, 1))
    inverse = np.linalg.inv(RT) if len(k) else np.zeros((0, 0))
    assert_allclose(TH.T @ inverse @ TH, H.T @ W @ H, rtol=1e-6, atol=1e-8)
    assert_allclose(TH.T @ inverse @ Tnu, H.T @ W @ nu, rtol=1e-6, atol=1e-8)
    if len(k):
        i = np.flatnonzero(present)
        _, log_det = np.linalg.slogdet(R[np.ix_(i, i)])
        for g in (0, 1):
            one = (present & (group == g)).astype(float)[i]
            if one.any():
                others = np.linalg.inv(R[np.ix_(i, i)])
                if g == 1 and np.any(present & (group == 0)):
                    others = projected_precision(R, present, np.where(group == 0, 0, -1))[
                        np.ix_(i, i)
                    ]
                log_det += np.log(one @ others @ one)
        quadratic = nu @ W @ nu
        want = -0.5 * (quadratic + log_det + len(k) * np.log(2 * np.pi))
        assert_allclose(log_normal(Tnu, RT), want, rtol=1e-7, atol=1e-7)
