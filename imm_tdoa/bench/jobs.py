"""What is computed: simulated emitters that all start near one place, and an IMM for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

from imm_tdoa import registry
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.cycle import RobustRule
from imm_tdoa.imm import IMM
from imm_tdoa.state import State
from imm_tdoa.stations import Stations

INTERVAL = 1.0  # s between scans
RADIUS = 20e3  # m: the reference station in the middle, the others around it
PLACE, SPREAD = 25e3, 100.0  # m: where the targets start, and its standard deviation per axis
SPEED, ACCELERATION = 20.0, 0.2  # standard deviations per axis, m/s and m/s²
TOA_SIGMA = 50e-9  # s
BIRTH_STD = {"velocity": 50.0, "acceleration": 2.0}
MODES: tuple[tuple[str, Mapping[str, float]], ...] = (
    ("static", {"psd": 1.0}),
    ("constant-velocity", {"psd": 1.0}),
    ("constant-acceleration", {"psd": 0.01}),
    ("constant-velocity", {"psd": 100.0}),
    ("singer", {"std": 2.0}),
    ("constant-acceleration", {"psd": 1.0}),
)
PIECE = 16384  # targets that are drawn at a time


@attrs.frozen(eq=False)
class Job:
    """Targets to be tracked through their scans.

    Attributes
    ----------
    imm : IMM
        The bank and the measurement.
    times : (T,)
        Of the scans, s.
    values : (N, T, m)
        Time differences of each target, s.
    start : State
        One state that all targets share, a scan before the first.
    pairs : (T, m, 2), optional
        Station pairs of each scan, where they change.
    """

    imm: IMM
    times: Array
    values: Array
    start: State
    pairs: Any = None

    @property
    def steps(self) -> int:
        """Number of targets times number of scans."""
        return int(np.prod(self.values.shape[:-1]))

    def first(self, targets: int, scans: int | None = None) -> Job:
        """Return the job of fewer targets, and scans."""
        return attrs.evolve(self, times=self.times[:scans], values=self.values[:targets, :scans])

    def run(self, **how: Any) -> Any:
        """Run it; options as for `IMM.run`."""
        return self.imm.run(self.times, self.values, self.start, self.pairs, **how)


def ring(count: int, dims: int = 2) -> Stations:
    """Return a station in the middle and `count` - 1 around it, at different heights in 3-D."""
    angle = 2.0 * np.pi * np.arange(count - 1) / (count - 1)
    height = 200.0 * np.arange(count - 1) * (-1.0) ** np.arange(count - 1)
    around = RADIUS * np.stack([np.cos(angle), np.sin(angle), height / RADIUS], axis=-1)
    return Stations(np.concatenate([np.zeros((1, dims)), around[:, :dims]]))


def place(dims: int) -> Array:
    """Return where the targets start (dims,), m."""
    return np.array([PLACE * np.cos(0.6), PLACE * np.sin(0.6), 8e3])[:dims]


def bank(modes: int = 3) -> Bank:
    """Return the bank of the first so many of `MODES`; of one: constant velocity."""
    chosen = MODES[:modes] if modes > 1 else MODES[1:2]
    models = [registry.load(name)(**settings) for name, settings in chosen]
    return Bank(models, mean_sojourn=60.0, birth_std=BIRTH_STD)


def differences(stations: int = 4, dims: int = 2) -> MeasurementModel:
    """Return a measurement of differences against the station in the middle."""
    result: MeasurementModel = registry.load("tdoa")(ring(stations, dims), toa_sigma=TOA_SIGMA)
    return result


def start(imm: IMM) -> State:
    """Return the state of all targets at time 0."""
    d = imm.space.dims
    return imm.start(0.0, place(d), SPREAD**2 * np.eye(d))


def job(
    targets: int,
    scans: int,
    *,
    modes: int = 3,
    stations: int = 4,
    robust: RobustRule | None = None,
    seed: int = 1,
) -> Job:
    """Return targets that stand, move steadily, and accelerate, a third each.

    They are drawn piece by piece: beyond the values themselves little memory is used.
    """
    imm = IMM(bank(modes), differences(stations), robust=robust)
    measurement = imm.measurement
    times = INTERVAL * np.arange(1.0, scans + 1.0)
    values = np.empty((targets, scans, measurement.size))
    generator = np.random.default_rng(seed)
    for begin in range(0, targets, PIECE):
        part = values[begin : begin + PIECE]
        part[:] = draw(generator, measurement, times, begin + np.arange(len(part)))
    return Job(imm, times, values, start(imm))


def draw(
    generator: np.random.Generator, measurement: MeasurementModel, times: Array, number: Any
) -> Array:
    """Return what is measured (N, T, m), in the measurement's unit, of targets of that `number`."""
    d, N = measurement.dims, len(number)
    kind = (number % 3)[:, None, None]
    p = place(d) + SPREAD * generator.standard_normal((N, 1, d))
    v = SPEED * generator.standard_normal((N, 1, d)) * (kind > 0)
    a = ACCELERATION * generator.standard_normal((N, 1, d)) * (kind > 1)
    t = times[:, None]
    noise = measurement.noise_covariance(place(d), np.zeros(d), float(times[0]))
    white = generator.standard_normal((N, len(times), measurement.size))
    exact = measurement.predict(p + v * t + 0.5 * a * t**2, v + a * t, times)
    errors = (np.linalg.cholesky(noise) @ white[..., None])[..., 0]
    result: Array = (exact + errors) / measurement.scale
    return result


def one_pair_at_a_time(scans: int, stations: int = 8, seed: int = 2) -> Job:
    """Return one target in 3-D of which each scan is one difference, at irregular times."""
    dims = 3
    generator = np.random.default_rng(seed)
    tdoa = registry.load("tdoa")(ring(stations, dims), toa_sigma=TOA_SIGMA, pairs=[[1, 0]])
    imm = IMM(bank(), tdoa)
    gaps = np.round(generator.exponential(0.01, scans) + 1e-3, 3)  # time stamps in milliseconds
    times = np.cumsum(gaps)
    station = generator.integers(0, stations, scans)
    reference = (station + generator.integers(1, stations, scans)) % stations
    pairs = np.stack([station, reference], axis=-1)[:, None]
    values = draw(generator, tdoa.with_pairs(pairs), times, np.array([1]))
    return Job(imm, times, values, start(imm), pairs)
