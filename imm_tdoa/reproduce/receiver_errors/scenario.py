"""Six moving receivers that are not exactly where they say, and three emitters.

Receivers 1 to 5, their velocities and the emitter's are those of Ho & Xu 2004; the sixth is
ALGORITHMS §8.3's. The relative variances of the receivers and the near emitter are our
reconstruction: with them every bound of §8.3 comes out to its printed digits. Source D prints no
simulation.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np

from imm_tdoa import bounds
from imm_tdoa.contract import Array
from imm_tdoa.stations import Stations

POSITIONS = np.array(
    [
        (300.0, 100.0, 150.0),
        (400.0, 150.0, 100.0),
        (300.0, 500.0, 200.0),
        (350.0, 200.0, 100.0),
        (-100.0, -100.0, -100.0),
        (200.0, -300.0, -200.0),
    ]
)
VELOCITIES = np.array(
    [
        (30.0, -20.0, 20.0),
        (-30.0, 10.0, 20.0),
        (10.0, -20.0, 10.0),
        (10.0, 20.0, 30.0),
        (-20.0, 10.0, 10.0),
        (20.0, -10.0, 10.0),
    ]
)
RELATIVE_VARIANCE = np.array([1.0, 2.0, 10.0, 40.0, 20.0, 3.0])
SOURCES = {
    "near": (285.0, 325.0, 275.0),
    "mid": (600.0, 650.0, 550.0),
    "far": (2000.0, 2500.0, 3000.0),
}
VELOCITY = np.array([-20.0, 15.0, 40.0])
RATE_SHARE = 0.1  # variance of range-rate differences over that of range differences, 1/s²
RECONSTRUCTION = (
    "Source D prints no simulation. Geometry of Ho & Xu 2004 and a sixth receiver; variances of "
    "the receivers' coordinates 1, 2, 10, 40, 20, 3 times sigma_s² and the near emitter "
    "(285, 325, 275) m are our reconstruction."
)


def _point(place: Sequence[float]) -> Array:
    return np.asarray(place, dtype=float)


@attrs.frozen(eq=False)
class Case:
    """An emitter and the sizes of the errors.

    Attributes
    ----------
    source : (3,)
        The emitter's true position, m.
    range_variance : float
        Variance of a range difference, sigma_d², m²; a tenth of it, per s², for range rates.
    receiver_variance : float
        Variance of a coordinate of the first receiver, sigma_s², m².
    """

    source: Array = attrs.field(converter=_point)
    range_variance: float
    receiver_variance: float

    @property
    def sigmas(self) -> dict[str, float]:
        """The measurement's errors as the estimators and bounds want them; ranges in metres."""
        return {
            "toa_sigma": float(np.sqrt(self.range_variance / 2.0)),
            "range_rate_sigma": float(np.sqrt(RATE_SHARE * self.range_variance / 2.0)),
            "speed": 1.0,
        }

    @property
    def covariance(self) -> Array:
        """Covariances (6, 3, 3) of the receivers' positions, m²."""
        return self.receiver_variance * RELATIVE_VARIANCE[:, None, None] * np.eye(3)

    def stations(self) -> Stations:
        """Return the receivers where they truly are, with the errors they declare."""
        return Stations(POSITIONS, velocities=VELOCITIES, position_covariance=self.covariance)

    def bound(self) -> tuple[float, float]:
        """Return the Cramér-Rao bound with receiver errors, root mean square, m and m/s."""
        return split(bounds.crlb(self.stations(), self.source, velocity=VELOCITY, **self.sigmas))

    def trusting(self) -> tuple[float, float]:
        """Return what trusting the receivers costs by theory, root mean square, m and m/s."""
        mse = bounds.trusting_mse(self.stations(), self.source, velocity=VELOCITY, **self.sigmas)
        return split(mse)

    def measured(self, runs: int, rng: np.random.Generator) -> Measured:
        """Return what `runs` independent experiments measure."""
        shape = (runs, *POSITIONS.shape)
        sd = np.sqrt(self.receiver_variance * RELATIVE_VARIANCE)
        declared = POSITIONS + sd[:, None] * rng.normal(size=shape)
        away = self.source - POSITIONS
        r = np.sqrt(np.sum(away**2, axis=-1))
        rate = np.sum(away * (VELOCITY - VELOCITIES), axis=-1) / r
        sigma = self.sigmas
        arrival = r + sigma["toa_sigma"] * rng.normal(size=shape[:2])
        rates = rate + sigma["range_rate_sigma"] * rng.normal(size=shape[:2])
        return Measured(
            stations=Stations(
                declared,
                velocities=np.broadcast_to(VELOCITIES, shape),
                times=np.arange(float(runs)),
                position_covariance=self.covariance,
            ),
            tdoa=arrival[:, 1:] - arrival[:, :1],
            range_rate=rates[:, 1:] - rates[:, :1],
        )


@attrs.frozen(eq=False)
class Measured:
    """What is measured in N runs: run k at "time" k, when the receivers say where they are.

    Attributes
    ----------
    stations : Stations
        The receivers as they declare themselves in each run.
    tdoa : (N, 5)
        Range differences, m.
    range_rate : (N, 5)
        Range-rate differences, m/s.
    """

    stations: Stations
    tdoa: Array
    range_rate: Array


def split(covariance: Array) -> tuple[float, float]:
    """Return the root mean square of position and of velocity of a covariance (6, 6)."""
    variance = np.diag(covariance)
    return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:].sum()))
