"""One instance of a registered model class, to check it by."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from imm_tdoa import registry
from imm_tdoa.stations import Stations

SIGMAS: dict[str, float] = {
    "psd": 1.0,
    "toa_sigma": 1e-7,
    "range_rate_sigma": 0.1,
    "sigma": 1.0,
    "std": 1.0,
}


def specimen(cls: Any) -> Any:
    """Return an instance of a model class, made without knowing the class.

    A class that has a method ``specimen()`` makes its own. Otherwise what the constructor demands
    is filled in by name: `stations` an array of four, standard deviations a moderate number,
    ``*models`` a TDOA and an FDOA of one array; and where the class still refuses, one of psd,
    toa_sigma, range_rate_sigma, sigma and std.

    Raises
    ------
    ValueError
        The class wants something that cannot be guessed; the message names it.
    """
    own = getattr(cls, "specimen", None)
    if callable(own):
        return own()
    parameters = inspect.signature(cls).parameters.values()
    if any(p.kind is p.VAR_POSITIONAL and p.name == "models" for p in parameters):
        shared = _stations()
        tdoa, fdoa = registry.load("tdoa"), registry.load("fdoa")
        return cls(tdoa(shared, toa_sigma=1e-7), fdoa(shared, range_rate_sigma=0.1))
    known = {"stations": _stations(), **SIGMAS}
    needed = [p.name for p in parameters if p.default is p.empty]
    unknown = [name for name in needed if name not in known]
    if unknown:
        raise ValueError(
            f"{cls.__name__}: cannot guess its argument {unknown[0]}; give the class a "
            f"classmethod specimen() that returns an instance to check"
        )
    given = {name: known[name] for name in needed}
    try:
        return cls(**given)
    except ValueError as refusal:
        for name in SIGMAS:
            if name in {p.name for p in parameters} - set(needed):
                return cls(**given, **{name: known[name]})
        raise refusal


def _stations() -> Stations:
    places = np.array([[0.0, 0.0, 20.0], [9e3, 1e3, 60.0], [2e3, 8e3, 10.0], [-7e3, -5e3, 90.0]])
    return Stations(places, velocities=np.array([[0, 0, 0], [30, 0, 0], [0, 20, 0], [0, 0, 5.0]]))
