"""What every smoothed track must be, and a birth law, for the tests of the smoother."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

BIRTH = {"velocity": 20.0, "acceleration": 2.0, "turn_rate": 0.1}


def assert_proper(track):
    """Symmetric positive semi-definite covariances, probabilities that sum to one, no NaN."""
    assert_allclose(track.mode_probability.sum(axis=-1), 1.0, atol=1e-12)
    assert np.all(np.isfinite(track.mean))
    for P in (*track.mode_covariances, track.covariance):
        assert np.all(np.isfinite(P))
        assert_array_equal(P, np.swapaxes(P, -1, -2))
        sd = np.sqrt(np.maximum(np.einsum("...ii->...i", P), 1e-300))
        assert np.linalg.eigvalsh(P / (sd[..., :, None] * sd[..., None, :])).min() > -1e-9
