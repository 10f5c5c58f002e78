"""Parameter sweeps: what of a scenario a study may turn, and every combination of its values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import attrs
import numpy as np

from imm_tdoa.simulate import Leg, Scenario, Target
from imm_tdoa.simulate.measuring import Station

Layouts = Mapping[str, Sequence[Sequence[float]]]


def points(sweep: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Return every combination of the swept values, the last parameter running fastest.

    Parameters
    ----------
    sweep : mapping of str to sequence
        Values of each parameter; without any there is one point, which is empty.
    """
    return [dict(zip(sweep, values, strict=True)) for values in product(*sweep.values())]


def label(name: str, point: Mapping[str, Any]) -> str:
    """Return what a point of the sweep called `name` is called, such as ``flight a=0.5 m/s²``."""
    return " ".join([name, *(_short(key, value) for key, value in point.items())])


def _short(key: str, value: Any) -> str:
    before, scale, after = SHORT.get(key, ("", 1.0, ""))
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{before}{value * scale:g}{after}" if number else str(value)


def turn(scenario: Scenario, key: str, value: Any, layouts: Layouts) -> Scenario:
    """Return the scenario with one parameter at another value.

    Parameters
    ----------
    scenario : Scenario
        What to change.
    key : str
        One of `PARAMETERS`, which says what each does.
    value
        A number, but for ``layout``: the name of one of `layouts`.
    layouts : mapping of str to (S, d)
        Positions of the stations, m.

    Raises
    ------
    ValueError
        A value that makes no sense for this scenario; the message says what was expected.
    """
    if key == "layout":
        return _laid_out(scenario, value, layouts)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"expected a finite number, got {value!r}")
    result: Scenario = PARAMETERS[key][1](scenario, float(value))
    return result


def _acceleration(scenario: Scenario, value: float) -> Scenario:
    _at_least_zero(value)
    legs = [leg for target in scenario.targets for leg in target.legs]
    if not any(leg.acceleration_mps2 is not None for leg in legs):
        raise ValueError("the scenario has no leg with acceleration_mps2, whose direction is kept")

    def accelerated(leg: Leg) -> Leg:
        if leg.acceleration_mps2 is None:
            return leg
        a = np.array(leg.acceleration_mps2)
        length = float(np.linalg.norm(a))
        if length == 0.0:
            raise ValueError("a leg's acceleration_mps2 is zero and has no direction to keep")
        return attrs.evolve(leg, acceleration_mps2=tuple(float(x) for x in a / length * value))

    return _each_leg(scenario, accelerated)


def _sojourn(scenario: Scenario, value: float) -> Scenario:
    _above_zero(value)
    return _each_leg(scenario, lambda leg: attrs.evolve(leg, duration_s=value))


def _each_leg(scenario: Scenario, change: Callable[[Leg], Leg]) -> Scenario:
    def changed(target: Target) -> Target:
        return attrs.evolve(target, legs=tuple(change(leg) for leg in target.legs))

    return attrs.evolve(scenario, targets=tuple(changed(target) for target in scenario.targets))


def _interval(scenario: Scenario, value: float) -> Scenario:
    _above_zero(value)
    sampling = scenario.sampling
    jitter = sampling.jitter_s * value / sampling.interval_s
    sampling = attrs.evolve(sampling, interval_s=value, jitter_s=jitter)
    return attrs.evolve(scenario, sampling=sampling)


def _toa_sigma(scenario: Scenario, value: float) -> Scenario:
    _above_zero(value)
    noise = attrs.evolve(scenario.noise, toa_sigma_s=value, tdoa_sigma_s=None)
    return attrs.evolve(scenario, noise=noise)


def _tdoa_sigma(scenario: Scenario, value: float) -> Scenario:
    _above_zero(value)
    noise = attrs.evolve(scenario.noise, tdoa_sigma_s=value, toa_sigma_s=None)
    return attrs.evolve(scenario, noise=noise)


