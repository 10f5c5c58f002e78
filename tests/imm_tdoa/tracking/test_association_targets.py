"""From states to predicted rows and back, against the IMM itself."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Static,
)
from imm_tdoa.tracking import (
    GlobalNearest,
    Jpda,
    Nearest,
    Unlabelled,
    predict_rows,
    take_in,
)

STATIONS = Stations([[0.0, 0.0], [5e4, 0.0], [-2e4, 4e4], [-3e4, -4e4], [2e4, 4.5e4]])
MEASUREMENT = TDOA(STATIONS, toa_sigma=70e-9)
BANK = Bank(
    [Static(psd=1.0), ConstantVelocity(psd=10.0), ConstantAcceleration(psd=1.0)],
    birth_std={"velocity": 100.0, "acceleration": 5.0},
)
PLACES = np.array([[8e3, 5e3], [-9e3, 7e3], [3e3, -1.1e4]])


def predicted(imm, after=2.0):
    state = imm.start(np.zeros(3), PLACES, np.tile(2500.0 * np.eye(2), (3, 1, 1)))
    nothing = np.full((3, imm.measurement.size), np.nan)
    return imm.step(state, np.full(3, after), nothing)


def scan_of(measurement, places, rng):
    """Rows of all targets at all stations, shuffled; and the labels."""
    R = measurement.noise_covariance(places, np.zeros_like(places), 0.0)
    z = measurement.predict(places, np.zeros_like(places), 0.0)
    z = z + np.einsum(
        "nij,nj->ni",
        np.linalg.cholesky(np.broadcast_to(R, (*z.shape, z.shape[1]))),
        rng.normal(size=z.shape),
    )
    n, i = np.indices(z.shape)
    mixed = rng.permutation(z.size)
    return z, Unlabelled(z.ravel()[mixed], i.ravel()[mixed]), n.ravel()[mixed]


def test_predicted_rows_are_what_the_imm_judges_a_scan_by():
    imm = IMM(BANK, MEASUREMENT)
    state = predicted(imm)
    z, _, _ = scan_of(MEASUREMENT, PLACES + 30.0, np.random.default_rng(0))
    after = imm.step(state, state.time, z / MEASUREMENT.scale)
    mean, S = predict_rows(MEASUREMENT, state).bank()
    nu = z - mean
    assert_allclose(np.einsum("ni,ni->n", nu, np.linalg.solve(S, nu[..., None])[..., 0]), after.nis)


def test_predicting_first_and_taking_in_at_no_length_is_one_step():
    imm = IMM(BANK, MEASUREMENT)
    z, _, _ = scan_of(MEASUREMENT, PLACES + 30.0, np.random.default_rng(1))
    start = imm.start(np.zeros(3), PLACES, np.tile(2500.0 * np.eye(2), (3, 1, 1)))
    whole = imm.step(start, np.full(3, 2.0), z / MEASUREMENT.scale)
    halves = imm.step(predicted(imm), np.full(3, 2.0), z / MEASUREMENT.scale)
    assert_allclose(halves.mean, whole.mean, rtol=1e-12)
    assert_allclose(halves.covariance, whole.covariance, rtol=1e-10, atol=1e-9)
    assert_allclose(halves.log_likelihood, whole.log_likelihood, rtol=1e-12)


@pytest.mark.parametrize("associator", [Nearest(), GlobalNearest(over="station"), GlobalNearest()])
def test_shuffled_rows_of_targets_far_apart_find_their_targets(associator):
    imm = IMM(BANK, MEASUREMENT)
    z, scan, label = scan_of(MEASUREMENT, PLACES + 30.0, np.random.default_rng(2))
    got = associator(predict_rows(MEASUREMENT, predicted(imm)), scan)
    assert_array_equal(got.values, z)
    assert_array_equal(np.argmax(got.weight, axis=0), label)


@pytest.mark.parametrize("emissions", [False, True])
def test_a_sure_association_weighed_is_the_step_of_the_imm(emissions):
    """Three unequal modes, rows that share the reference's error: soft equals hard."""
    imm = IMM(BANK, MEASUREMENT)
    state = predicted(imm)
    z, scan, label = scan_of(MEASUREMENT, PLACES + 30.0, np.random.default_rng(3))
    if emissions:
        scan = attrs.evolve(scan, emission=label)
    got = Jpda(0.95, 1e-40)(predict_rows(MEASUREMENT, state), scan)
    assert_allclose(got.weight[label, np.arange(len(label))], 1.0)
    soft = take_in(MEASUREMENT, state, got)
    hard = imm.step(state, state.time, z / MEASUREMENT.scale)
    assert_allclose(soft.mode_probability, hard.mode_probability, rtol=1e-7, atol=1e-12)
    assert_allclose(soft.mean, hard.mean, rtol=1e-7, atol=1e-6)
    scale = np.sqrt(np.einsum("nii->ni", hard.covariance))
    apart = (soft.covariance - hard.covariance) / (scale[:, :, None] * scale[:, None, :])
    assert_allclose(apart, 0.0, atol=1e-7)
    heard = 1 if emissions else MEASUREMENT.size
    relative = soft.log_likelihood - heard * np.log(0.95) + MEASUREMENT.size * np.log(1e-40)
    assert_allclose(relative, hard.log_likelihood, rtol=1e-8)


