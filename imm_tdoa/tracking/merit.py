"""How well a track explains a scan, in a measure by which rivals of any age compare."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array, Mask


def merit(
    nis: Array,
    dof: Array,
    took: Mask,
    expected: Mask,
    variance: Array,
    density: Array,
    detection_probability: float,
) -> Array:
    """Return the merit (N,) of N tracks in a scan, nats.

    The log-ratio that a track which knows exactly where it is would expect for its rows, less
    half of what its normalised innovation exceeds its degrees of freedom by. The true
    log-ratio also counts how vague the prediction was: that speaks against every young track,
    and does not tell a ghost from a target.

    Parameters
    ----------
    nis, dof : (N,)
        Normalised innovation squared and its degrees of freedom; NaN and 0 for nothing.
    took, expected : (N, m)
        Rows taken, and rows heard by anyone that the track could have.
    variance, density : (m,)
        Noise variance of the rows, and density of false values.
    detection_probability : float
        Probability that a row of a target is measured.
    """
    P_D = min(detection_probability, 0.999)
    known = np.isfinite(variance) & (variance > 0.0)
    sure = (
        np.log(P_D)
        - np.log(density)
        - 0.5 * np.log(2.0 * np.pi * np.e * np.where(known, variance, 1.0))
    )
    rows = np.where(took, np.where(known, sure, 0.0), np.where(expected, np.log1p(-P_D), 0.0))
    excess = np.where(dof > 0, np.where(np.isfinite(nis), nis, 0.0) - dof, 0.0)
    result: Array = rows.sum(axis=-1) - 0.5 * excess
    return result


def noise_variance(measurement: object, position: Array, time: float) -> Array:
    """Return the noise variances (m,) at a place (d,); NaN where they are not known."""
    R = measurement.noise_covariance(position, np.zeros_like(position), time)  # type: ignore[attr-defined]
    result: Array = np.diagonal(R).copy()
    return result
