"""Filtered values are coloured, and nothing takes them for measurements unasked."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sequence_cases import FIELD, PLACE, SIGMA, course, differences

from imm_tdoa import IMM, Bank, SequenceFilter, Stations
from imm_tdoa.models import TDOA, ConstantVelocity, Static


def test_coloured_output_is_no_measurement() -> None:
    times, tdoa = np.arange(8.0), differences(FIELD, course(8), 4)
    tdoa[3, 1] = np.nan
    stations = Stations(FIELD)
    found = SequenceFilter(stations, toa_sigma=SIGMA).run(times, tdoa)
    for name in ("values", "tdoa", "measurements"):
        with pytest.raises(AttributeError, match="coloured"):
            getattr(found, name)
    with pytest.raises(AttributeError, match="no attribute 'speed'"):
        found.speed  # noqa: B018
    assert repr(found) == (
        "FilteredSequence(8 epochs, 4 differences; coloured, no measurements for a tracker)"
    )
    measurement = TDOA(stations, toa_sigma=SIGMA, pairs="adjacent")
    imm = IMM(Bank([Static(psd=0.0), ConstantVelocity(psd=1.0)], mean_sojourn=60.0), measurement)
    with pytest.raises(
        ValueError, match=r"values: expected numbers, got FilteredSequence.*coloured"
    ):
        imm.run(times, found)
    with pytest.warns(UserWarning, match="coloured"):
        model, stamps, values, pairs = found.scans()
    assert pairs is None
    assert_array_equal(stamps, times)
    assert_array_equal(np.isnan(values), np.isnan(tdoa))
    assert_array_equal(values[0], tdoa[0])
    R = model.noise_covariance(PLACE, 0.0 * PLACE, 0.0)
    assert_allclose(R, measurement.noise_covariance(PLACE, 0.0 * PLACE, 0.0))
    assert_array_equal(pickle.loads(pickle.dumps(found)).position, found.position)
    assert "3 runs" not in repr(found)
    many = SequenceFilter(stations, toa_sigma=SIGMA).run(times, np.stack([tdoa] * 3))
    assert "3 runs, 8 epochs" in repr(many)


def test_raw_noise_is_what_filtered_values_are_worth() -> None:
    """`scans` keeps R: of a smoother with gain K, K/(2-K) R times (2-K)/K for the correlation.

    The mean of many filtered values then has the variance that a tracker takes it to have.
    """
    K, T, runs = 0.2, 400, 4000
    z = np.random.default_rng(5).standard_normal((runs, T))
    x = np.zeros((runs, T))
    for k in range(1, T):
        x[:, k] = x[:, k - 1] + K * (z[:, k] - x[:, k - 1])
    last = x[:, 100:]
    assert_allclose(np.var(last), K / (2.0 - K), rtol=0.05)
    assert_allclose(np.var(last.mean(axis=1)) * 300, 1.0, atol=4.0 * np.sqrt(2.0 / runs))
