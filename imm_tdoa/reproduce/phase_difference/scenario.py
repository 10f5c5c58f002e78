"""What is flown and measured in Source C (ALGORITHMS §7.2)."""

from __future__ import annotations

from typing import Any, Literal, get_args

import attrs
import numpy as np

from imm_tdoa import _validate, gaussian_sum, registry
from imm_tdoa.contract import Array
from imm_tdoa.gaussian import wrap
from imm_tdoa.gaussian_sum import GaussianSum, Hypotheses
from imm_tdoa.reproduce.phase_difference.switches import Switches
from imm_tdoa.stations import Stations

EMITTER = np.array([60e3, 80e3])  # m
INTERVAL_S = 0.5
BASELINE_M = 10.0
FREQUENCY_HZ = 6e9
MERGE_M = 3e3
MERGE_SIGMAS = 1.0
PRUNE = 1e-5
Use = Literal["both", "phase", "rate"]


@attrs.frozen
class Scenario:
    """One case: an aircraft flies east from the origin past a fixed emitter at (60, 80) km.

    Attributes
    ----------
    use : "both", "phase" or "rate"
        What the filter takes in after the first scan, which always gives both.
    speed_mps : float
        Speed of the aircraft.
    phase_deg, rate_deg : float
        Standard deviations of phase and its rate, ° and °/s. The source's rate error of the base
        case is lost; 0.5 °/s follows from its Tables 1 and 2 agreeing on 18 s.
    bearing_deg : float
        Standard deviation of the rough bearing from amplitudes; the window is ±2 of it.
    platform_m, platform_mps : float
        Standard deviations of the platform's position and velocity, each axis, each scan.
    count, every : int
        How many hypotheses, of every how-manieth ambiguity integer. `count` None: all.
    lobe_deg : float or None
        Standard deviation of a hypothesis' bearing; None: what phase error and the integers it
        stands for amount to.
    merging : bool
        Whether close components are merged.
    duration_s : float
        How long is flown.
    """

    use: Use = "both"
    speed_mps: float = 270.0
    phase_deg: float = 10.0
    rate_deg: float = 0.5
    bearing_deg: float = 5.0
    platform_m: float = 10.0
    platform_mps: float = 2.0
    count: int | None = 6
    every: int = 9
    lobe_deg: float | None = 1.0
    merging: bool = True
    duration_s: float = 40.0

    def __attrs_post_init__(self) -> None:
        _validate.one_of("use", self.use, get_args(Use))
        for name in ("speed_mps", "phase_deg", "rate_deg", "bearing_deg", "duration_s"):
            _validate.positive(name, getattr(self, name))
        for name in ("platform_m", "platform_mps"):
            _validate.non_negative(name, getattr(self, name))
        if self.duration_s < 2.0 * INTERVAL_S:
            raise ValueError(f"duration_s: expected at least 1 s, got {self.duration_s!r}")

    @property
    def times(self) -> Array:
        """Times of the scans (T + 1,), s; the first makes the hypotheses."""
        return INTERVAL_S * np.arange(round(self.duration_s / INTERVAL_S) + 1, dtype=float)

    @property
    def path(self) -> Array:
        """Where the platform says it is (T + 1, 2), m."""
        path: Array = self.times[:, None] * np.array([self.speed_mps, 0.0])
        return path

    @property
    def ranges(self) -> Array:
        """Distance (T + 1,) of the emitter from the platform, m."""
        return np.asarray(np.linalg.norm(EMITTER - self.path, axis=-1))

    def measurement(self, platform_noise: bool = True, use: Use = "both") -> Any:
        """Return the measurement model of the platform as it says it flies."""
        ends = self.path[[0, -1]]
        errors: dict[str, Any] = {}
        if platform_noise:
            one = np.eye(2)[None]
            errors["position_covariance"] = self.platform_m**2 * one
            errors["velocity_covariance"] = self.platform_mps**2 * one
        velocities = np.full((2, 1, 2), [self.speed_mps, 0.0])
        observer = Stations(
            ends[:, None], velocities=velocities, times=self.times[[0, -1]], **errors
        )
        return registry.load("phase-difference")(
            observer,
            baseline=BASELINE_M,
            frequency=FREQUENCY_HZ,
            sigma_phase=np.radians(self.phase_deg),
            sigma_rate=np.radians(self.rate_deg),
            use=use,
        )

    def draw(self, seed: int, runs: int) -> tuple[Array, Array]:
        """Return what is measured (runs, T + 1, 2), rad and rad/s, and rough bearings (runs,).

        The same seed gives the same errors, in units of their deviations, to every case of the
        same duration, so that what is compared is compared on the same noise; more runs begin
        with those of fewer. A platform that is δ off its word sees what one on its word would
        see of an emitter δ off the other way.
        """
        T = len(self.times)
        unit = np.random.default_rng([seed, T]).standard_normal((check_runs(runs), 1 + 6 * T))
        bearing = np.arctan2(EMITTER[1], EMITTER[0]) + np.radians(self.bearing_deg) * unit[:, 0]
        errors = unit[:, 1:].reshape(runs, T, 3, 2)
        place = EMITTER - self.platform_m * errors[..., 0, :]
        speed = -self.platform_mps * errors[..., 1, :]
        exact = self.measurement().predict(place, speed, self.times)
        values = exact + errors[..., 2, :] * np.radians([self.phase_deg, self.rate_deg])
        values[..., 0] = wrap(values[..., 0])
        return values, bearing

    def begin(self, values: Array, bearing: Array, switches: Switches) -> Hypotheses:
        """Return the hypotheses (runs, N) of the first scan `values` (runs, 2)."""
        return gaussian_sum.lobes(
            self.measurement(switches.platform_noise),
            0.0,
            values,
            bearing,
            float(np.radians(self.bearing_deg)),
            every=self.every,
            count=self.count,
            lobe_sigma=None if self.lobe_deg is None else float(np.radians(self.lobe_deg)),
            covariance=switches.covariance,
        )

    def tracker(self, switches: Switches) -> GaussianSum:
        """Return the Gaussian sum of the rows in use."""
        merging: dict[str, Any] = {}
        if self.merging:
            distance = {"euclidean": MERGE_M, "mahalanobis": MERGE_SIGMAS}[switches.merging]
            merging = {"merge_distance": distance, "merge_by": switches.merging}
        return GaussianSum(
            registry.load("static")(psd=0.0),
            self.measurement(switches.platform_noise, self.use),
            prune_below=PRUNE,
            **merging,
        )


def check_runs(runs: int) -> int:
    """Return `runs`, or refuse fewer than the two that a standard error takes."""
    if isinstance(runs, bool) or not isinstance(runs, int) or runs < 2:
        raise ValueError(f"runs: expected a whole number of at least 2, got {runs!r}")
    return runs
