"""The batch maximum likelihood against closed forms, dense covariances and scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.stats import multivariate_normal
from selection_cases import TIMES, measured, path, star

from imm_tdoa import Stations
from imm_tdoa.contract import Array, Mask, Measurement
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Singer,
    Static,
)
from imm_tdoa.scans import Scans
from imm_tdoa.selection import maximum_likelihood
from imm_tdoa.selection.best_fit import weighted

TIMES_UNEVEN = np.array([3.0, 3.5, 5.0, 5.0, 8.0, 9.0, 13.0])


def dense(model: Any, times: Array, sigma: float) -> tuple[Array, Array]:
    """Design (2T, n) and covariance (2T, 2T) of direct fixes of a linear model started at x0."""
    T = len(times)
    n = len(model.components(2))
    A = np.zeros((T, 2, n))
    C = sigma**2 * np.eye(2 * T).reshape(T, 2, T, 2)
    Fs = [np.eye(n)]
    cov = [np.zeros((n, n))]
    for k in range(1, T):
        dt = times[k] - times[k - 1]
        F = model.transition(dt, 2)
        Fs.append(F @ Fs[-1])
        cov.append(F @ cov[-1] @ F.T + model.process_noise(dt, 2))
    for k in range(T):
        A[k] = Fs[k][:2]
        for j in range(k + 1):
            between = model.transition(times[k] - times[j], 2)
            C[k, :, j] += (between @ cov[j])[:2, :2]
            if j != k:
                C[j, :, k] += (between @ cov[j])[:2, :2].T
    return A.reshape(2 * T, n), C.reshape(2 * T, 2 * T)


LINEAR = [
    Static(psd=0.0),
    Static(psd=3.0),
    ConstantVelocity(psd=0.0),
    ConstantVelocity(psd=0.7),
    ConstantVelocity(std=0.5),
    ConstantAcceleration(psd=0.0),
    ConstantAcceleration(psd=0.02),
]


@pytest.mark.parametrize("model", LINEAR, ids=repr)
def test_linear_gaussian_models_are_exact(model: Any) -> None:
    """Generalised least squares with the joint covariance of all fixes, rows missing."""
    rng = np.random.default_rng(4)
    A, C = dense(model, TIMES_UNEVEN, 10.0)
    x0 = np.array([500.0, -300.0, 12.0, 5.0, 1.0, -0.5])[: A.shape[1]]
    z = A @ x0 + rng.standard_normal((2, len(A))) @ np.linalg.cholesky(C).T
    missing = np.zeros(z.shape, dtype=bool)
    missing[0, 3], missing[1, [0, 1, 7]] = True, True
    values = np.where(missing, np.nan, z).reshape(2, -1, 2)
    start = np.zeros(A.shape[1])
    found = maximum_likelihood(model, Position(10.0), TIMES_UNEVEN, values, start=start)
    for i in range(2):
        rows = ~missing[i]
        W = np.linalg.inv(C[np.ix_(rows, rows)])
        P = np.linalg.inv(A[rows].T @ W @ A[rows])
        best = P @ A[rows].T @ W @ z[i, rows]
        expected = multivariate_normal.logpdf(z[i, rows], A[rows] @ best, C[np.ix_(rows, rows)])
        np.testing.assert_allclose(found.state[i], best, rtol=1e-7, atol=1e-6)
        np.testing.assert_allclose(found.covariance[i], P, rtol=1e-7, atol=1e-9)
        assert found.log_likelihood[i] == pytest.approx(expected, abs=1e-8)
        assert found.rows[i] == np.count_nonzero(rows)
        n = A.shape[1]
        assert found.aic[i] == pytest.approx(-2.0 * expected + 2 * n)
        assert found.bic[i] == pytest.approx(-2.0 * expected + n * np.log(np.count_nonzero(rows)))
    assert np.all(found.converged)
    assert np.all(found.reason == "")


@pytest.mark.parametrize("form", [0, 1, 2])
def test_without_noise_it_is_least_squares(form: int) -> None:
    """SciPy's solution on Source A, for every motion form."""
    model = (Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0))[form]
    measurement = star()
    z = measured(measurement, path(form), np.random.default_rng(form), runs=1)[0]
    found = maximum_likelihood(model, measurement, TIMES, z)
    sigma = 100e-9 * measurement.speed
    for i in range(3):

        def residual(x: Array, i: int = i) -> Array:
            p = np.stack([model.propagate(x, t)[:2] for t in TIMES])
            h = measurement.predict(p, np.zeros_like(p), TIMES)
            return np.asarray((z[i] * measurement.speed - h).ravel() / sigma)

        scale = [1e5, 1e5, 1e3, 1e3, 1e2, 1e2][: found.parameters]
        truth = np.concatenate([path(form)[i, 0], [0.0, 1000.0 * (-1) ** i], [0.0, 0.0]])
        best = least_squares(
            residual,
            truth[: found.parameters],
            jac="3-point",
            x_scale=scale,
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        sd = np.sqrt(np.diag(found.covariance[i]))
        np.testing.assert_allclose(found.state[i] / sd, best.x / sd, rtol=0.0, atol=1e-3)
        size = -0.5 * (2.0 * best.cost + 63 * np.log(2.0 * np.pi * sigma**2))
        assert found.log_likelihood[i] == pytest.approx(size, abs=1e-6)


@pytest.mark.parametrize(
    "model", [ConstantVelocity(psd=1e4), Singer(std=30.0, time_constant=20.0)], ids=repr
)
def test_with_noise_nothing_better_is_near(model: Any) -> None:
    """A general minimiser of the same likelihood finds nothing that is better by 1e-3."""
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(3), runs=1)[0, 0]
    found = maximum_likelihood(model, measurement, TIMES, z)
    assert found.converged
    likelihood = weighted(model, Scans.checked(measurement, TIMES, z))
    sd = np.sqrt(np.diag(found.covariance))
    steps = 1e-3 * np.concatenate([np.zeros((1, len(sd))), np.eye(len(sd)), -np.eye(len(sd))])

    def cost(d: Array) -> tuple[float, Array]:
        here, up, down = np.split(likelihood(found.state + (d + steps) * sd).cost, [1, len(sd) + 1])
        return float(here[0]), (up - down) / 2e-3

    away = minimize(cost, np.full(len(sd), 0.1), jac=True, method="BFGS")
    assert -2.0 * found.log_likelihood < away.fun + 1e-3