def test_a_scan_of_nobody_leaves_the_prediction_and_speaks_against_the_target():
    imm = IMM(BANK, MEASUREMENT)
    state = predicted(imm)
    false = Unlabelled([-4e4, 4e4], [0, 1])
    got = Jpda(0.9, 1e-5, gate_probability=0.999)(predict_rows(MEASUREMENT, state), false)
    after = take_in(MEASUREMENT, state, got)
    assert_allclose(after.mean, state.mean, rtol=1e-12)
    assert_allclose(after.covariance, state.covariance, rtol=1e-8, atol=1e-6)
    assert_allclose(after.mode_probability, state.mode_probability)
    assert_allclose(after.log_likelihood - state.log_likelihood, 2 * np.log(1 - 0.9 * 0.999))


def test_a_station_that_cannot_hear_is_left_out():
    places = np.broadcast_to(STATIONS.positions, (2, 5, 2)).copy()
    places[1, 4] = np.nan
    stations = Stations(places, times=[0.0, 4.0])
    measurement = TDOA(stations, toa_sigma=70e-9)
    imm = IMM(BANK, measurement)
    state = predicted(imm)
    prediction = predict_rows(measurement, state)
    assert_array_equal(prediction.known, [[True, True, True, False]] * 3)
    mean, _ = prediction.bank()
    scan = Unlabelled([*mean[0, :3], 0.0], [0, 1, 2, 3])
    got = Jpda(0.9, 1e-6)(prediction, scan)
    assert_array_equal(got.weight[:, 3], 0.0)
    after = take_in(measurement, state, got)
    assert np.all(np.isfinite(after.mean))
    assert np.trace(after.covariance[0, :2, :2]) < 0.9 * np.trace(state.covariance[0, :2, :2])


def test_what_cannot_be_associated_is_refused():
    imm = IMM(BANK, MEASUREMENT)
    state = predicted(imm)
    decided = GlobalNearest()(predict_rows(MEASUREMENT, state), Unlabelled([], []))
    with pytest.raises(ValueError, match="association: it was decided"):
        take_in(MEASUREMENT, state, decided)
    one = imm.start(0.0, PLACES[0], np.eye(2))
    with pytest.raises(ValueError, match="state: expected a batch of N targets"):
        predict_rows(MEASUREMENT, one)
    with pytest.raises(ValueError, match="measurement: its rows share an unknown offset"):
        predict_rows(TOA(STATIONS, sigma=70e-9), state)
