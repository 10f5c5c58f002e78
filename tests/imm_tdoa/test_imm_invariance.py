"""Nothing depends on the bookkeeping: not on the reference, the units or the axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_cases import BIRTH, CORNERS, SIGMA, arrivals, bank_of, differences, irregular, seeds
from imm_oracles import C
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import TDOA, TOA, ConstantAcceleration, ConstantVelocity, Static

FORMS = {
    "station 2": lambda s: TDOA(s, toa_sigma=SIGMA, pairs=[[i, 2] for i in (0, 1, 3, 4)]),
    "adjacent": lambda s: TDOA(s, toa_sigma=SIGMA, pairs="adjacent"),
    "all pairs": lambda s: TDOA(
        s, toa_sigma=SIGMA, pairs=[[i, j] for j in range(5) for i in range(5) if i != j]
    ),
    "arrivals": lambda s: TOA(s, sigma=SIGMA),
}


@pytest.mark.parametrize(
    ("form", "seed"),
    # a silent station breaks a chain of adjacent pairs, so that one only where all are heard
    [(form, seed) for form in FORMS for seed in range(4) if form != "adjacent" or seed < 2],
)
def test_the_reference_station_does_not_matter(form, seed):
    """Estimate, covariance, mode probability and log-likelihood, to 1e-9 (ALGORITHMS §1.1)."""
    rng = np.random.default_rng(seed)
    t = irregular(rng, 10)
    toa = arrivals(rng, t)
    if seed >= 2:  # one station silent for a while, not the reference of either form
        toa[3:6, 4] = np.nan
    stations = Stations(CORNERS)
    bank = bank_of()
    tracks = []
    for measurement in (TDOA(stations, toa_sigma=SIGMA), FORMS[form](stations)):
        imm = IMM(bank, measurement)
        if form == "arrivals" and isinstance(measurement, TOA):
            values = toa + rng.uniform(0.0, 1e-3, (10, 1))  # any emission time
        else:
            values = differences(toa, measurement.pairs)
        start = imm.start(0.0, [705.0, 890.0], np.diag([900.0, 400.0]))
        tracks.append(imm.run(t, values, start=start))
    a, b = tracks
    assert_allclose(b.mean, a.mean, rtol=1e-9, atol=1e-8)
    assert_allclose(b.covariance, a.covariance, rtol=1e-9, atol=1e-8)
    assert_allclose(b.mode_probability, a.mode_probability, rtol=1e-9, atol=1e-12)
    assert_allclose(b.log_likelihood, a.log_likelihood, rtol=1e-9)
    assert_allclose(b.nis, a.nis, rtol=1e-8)
    assert_array_equal(b.nis_dof, a.nis_dof)


def test_unequal_arrival_errors_keep_the_reference_irrelevant():
    rng = np.random.default_rng(9)
    sigma = np.array([5e-9, 40e-9, 10e-9, 20e-9, 8e-9])
    t = irregular(rng, 10)
    toa = arrivals(rng, t, sigma=sigma)
    stations, tracks = Stations(CORNERS), []
    for measurement in (
        TDOA(stations, toa_sigma=sigma),
        TDOA(stations, toa_sigma=sigma, pairs=[[i, 3] for i in (0, 1, 2, 4)]),
        TOA(stations, sigma=sigma),
    ):
        imm = IMM(bank_of(), measurement)
        values = toa if isinstance(measurement, TOA) else differences(toa, measurement.pairs)
        start = imm.start(0.0, [705.0, 890.0], np.diag([900.0, 400.0]))
        tracks.append(imm.run(t, values, start=start))
    for other in tracks[1:]:
        assert_allclose(other.mean, tracks[0].mean, rtol=1e-9, atol=1e-8)
        assert_allclose(other.covariance, tracks[0].covariance, rtol=1e-9, atol=1e-8)
        assert_allclose(other.mode_probability, tracks[0].mode_probability, rtol=1e-9, atol=1e-12)
        assert_allclose(other.log_likelihood, tracks[0].log_likelihood, rtol=1e-9)


def kilometre_bank(u):
    """The same bank where lengths are given in units of u metres."""
    return Bank(
        [
            Static(psd=0.5 / u**2),
            ConstantVelocity(psd=2.0 / u**2),
            ConstantAcceleration(psd=0.3 / u**2),
        ],
        mean_sojourn=20.0,
        birth_std={kind: std / u for kind, std in BIRTH.items()},
    )


@pytest.mark.parametrize("length", [1.0, 1e3, 0.3048])
@pytest.mark.parametrize("second", [1.0, 1e-9])
def test_units_change_nothing_but_the_units(length, second):
    """Metres or kilometres; differences in seconds or nanoseconds, with speed= to match."""
    rng = np.random.default_rng(6)
    t = irregular(rng, 10)
    toa = arrivals(rng, t)
    base = IMM(kilometre_bank(1.0), TDOA(Stations(CORNERS), toa_sigma=SIGMA))
    other = IMM(
        kilometre_bank(length),
        TDOA(Stations(CORNERS / length), toa_sigma=SIGMA / second, speed=C * second / length),
    )
    z = differences(toa, base.measurement.pairs)
    mean, P = np.array([705.0, 890.0]), np.diag([900.0, 400.0])
    a = base.run(t, z, start=base.start(0.0, mean, P))
    b = other.run(t, z / second, start=other.start(0.0, mean / length, P / length**2))
    assert_allclose(b.mean * length, a.mean, rtol=1e-9, atol=1e-8)
    assert_allclose(b.covariance * length**2, a.covariance, rtol=1e-9, atol=1e-8)
    assert_allclose(b.mode_probability, a.mode_probability, rtol=1e-9, atol=1e-13)
    assert_allclose(b.nis, a.nis, rtol=1e-9)
    rows = np.cumsum(a.nis_dof)  # a density per unit length: each row brings log(length)
    assert_allclose(b.log_likelihood - rows * np.log(length), a.log_likelihood, rtol=1e-9)


@settings(deadline=None, max_examples=8)
@given(seed=seeds, angle=st.floats(-np.pi, np.pi), mirror=st.booleans())
def test_translation_and_rotation_move_the_answer_along(seed, angle, mirror):
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-5e4, 5e4, 2)
    A = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if mirror:
        A = A @ np.diag([1.0, -1.0])
    t = irregular(rng, 8)
    toa = arrivals(rng, t)
    a = IMM(bank_of(), TOA(Stations(CORNERS), sigma=SIGMA))
    b = IMM(bank_of(), TOA(Stations(CORNERS @ A.T + shift), sigma=SIGMA))
    mean, P = np.array([705.0, 890.0]), np.array([[900.0, 200.0], [200.0, 400.0]])
    a = a.run(t, toa, start=a.start(0.0, mean, P))
    b = b.run(t, toa, start=b.start(0.0, A @ mean + shift, A @ P @ A.T))
    full = np.kron(np.eye(3), A)
    want = a.mean @ full.T
    want[:, :2] += shift
    assert_allclose(b.mean, want, rtol=1e-9, atol=1e-6)
    assert_allclose(b.covariance, full @ a.covariance @ full.T, rtol=1e-7, atol=1e-6)
    assert_allclose(b.mode_probability, a.mode_probability, rtol=1e-7, atol=1e-12)
    assert_allclose(b.log_likelihood, a.log_likelihood, rtol=1e-8, atol=1e-8)
