"""How large must an acceleration be before a criterion sees it? (ALGORITHMS §11)"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, registry
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.selection.comparing import compare
from imm_tdoa.selection.comparison import Comparison
from imm_tdoa.stations import Stations

ACCELERATIONS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
POSITION, VELOCITY = (300e3, 400e3), (0.0, 1000.0)
LEVEL = 0.05  # of the innovation test in the table, one-sided


@attrs.frozen(eq=False)
class Discrimination:
    """How often each criterion chooses constant acceleration over constant velocity.

    Attributes
    ----------
    accelerations : (A,)
        True accelerations, m/s².
    criteria : tuple of str
        AIC, BIC, and one Bayes factor for each width of the prior.
    fraction : (A, C)
        Share of the runs in which each criterion chooses constant acceleration.
    nis_rejects : (A,)
        Share in which the innovations of constant velocity are too large (one-sided 5 %).
    error : (A, 2)
        Mean position error of the two filters over the run, m; constant acceleration with the
        narrowest prior.
    runs : int
        Runs behind every share.
    """

    accelerations: Array
    criteria: tuple[str, ...]
    fraction: Array
    nis_rejects: Array
    error: Array
    runs: int

    def __str__(self) -> str:
        """Return the table."""
        heads = ("a [m/s²]", *self.criteria, "NIS rejects CV", "error CV / CA [km]")
        rows = [
            (
                f"{a:g}",
                *(f"{f:.2f}" for f in fractions),
                f"{nis:.2f}",
                f"{cv / 1e3:.3f} / {ca / 1e3:.3f}",
            )
            for a, fractions, nis, (cv, ca) in zip(
                self.accelerations, self.fraction, self.nis_rejects, self.error, strict=True
            )
        ]
        width = [max(len(row[i]) for row in (heads, *rows)) for i in range(len(heads))]
        return "\n".join(
            "  ".join(cell.rjust(w) for cell, w in zip(row, width, strict=True))
            for row in (heads, *rows)
        )


def discrimination(
    accelerations: Sequence[float] = ACCELERATIONS,
    *,
    acceleration_std: Sequence[float] = (5.0, 50.0, 500.0),
    velocity_std: float = 5000.0,
    runs: int = 300,
    steps: int = 20,
    interval: float = 2.0,
    measurement: MeasurementModel | None = None,
    position: Any = POSITION,
    velocity: Any = VELOCITY,
    seed: Any = 0,
) -> Discrimination:
    """Simulate targets that accelerate a little along x, and let every criterion choose.

    Candidates are constant velocity and constant acceleration without process noise. All
    accelerations and runs are one batch.

    Parameters
    ----------
    accelerations : (A,)
        True accelerations along x, m/s².
    acceleration_std : sequence of float
        Prior standard deviations of the acceleration, m/s², one Bayes factor for each.
    velocity_std : float
        Prior standard deviation of the velocity, m/s.
    runs, steps, interval
        Runs per acceleration; scans after the first; s between them.
    measurement : MeasurementModel, optional
        What is measured, with a positive definite noise covariance. Default: Source A's star of
        four stations, 100 ns per difference.
    position, velocity : (d,)
        Where every target starts, m, and how fast, m/s.
    seed : int or numpy.random.Generator
        Of the noise.

    Raises
    ------
    ValueError
        No runs or scans, or arrays that do not fit the measurement.
    """
    a = _validate.array("accelerations", accelerations, ("A",))
    if runs < 1 or steps < 1:
        raise ValueError(f"runs, steps: expected at least 1 of each, got {runs} and {steps}")
    measurement = source_a() if measurement is None else measurement
    times = interval * np.arange(steps + 1.0)
    p = _validate.array("position", position, (measurement.dims,))
    v = _validate.array("velocity", velocity, (measurement.dims,))
    along_x = np.eye(measurement.dims)[0]
    truth = p + v * times[:, None] + 0.5 * times[:, None] ** 2 * a[:, None, None] * along_x
    speed = v + times[:, None] * a[:, None, None] * along_x
    clean = measurement.predict(truth, speed, times)
    R = measurement.noise_covariance(truth, speed, times)
    L = np.broadcast_to(np.linalg.cholesky(R), (*clean.shape, measurement.size))[:, None]
    white = np.random.default_rng(seed).standard_normal((len(a), runs, *clean.shape[1:], 1))
    values = (clean[:, None] + (L @ white)[..., 0]) / measurement.scale
    models = [registry.load(f"constant-{k}")(psd=0.0) for k in ("velocity", "acceleration")]
    chosen, errors, rejects = [], [], np.zeros(len(a))
    for i, std in enumerate(acceleration_std):
        prior = {"velocity": velocity_std, "acceleration": std}
        found = compare(
            models, measurement, times, values, birth_std=prior, criteria=i == 0, update="ekf"
        )
        if i == 0:
            chosen += [_share(found, "aic"), _share(found, "bic")]
            errors = [_error(found, j, truth) for j in range(2)]
            rejects = np.mean((found.nis_p < 2.0 * LEVEL) & (found.nis_ratio > 1.0), axis=1)[:, 0]
        chosen.append(_share(found, "evidence"))
    return Discrimination(
        accelerations=a,
        criteria=("AIC", "BIC", *(f"Bayes {std:g}" for std in acceleration_std)),
        fraction=np.stack(chosen, axis=-1),
        nis_rejects=rejects,
        error=np.stack(errors, axis=-1),
        runs=runs,
    )


def source_a() -> MeasurementModel:
    """Return Source A's receivers (§5.3): a master and three slaves at 100 km, 100 ns."""
    azimuth = np.radians([0.0, 120.0, 240.0])
    slaves = 100e3 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    stations = Stations(np.concatenate([np.zeros((1, 2)), slaves]))
    measurement: MeasurementModel = registry.load("tdoa")(stations, tdoa_sigma=100e-9)
    return measurement


def _share(found: Comparison, criterion: Any) -> Array:
    chosen = np.asarray(found.choice_by(criterion))
    return np.asarray(np.mean(chosen == found.names[1], axis=1))


def _error(found: Comparison, mode: int, truth: Array) -> Array:
    """Mean position error (A,) of one model's filter after the first scan, m."""
    position = found.track.mode_means[mode][..., 1:, : truth.shape[-1]]
    distance = np.linalg.norm(position - truth[:, None, 1:], axis=-1)
    return np.asarray(distance.mean(axis=(-2, -1)))