def test_turning() -> None:
    """A nonlinear motion model, against SciPy."""
    model = CoordinatedTurn(psd=0.0, turn_rate_psd=0.0)
    measurement = Position(5.0)
    x0 = np.array([100.0, 200.0, 30.0, -10.0, 0.12])
    truth = np.stack([model.propagate(x0, t) for t in TIMES])
    z = truth[:, :2] + np.random.default_rng(0).normal(0.0, 5.0, (21, 2))
    found = maximum_likelihood(model, measurement, TIMES, z)
    best = least_squares(
        lambda x: (np.stack([model.propagate(x, t)[:2] for t in TIMES]) - z).ravel() / 5.0,
        x0,
        xtol=1e-14,
        ftol=1e-14,
    )
    np.testing.assert_allclose(found.state, best.x, rtol=1e-5)
    assert found.parameters == 5


def test_poor_starts() -> None:
    """From 200 km off and half the speed of the wrong sign it arrives all the same."""
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(5), runs=1)[0]
    good = maximum_likelihood(ConstantVelocity(psd=0.0), measurement, TIMES, z)
    offset = np.array([-1.2e5, 1.6e5, 500.0, -500.0])
    far = maximum_likelihood(
        ConstantVelocity(psd=0.0), measurement, TIMES, z, start=good.state + offset
    )
    assert np.all(far.converged)
    np.testing.assert_allclose(far.log_likelihood, good.log_likelihood, atol=1e-6)
    many = maximum_likelihood(
        ConstantVelocity(psd=0.0),
        measurement,
        TIMES,
        z,
        start=np.stack([good.state * 40.0, good.state + offset]),
    )
    np.testing.assert_allclose(many.log_likelihood, good.log_likelihood, atol=1e-6)


def test_unknown_emission_times_are_eliminated() -> None:
    """Arrival times say what their differences say; one row less for each emission."""
    stations = Stations([[0, 0], [9e3, 1e3], [4e3, 8e3], [-3e3, 6e3], [2e3, -5e3]])
    rng = np.random.default_rng(1)
    t = np.arange(12.0)
    p = np.stack([2e3 + 30.0 * t, 3e3 - 10.0 * t], axis=-1)
    toa = np.linalg.norm(p[:, None] - stations.positions, axis=-1) / 299792458.0
    toa = toa + rng.normal(0.0, 30e-9, toa.shape) + rng.uniform(0.0, 1.0, (12, 1))
    toa[3, 2], toa[7, 4] = np.nan, np.nan
    for model in (ConstantVelocity(psd=0.0), ConstantVelocity(psd=2.0)):
        by_toa = maximum_likelihood(model, TOA(stations, sigma=30e-9), t, toa)
        by_tdoa = maximum_likelihood(
            model, TDOA(stations, toa_sigma=30e-9), t, toa[:, 1:] - toa[:, :1]
        )
        assert by_toa.rows == by_tdoa.rows == 12 * 4 - 2
        assert by_toa.log_likelihood == pytest.approx(by_tdoa.log_likelihood, abs=1e-4)
        np.testing.assert_allclose(by_toa.state, by_tdoa.state, atol=1e-3)


