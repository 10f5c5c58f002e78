"""A small scenario to vary, and residuals of what is made of it, computed without the library."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest

from imm_tdoa import simulate
from imm_tdoa.recording import Recording
from imm_tdoa.simulate import Leg, Scenario, Target
from imm_tdoa.simulate.faults import NoiseLevel
from imm_tdoa.simulate.measuring import Sampling, Station

C = 299792458.0
PLACES = {"a": (0.0, 0.0), "b": (9e3, 1e3), "c": (2e3, 8e3), "d": (-7e3, -4e3)}
SIGMA = 100e-9

# shipped scenarios: targets, stations, and whether it is known which rows are whose
SEVERAL = {
    "busy-sky": (50, 8, False),
    "crossing": (2, 6, False),
    "many-aircraft": (200, 20, True),
    "parallel": (2, 6, False),
    "three-emitters": (3, 4, False),
}


def standing(name: str = "x", place: tuple[float, ...] = (3e3, 2.5e3), scans: int = 2000) -> Target:
    """A target that stands for a number of scans, one a second."""
    legs = [Leg(motion="static", duration_s=scans - 1.0)]
    return Target(name=name, position_m=place, legs=legs)


def scenario(**changes: Any) -> Scenario:
    """Four fixed stations, one standing target, arrival times with 100 ns of noise."""
    base: dict[str, Any] = {
        "title": "a case",
        "dims": 2,
        "stations": [Station(name=n, position_m=p) for n, p in PLACES.items()],
        "sampling": Sampling(interval_s=1.0),
        "noise": NoiseLevel(toa_sigma_s=SIGMA),
        "targets": [standing()],
    }
    return Scenario(**{**base, **changes})


def assert_refused(text: str, message: str) -> None:
    """The scenario file is refused in one line that begins with its name and `message`."""
    with pytest.raises(ValueError) as caught:
        simulate.read(text, "scenario.toml")
    said = str(caught.value)
    place = "" if message.startswith("scenario.toml:") else "scenario.toml: "
    assert said.startswith(place + message), said
    assert "\n" not in said


def rows_of(table: Any, target: str | None = None) -> dict[str, Any]:
    """The columns of one target's rows."""
    keep = np.ones(len(table), dtype=bool) if target is None else table["target"] == target
    return {name: table[name][keep] for name in table}


def true_arrivals(recording: Recording, place: tuple[float, ...] = (3e3, 2.5e3)) -> dict[str, Any]:
    """Time of flight to each fixed station, s."""
    stations = zip(recording.stations.names, recording.stations.positions, strict=True)
    return {n: np.linalg.norm(np.array(place) - s) / C for n, s in stations}


def difference_residuals(recording: Recording, place: tuple[float, ...] = (3e3, 2.5e3)) -> Any:
    """Errors (T, m) of full scans of differences of a standing target, s."""
    flight, table = true_arrivals(recording, place), recording.tdoa
    assert table is not None
    ends = zip(table["station"].tolist(), table["reference"].tolist(), strict=True)
    expected = np.array([flight[a] - flight[b] for a, b in ends])
    scans = len(np.unique(table["time_s"]))
    return (table["tdoa_s"] - expected).reshape(scans, -1)


def arrival_residuals(recording: Recording, place: tuple[float, ...] = (3e3, 2.5e3)) -> Any:
    """Arrival times less times of flight (T, S) of full scans of a standing target, s."""
    flight, table = true_arrivals(recording, place), recording.toa
    assert table is not None
    expected = np.array([flight[n] for n in table["station"].tolist()])
    return (table["toa_s"] - expected).reshape(-1, len(flight))


def with_rows(made: Scenario, rows: str, **changes: Any) -> Scenario:
    """The same scenario with other rows."""
    return attrs.evolve(made, sampling=attrs.evolve(made.sampling, rows=rows, **changes))


def covariance_tolerance(expected: Any, count: int) -> Any:
    """Five standard deviations of the entries of a sample covariance of `count` normal draws."""
    variance = np.diag(expected)
    return 5.0 * np.sqrt((np.outer(variance, variance) + expected**2) / count)


def binomial_tolerance(p: float, count: int) -> float:
    """Five standard deviations of the share of hits in `count` draws."""
    return 5.0 * float(np.sqrt(p * (1.0 - p) / count))


def same(one: Recording, two: Recording, *tables: str) -> bool:
    """Whether tables of two recordings are equal to the last bit."""
    pairs = [(getattr(one, t), getattr(two, t)) for t in tables]
    return all(
        (a is None and b is None)
        or (list(a) == list(b) and all(np.array_equal(a[c], b[c]) for c in a))
        for a, b in pairs
    )
