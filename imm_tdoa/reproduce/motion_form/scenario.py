"""Source A's three targets, its stations and its noise, as reconstructed (ALGORITHMS §5.3)."""

from __future__ import annotations

from functools import cache
from math import inf
from typing import Any, Literal

import attrs
import numpy as np

from imm_tdoa import registry, simulate
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.reproduce.motion_form.switches import Mixing, Switches
from imm_tdoa.stations import Stations

SCENARIO = "source-a"  # the shipped one: stations, noise, first positions and speeds
ACCELERATION = np.array([[-100.0, 0.0], [100.0, 0.0], [100.0, 0.0]])  # m/s² along x (§5.3)
STEPS = 20
MODELS = ("static", "constant-velocity", "constant-acceleration")
BIRTH_STD = {"velocity": 5000.0, "acceleration": 500.0}  # m/s, m/s²
KM = 1e3
RECONSTRUCTION = (
    "Geometry and noise are our reconstruction; the paper gives neither. Master at the origin, "
    "three slaves at 100 km and azimuths of 0, 120 and 240 degrees, 100 ns per time difference, "
    "2 s between epochs, accelerations along x, a first fix and then 20 epochs, velocity and "
    "acceleration unknown to 5 km/s and 0.5 km/s² at the start."
)


@attrs.frozen
class Motion:
    """How the three targets move: they stand, set off, and accelerate.

    Attributes
    ----------
    name : str
        What it is called in tables.
    sets_off_s, accelerates_s : float
        When they set off at once at full speed, and when they begin to accelerate, s.
    steps : int
        Epochs after the first.
    """

    name: str
    sets_off_s: float = inf
    accelerates_s: float = inf
    steps: int = STEPS

    @property
    def times(self) -> Array:
        """Epochs (T,), s."""
        return interval() * np.arange(self.steps + 1.0)

    def truth(self) -> Array:
        """Return position, velocity and acceleration (3, T, 6), m, m/s, m/s²."""
        plan = simulate.load(SCENARIO)
        start = np.array([target.position_m for target in plan.targets])[:, None]
        speed = np.array([target.velocity_mps for target in plan.targets])[:, None]
        moved = np.maximum(self.times - self.sets_off_s, 0.0)[:, None]
        gained = np.maximum(self.times - self.accelerates_s, 0.0)[:, None]
        moving = (self.times >= self.sets_off_s)[:, None]
        gaining = (self.times >= self.accelerates_s)[:, None]
        a = ACCELERATION[:, None]
        parts = (start + speed * moved + 0.5 * a * gained**2, speed * moving + a * gained)
        return np.concatenate([*parts, a * gaining], axis=-1)

    def modes(self) -> tuple[str, ...]:
        """Return which of `MODELS` was in force over the step that ends at each epoch."""
        changes = np.array([self.sets_off_s, self.accelerates_s])
        before = self.times - 0.5 * interval()
        return tuple(MODELS[int(k)] for k in np.sum(changes <= before[:, None], axis=1))


STATIC = Motion("static")
CONSTANT_VELOCITY = Motion("constant-velocity", sets_off_s=0.0)
CONSTANT_ACCELERATION = Motion("constant-acceleration", sets_off_s=0.0, accelerates_s=0.0)
MOTIONS = (STATIC, CONSTANT_VELOCITY, CONSTANT_ACCELERATION)
SWITCHING = Motion("switching", sets_off_s=30.0, accelerates_s=60.0, steps=45)


def interval() -> float:
    """Return the time between epochs, s."""
    return float(simulate.load(SCENARIO).sampling.interval_s)


@cache
def stations() -> Stations:
    """Return the master and the three slaves."""
    return Stations(np.array([s.position_m for s in simulate.load(SCENARIO).stations]))


def sigma() -> float:
    """Return the standard deviation of one time difference, s."""
    found = simulate.load(SCENARIO).noise.tdoa_sigma_s
    assert isinstance(found, float)
    return found


def noise_level(correlated: bool) -> tuple[Literal["toa_sigma", "tdoa_sigma"], float]:
    """Return what a measurement of differences with this noise is made with, s.

    Either way the variance of one difference is the same.
    """
    return ("toa_sigma", sigma() / np.sqrt(2.0)) if correlated else ("tdoa_sigma", sigma())


def differences(correlated: bool) -> MeasurementModel:
    """Return a measurement of differences against the master, with noise of either kind."""
    kind, level = noise_level(correlated)
    result: MeasurementModel = registry.load("tdoa")(stations(), **{kind: level})
    return result


def measurement(switches: Switches) -> MeasurementModel:
    """Return the measurement model that the estimators are given."""
    return differences(full(switches))


def full(switches: Switches) -> bool:
    """Whether the estimators' R has entries off its diagonal."""
    return switches.noise == "correlated" and switches.noise_covariance == "full"


def true_noise(switches: Switches) -> Array:
    """Return the covariance (3, 3) of the simulated range differences, m²."""
    model = differences(switches.noise == "correlated")
    result: Array = model.noise_covariance(np.ones(2), np.zeros(2), 0.0)
    return result


def draw(seed: int, runs: int, motion: Motion, switches: Switches) -> Array:
    """Return measured time differences (runs, 3, T, 3), s.

    The same seed gives the same errors to every motion of as many steps, so that what is
    compared is compared on the same noise; more runs begin with those of fewer.
    """
    generator = np.random.default_rng([seed, motion.steps])
    L = np.linalg.cholesky(true_noise(switches))
    exact = ideal(motion)
    errors = generator.standard_normal((runs, *exact.shape)) @ L.T
    result: Array = exact + errors / measurement(switches).scale
    return result


def ideal(motion: Motion) -> Array:
    """Return time differences (3, T, 3) without noise, s."""
    model, truth = measurement(Switches()), motion.truth()
    result: Array = model.predict(truth[..., :2], truth[..., 2:4], motion.times) / model.scale
    return result


def motion_model(name: str, density_km: float = 0.0) -> Any:
    """Return a motion model with white noise of a density in km² s^-1, s^-3 or s^-5."""
    return registry.load(name)(psd=density_km * KM**2)


def all_models(
    density_km: float = 0.0,
    *,
    mixing: Mixing = "birth",
    mean_sojourn: float | None = None,
    transition: Array | None = None,
) -> Bank:
    """Return the bank of static, constant velocity and constant acceleration."""
    return Bank(
        [motion_model(name, density_km) for name in MODELS],
        mean_sojourn=mean_sojourn,
        transition=transition,
        mixing=mixing,
        birth_std=BIRTH_STD,
    )


def check_runs(runs: int) -> int:
    """Return `runs`, or refuse fewer than the two that a standard error takes."""
    if isinstance(runs, bool) or not isinstance(runs, int) or runs < 2:
        raise ValueError(f"runs: expected a whole number of at least 2, got {runs!r}")
    return runs
