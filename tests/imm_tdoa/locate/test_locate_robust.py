"""Fixes with gross errors: Student-t weights against the fix without the bad arrivals."""

from __future__ import annotations

import numpy as np
import pytest
from locate_cases import differences, distances, mahalanobis
from numpy.testing import assert_allclose

from imm_tdoa import Stations
from imm_tdoa.locate import fix_scans, gauss_newton
from imm_tdoa.models import TOA
from imm_tdoa.scans import Scans

RING = np.array(
    [
        (0, 0),
        (1000, 0),
        (0, 1000),
        (1100, 1200),
        (500, -400),
        (-700, 300),
        (-300, -800),
        (900, 500),
    ],
    float,
)
P = np.array([1500.0, 1800.0])


def arrivals(seed):
    rng = np.random.default_rng(seed)
    return distances(P, RING) + rng.normal(0.0, 1.0, len(RING))


@pytest.mark.parametrize("bad", [[3], [0], [2, 6]])
@pytest.mark.parametrize("size", [30.0, 3000.0])
def test_gross_errors_hardly_move_the_fix(bad, size):
    """Near the fix without the bad arrivals, be one of them the reference of all differences."""
    for seed in range(6):
        t = arrivals(seed)
        clean = np.delete(t, bad)
        t[bad] += size * np.array([1.0, -0.8])[: len(bad)]
        fix = gauss_newton(
            Stations(RING), differences(t), toa_sigma=1.0, speed=1.0, robust="student-t"
        )
        kept = Stations(np.delete(RING, bad, axis=0))
        good = gauss_newton(kept, differences(clean), toa_sigma=1.0, speed=1.0)
        plain = gauss_newton(Stations(RING), differences(t), toa_sigma=1.0, speed=1.0)
        assert bool(fix.converged)
        moved = mahalanobis(fix.position - good.position, good.covariance)
        assert moved < 2.0**2
        pulled = mahalanobis(plain.position - good.position, good.covariance)
        assert not bool(plain.converged) or pulled > 4.0**2
        assert np.max(fix.weight[0, bad]) < 0.05
        assert np.sum(fix.weight[0] > 0.3) >= len(RING) - len(bad) - 1


def test_good_data_lose_little():
    runs = 400
    t = distances(P, RING) + np.random.default_rng(0).normal(0.0, 1.0, (runs, len(RING)))
    z = differences(t)
    plain = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0)
    robust = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0, robust="student-t")
    assert robust.converged.all()
    assert robust.weight.shape == (runs, 1, len(RING))
    assert np.all((robust.weight > 0.0) & (robust.weight <= 1.0))
    spread = [np.mean(np.sum((f.position - P) ** 2, axis=-1)) for f in (plain, robust)]
    assert spread[1] < 1.4 * spread[0]


def test_the_robust_fix_is_the_maximum_of_the_student_likelihood():
    """Its weighted gradient vanishes, the common offset of the arrivals included."""
    t = arrivals(1)
    t[4] += 40.0
    fix = gauss_newton(Stations(RING), differences(t), toa_sigma=1.0, speed=1.0, robust="student-t")
    r = distances(fix.position, RING)
    u = (fix.position - RING) / r[:, None]
    w = fix.weight[0]
    offset = np.sum(w * (t - r)) / np.sum(w)
    e = t - r - offset
    assert_allclose(w, np.minimum(4.0 / (3.0 + e**2), 1.0), atol=1e-3)
    gradient = u.T @ (w * e)
    assert mahalanobis(gradient, np.linalg.inv(fix.covariance)) < 1e-6
    assert_allclose(np.sum(w * e**2), fix.chi2, rtol=1e-3)


def test_range_rates_with_gross_errors():
    rng = np.random.default_rng(5)
    v, vs = np.array([-20.0, 15.0]), rng.uniform(-30.0, 30.0, (8, 2))
    r = distances(P, RING)
    rate = np.sum((P - RING) * (v - vs), axis=-1) / r
    r, rate = r + rng.normal(0.0, 0.5, 8), rate + rng.normal(0.0, 0.05, 8)
    r[2] += 60.0
    rate[5] -= 4.0
    fix = gauss_newton(
        Stations(RING, velocities=vs),
        differences(r),
        toa_sigma=0.5,
        speed=1.0,
        range_rate=differences(rate),
        range_rate_sigma=0.05,
        robust="student-t",
    )
    assert bool(fix.converged)
    error = np.concatenate([fix.position - P, fix.velocity - v])
    assert mahalanobis(error, fix.covariance) < 20.0
    assert fix.weight.shape == (1, 16)
    assert fix.weight[0, 2] < 0.01
    assert fix.weight[0, 8 + 5] < 0.01


def test_any_reference_and_missing_differences():
    """Pairs against station 3, one of them missing: the arrivals are judged all the same."""
    t = arrivals(2)
    t[3] += 200.0
    pairs = np.array([[i, 3] for i in range(8) if i != 3])
    z = t[pairs[:, 0]] - t[3]
    z[1] = np.nan
    fix = gauss_newton(Stations(RING), z, toa_sigma=1.0, speed=1.0, pairs=pairs, robust="student-t")
    kept = np.delete(RING, [1, 3], axis=0)
    good = gauss_newton(Stations(kept), differences(np.delete(t, [1, 3])), toa_sigma=1.0, speed=1.0)
    assert mahalanobis(fix.position - good.position, good.covariance) < 1.0
    assert fix.weight[0, 3] < 1e-3
    assert fix.weight[0, 1] == 1.0


def test_independent_differences_are_judged_one_by_one():
    rng = np.random.default_rng(3)
    z = differences(distances(P, RING)) + rng.normal(0.0, 1.0, 7)
    z[5] -= 500.0
    fix = gauss_newton(Stations(RING), z, tdoa_sigma=1.0, speed=1.0, robust="student-t")
    kept = z.copy()
    kept[5] = np.nan
    good = gauss_newton(Stations(RING), kept, tdoa_sigma=1.0, speed=1.0)
    assert mahalanobis(fix.position - good.position, good.covariance) < 1.0
    assert fix.weight.shape == (1, 7)
    assert fix.weight[0, 5] < 1e-3


def test_a_batch_equals_its_members():
    t = np.stack([arrivals(seed) for seed in range(5)])
    t[np.arange(5), [1, 0, 4, 7, 2]] += 300.0
    t[2, 5] = np.nan
    toa = TOA(Stations(RING), sigma=1.0, speed=1.0)
    batch = fix_scans(Scans.checked(toa, [0.0], t[:, None]), robust="student-t")
    for k in range(5):
        one = fix_scans(Scans.checked(toa, [0.0], t[k, None]), robust="student-t")
        assert_allclose(batch.position[k], one.position, atol=1e-2)
        assert_allclose(batch.weight[k], one.weight, atol=1e-3)
