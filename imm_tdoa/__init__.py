"""Track emitters of unknown manoeuvre from time differences of arrival.

Several motion models run side by side on one shared measurement model; an interacting multiple
model (IMM) mixer weighs them.

>>> from imm_tdoa import IMM, Bank, Stations
>>> from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Static
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from imm_tdoa.bank import Bank
from imm_tdoa.imm import IMM
from imm_tdoa.stations import Stations
from imm_tdoa.track import Track

if TYPE_CHECKING:
    from imm_tdoa import (
        bounds,
        gaussian_sum,
        interop,
        locate,
        metrics,
        plot,
        recording,
        selection,
        simulate,
        testing,
    )
    from imm_tdoa.gaussian_sum import GaussianSum
    from imm_tdoa.recording import Recording
    from imm_tdoa.sequence_filter import SequenceFilter

_LAZY = (
    "bankfile",
    "bounds",
    "gaussian_sum",
    "interop",
    "locate",
    "metrics",
    "models",
    "plot",
    "recording",
    "selection",
    "sequence_filter",
    "simulate",
    "testing",
)

__version__ = "0.1.0"
__all__ = [
    "IMM",
    "Bank",
    "GaussianSum",
    "Recording",
    "SequenceFilter",
    "Stations",
    "Track",
    "bounds",
    "gaussian_sum",
    "interop",
    "locate",
    "metrics",
    "plot",
    "recording",
    "selection",
    "simulate",
    "testing",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return import_module(f"imm_tdoa.{name}")
    if name == "GaussianSum":
        return import_module("imm_tdoa.gaussian_sum").GaussianSum
    if name == "Recording":
        return import_module("imm_tdoa.recording").Recording
    if name == "SequenceFilter":
        return import_module("imm_tdoa.sequence_filter").SequenceFilter
    raise AttributeError(f"module 'imm_tdoa' has no attribute {name!r}")