def _noise_factor(scenario: Scenario, value: float) -> Scenario:
    _above_zero(value)
    keys = ("toa_sigma_s", "tdoa_sigma_s", "range_rate_sigma_mps", "bias_sigma_s")
    sigma = {key: getattr(scenario.noise, key) for key in keys}
    larger = {key: value * s for key, s in sigma.items() if s is not None}
    return attrs.evolve(scenario, noise=attrs.evolve(scenario.noise, **larger))


def _dropout(scenario: Scenario, value: float) -> Scenario:
    if not 0.0 <= value < 1.0:
        raise ValueError(f"expected a probability below 1, got {value:g}")
    return attrs.evolve(scenario, dropouts=attrs.evolve(scenario.dropouts, row=value))


def _station_scale(scenario: Scenario, value: float) -> Scenario:
    _above_zero(value)
    places = np.array([station.position_m for station in scenario.stations])
    centre = places.mean(axis=0)
    return _moved(scenario, centre + value * (places - centre))


def _laid_out(scenario: Scenario, name: Any, layouts: Layouts) -> Scenario:
    if name not in layouts:
        known = ", ".join(layouts) or "none; give them as [layouts] NAME = [[x, y], …]"
        raise ValueError(f"there is no layout {name!r}; there are: {known}")
    return _moved(scenario, np.array(layouts[name], dtype=float))


def _moved(scenario: Scenario, places: Any) -> Scenario:
    """Stations at other places; they keep their names as far as there are any."""
    if any(station.moving for station in scenario.stations):
        raise ValueError("the scenario's stations move; expected fixed ones")
    old = scenario.station_names
    names = [*old, *(f"station-{k + 1}" for k in range(len(old), len(places)))][: len(places)]
    stations = tuple(
        Station(name=name, position_m=tuple(float(x) for x in place))
        for name, place in zip(names, places, strict=True)
    )
    return attrs.evolve(scenario, stations=stations)


def _above_zero(value: float) -> None:
    if value <= 0.0:
        raise ValueError(f"expected a number above 0, got {value:g}")


def _at_least_zero(value: float) -> None:
    if value < 0.0:
        raise ValueError(f"expected a number of at least 0, got {value:g}")


PARAMETERS: Mapping[str, tuple[str, Any]] = {
    "acceleration_mps2": (
        "length of the acceleration of every leg that has one, m/s²; its direction is kept",
        _acceleration,
    ),
    "toa_sigma_s": ("standard deviation of arrival times, s", _toa_sigma),
    "tdoa_sigma_s": ("standard deviation of independent differences, s", _tdoa_sigma),
    "noise_factor": ("factor on every standard deviation of the noise", _noise_factor),
    "interval_s": ("time between scans, s", _interval),
    "dropout": ("probability that a row is missing", _dropout),
    "layout": ("where the stations are: the name of one of [layouts]", None),
    "station_scale": ("factor on the stations' distances from their middle", _station_scale),
    "sojourn_s": (
        "how long every leg lasts, s; of a random way the mean time in a motion",
        _sojourn,
    ),
}
"""What may be swept or changed, and what each does."""

SHORT: Mapping[str, tuple[str, float, str]] = {
    "acceleration_mps2": ("a=", 1.0, " m/s²"),
    "toa_sigma_s": ("σ=", 1e9, " ns"),
    "tdoa_sigma_s": ("σ=", 1e9, " ns"),
    "noise_factor": ("noise×", 1.0, ""),
    "interval_s": ("every ", 1.0, " s"),
    "dropout": ("lost ", 100.0, " %"),
    "station_scale": ("stations×", 1.0, ""),
    "sojourn_s": ("stays ", 1.0, " s"),
    "process_noise_factor": ("q×", 1.0, ""),
    "sojourn_factor": ("sojourn×", 1.0, ""),
}
"""How names show a parameter's value: what is before it, its factor, what is after it."""