class Bearing(Measurement):
    """Direction from the origin, rad."""

    dims = 2
    size = 1

    @property
    def angular(self) -> Mask:
        """It is an angle."""
        return np.array([True])

    def predict(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """Azimuth (..., 1)."""
        return np.arctan2(position[..., 1], position[..., 0])[..., None]

    def jacobian(
        self, position: Array, velocity: Array, time: float | Array
    ) -> tuple[Array, Array]:
        """Cross-range over range squared."""
        x, y = position[..., 0], position[..., 1]
        J = np.stack([-y, x], axis=-1) / (x**2 + y**2)[..., None]
        return J[..., None, :], np.zeros_like(J[..., None, :])

    def noise_covariance(self, position: Array, velocity: Array, time: float | Array) -> Array:
        """(0.01 rad)²."""
        return np.array([[1e-4]])


def test_angles_are_wrapped() -> None:
    """An emitter that crosses the cut of the angle, and the same scene turned away from it."""
    t = np.arange(30.0)
    p = np.stack([-1000.0 + 2.0 * t - 1.2 * t**2 / 4, -150.0 + 10.0 * t], axis=-1)
    model = ConstantAcceleration(psd=0.0)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (30, 1))
    start = np.array([*p[0], 2.0, 10.0, -0.6, 0.0])

    def fit(angle: float) -> Any:
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s], [s, c]])
        q = p @ turn.T
        z = np.arctan2(q[:, 1], q[:, 0])[:, None] + noise
        z = (z + np.pi) % (2.0 * np.pi) - np.pi
        there = (start.reshape(3, 2) @ turn.T).ravel()
        weights = weighted(model, Scans.checked(Bearing(), t, z))
        return weights(there)

    across, beside = fit(0.0), fit(1.5)
    assert across.cost == pytest.approx(beside.cost, abs=1e-9)
    assert across.cost < 30 * (np.log(2.0 * np.pi * 1e-4) + 2.0)


def test_row_weights() -> None:
    """Weight 0 is a missing row, weight w a standard deviation of sigma / sqrt(w)."""
    rng = np.random.default_rng(0)
    z = np.stack([5.0 * TIMES, -3.0 * TIMES], axis=-1) + rng.normal(0.0, 10.0, (21, 2))
    model = ConstantVelocity(psd=0.1)
    weight = np.ones((21, 2))
    weight[4] = 0.0
    plain = np.where(weight > 0.0, z, np.nan)
    at = np.zeros(4)
    one = maximum_likelihood(model, Position(10.0), TIMES, plain, start=at)
    two = maximum_likelihood(model, Position(10.0), TIMES, z, start=at, row_weight=weight)
    assert one.log_likelihood == pytest.approx(two.log_likelihood)
    assert two.rows == 40
    wide = maximum_likelihood(model, Position(20.0), TIMES, z, start=at)
    quarter = maximum_likelihood(
        model, Position(10.0), TIMES, z, start=at, row_weight=np.full((21, 2), 0.25)
    )
    np.testing.assert_allclose(wide.state, quarter.state, atol=1e-6)
    assert wide.log_likelihood == pytest.approx(quarter.log_likelihood)


def test_what_cannot_be_determined() -> None:
    """Too few rows, and enough rows that say too little: no number, and why."""
    measurement = Position(10.0)
    model = ConstantVelocity(psd=0.0)
    few = maximum_likelihood(model, measurement, [0.0], [[1.0, 2.0]], start=np.zeros(4))
    assert np.isnan(few.aic)
    assert np.isnan(few.bic)
    assert np.all(np.isnan(few.state))
    assert str(few.reason) == "4 unknowns need at least 4 rows"
    same = maximum_likelihood(
        model, measurement, [1.0, 1.0, 1.0], np.zeros((3, 2)), start=np.zeros(4)
    )
    assert np.isnan(same.aic)
    assert "do not determine" in str(same.reason)
    with pytest.raises(ValueError, match=r"row_weight: expected shares of 0 to 1"):
        maximum_likelihood(
            model, measurement, TIMES, np.zeros((21, 2)), row_weight=np.full((21, 2), 2.0)
        )


def test_a_late_fix_still_uses_every_row() -> None:
    """One pair at a time: the filter starts late, the likelihood counts from the first row."""
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(8), runs=1)[0, 0]
    sparse = np.full((63, 3), np.nan)
    for k in range(63):
        sparse[k, k % 3] = z[k // 3, k % 3]
    times = np.repeat(TIMES, 3)
    whole = maximum_likelihood(ConstantVelocity(psd=0.0), measurement, TIMES, z)
    split = maximum_likelihood(ConstantVelocity(psd=0.0), measurement, times, sparse)
    assert split.rows == 63
    assert split.log_likelihood == pytest.approx(whole.log_likelihood, abs=1e-6)


def test_pairs_that_change_from_scan_to_scan() -> None:
    """The same rows under changing pairs, with and without process noise, robustly weighted."""
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(8), runs=1)[0, 0]
    pairs = np.stack([np.roll([[1, 0], [2, 0], [3, 0]], k, axis=0) for k in range(21)])
    rolled = np.stack([np.roll(row, k) for k, row in enumerate(z)])
    weight = np.where(np.arange(21)[:, None] % 5 == 2, 0.3, 1.0) * np.ones((21, 3))
    for psd in (0.0, 1e4):
        model = ConstantVelocity(psd=psd)
        plain = maximum_likelihood(model, measurement, TIMES, z, row_weight=weight)
        paired = maximum_likelihood(
            model, measurement, TIMES, rolled, pairs=pairs, row_weight=weight
        )
        assert paired.log_likelihood == pytest.approx(plain.log_likelihood, abs=1e-3)
