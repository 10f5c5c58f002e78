"""The iterated update: where the posterior really is, however diffuse the prediction."""

from typing import Any

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares, minimize

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import TDOA, ConstantVelocity, Position, Static

STATIONS = Stations([[0, 0], [9_000, 1_000], [4_000, 8_000], [-3_000, 6_000]])
SIGMA = 30e-9


def observed(measurement: TDOA, place: np.ndarray, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    arrivals = np.linalg.norm(place - STATIONS.positions, axis=-1) / measurement.speed
    arrivals = arrivals + rng.normal(0, SIGMA, arrivals.shape)
    return np.asarray(arrivals[1:] - arrivals[0])


def test_a_linear_measurement_needs_no_iteration() -> None:
    bank = Bank([ConstantVelocity(psd=1.0), Static(psd=1.0)], mean_sojourn=10.0)
    states = []
    for update in ("ekf", "iekf"):
        imm = IMM(bank, Position(5.0), update=update)
        state = imm.start(0.0, [0.0, 0.0], np.diag([1e6, 1e6]))
        for k in range(1, 6):
            state = imm.step(state, float(k), [1e4 * k, 5.0 * k])
        states.append(state)
    assert_allclose(states[0].mean, states[1].mean, rtol=1e-12)
    assert_allclose(states[0].log_likelihood, states[1].log_likelihood, rtol=1e-12)


@pytest.mark.parametrize("start", [[2_000.0, 3_000.0], [9_000.0, 9_000.0], [-4_000.0, -2_000.0]])
def test_it_ends_at_the_maximum_of_the_posterior(start: list[float]) -> None:
    """Oracle: scipy's minimiser on the posterior written out."""
    truth = np.array([2_500.0, 2_000.0])
    measurement = TDOA(STATIONS, toa_sigma=SIGMA)
    z = observed(measurement, truth)
    P = np.diag([4e6, 9e6])
    R = measurement.sensor_covariance(0.0)

    def misfit(p: np.ndarray) -> float:
        nu = z * measurement.speed - measurement.predict(p, 0 * p, 0.0)
        away = p - np.array(start)
        return float(nu @ np.linalg.solve(R, nu) + away @ np.linalg.solve(P, away))

    best = minimize(misfit, truth, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-12})
    imm = IMM(Bank([Static(psd=0.0)]), measurement, update="iekf")
    state = imm.step(imm.start(0.0, start, P), 1.0, z)
    sigma = np.sqrt(np.diag(state.covariance))
    assert_allclose(state.mean / sigma, best.x / sigma, atol=5e-3)


def test_the_plain_update_is_lost_there_and_the_iterated_is_not() -> None:
    """A prediction 30 km off with 20 km of spread: 600 sigmas of one difference."""
    truth = np.array([2_500.0, 2_000.0])
    measurement = TDOA(STATIONS, toa_sigma=SIGMA)
    z = observed(measurement, truth)
    error = {}
    for update in ("ekf", "iekf"):
        imm = IMM(Bank([ConstantVelocity(psd=1.0)]), measurement, update=update)
        state = imm.start(0.0, [22_000.0, 25_000.0], np.diag([4e8, 4e8]))
        error[update] = np.linalg.norm(imm.step(state, 1.0, z).mean[:2] - truth)
    assert error["iekf"] < 50.0  # five of the fix's 10 m
    assert error["ekf"] > 1_000.0


def test_the_gate_allows_for_the_bend_but_not_for_a_gross_error() -> None:
    truth = np.array([2_500.0, 2_000.0])
    measurement = TDOA(STATIONS, toa_sigma=SIGMA)
    imm = IMM(Bank([Static(psd=0.0)]), measurement, update="iekf", robust="gate")
    start = imm.start(0.0, [3_500.0, 3_000.0], np.diag([1e6, 1e6]))
    good = observed(measurement, truth)
    assert imm.step(start, 1.0, good).nis_dof == 3
    bad = good + np.array([0.0, 0.0, 1e-4])  # 30 km
    state = imm.step(start, 1.0, bad)
    assert state.nis_dof == 2
    assert np.linalg.norm(state.mean[:2] - truth) < 100.0


def test_a_batch_is_its_targets_one_by_one() -> None:
    rng = np.random.default_rng(3)
    measurement = TDOA(STATIONS, toa_sigma=SIGMA)
    truth = rng.uniform(0, 8_000, (20, 2))
    z = np.array([observed(measurement, p, seed=k) for k, p in enumerate(truth)])
    z[rng.random(z.shape) < 0.1] = np.nan
    bank = Bank([Static(psd=0.0), ConstantVelocity(psd=1.0)], mean_sojourn=20.0)
    imm = IMM(bank, measurement, update="iekf", robust="gate")
    centre = truth + rng.normal(0, 3_000, truth.shape)
    P = np.diag([9e6, 9e6])
    together = imm.step(imm.start(0.0, centre, P), 2.0, z)
    for k in range(20):
        alone = imm.step(imm.start(0.0, centre[k], P), 2.0, z[k])
        assert_array_equal(alone.nis_dof, together.nis_dof[k])
        scale = np.sqrt(np.diag(alone.covariance)) + 1e-12
        # A target may iterate on while it waits for others: closer to the same maximum.
        assert np.all(np.abs(alone.mean - together.mean[k]) < 2e-3 * scale)


def test_an_unknown_update_is_refused() -> None:
    with pytest.raises(ValueError, match=r"update: expected one of 'ekf', 'iekf', .*, got 'ufk'"):
        IMM(Bank([Static(psd=0.0)]), TDOA(STATIONS, toa_sigma=SIGMA), update="ufk")  # type: ignore[arg-type]


def test_an_update_that_fits_better_than_promised_is_iterated_too() -> None:
    """Of vague predictions: the mean is where scipy finds the posterior highest."""
    rng = np.random.default_rng(12)
    angle = 2.0 * np.pi * np.arange(7) / 7.0
    stations = Stations(40e3 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    measurement = TDOA(stations, toa_sigma=SIGMA)
    imm = IMM(Bank([Static(psd=0.0)]), measurement, update="iekf")
    promised = []
    for _ in range(40):
        mean = rng.uniform(-30e3, 30e3, 2)
        place = mean + 8e3 * rng.normal(size=2)
        clean = measurement.predict(place, np.zeros(2), 0.0)
        R = measurement.noise_covariance(place, np.zeros(2), 0.0)
        z = clean + np.linalg.cholesky(R) @ rng.normal(size=6)
        start = imm.start(0.0, mean, 64e6 * np.eye(2))
        state = imm.step(start, 0.0, z / measurement.scale)
        root = np.linalg.cholesky(np.linalg.inv(R)).T

        def misfit(x: Any, mean: Any = mean, z: Any = z, root: Any = root) -> Any:
            h = measurement.predict(x, np.zeros(2), 0.0)
            return np.concatenate([(x - mean) / 8e3, root @ (z - h)])

        best = least_squares(misfit, place, x_scale=8e3, xtol=1e-12, ftol=1e-12, gtol=1e-12)
        std = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac)))
        assert np.all(np.abs(state.mean - best.x) < 0.02 * std)
        plain = attrs.evolve(imm, update="ekf").step(start, 0.0, z / measurement.scale)
        promised.append(np.sum(misfit(plain.mean) ** 2) < 0.99 * float(plain.nis) - 0.1)
    assert sum(promised) >= 3  # such as a one-sided test would have left as they were
