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
        study,
        testing,
        tracking,
    )
    from imm_tdoa.constant_receivers import ConstantReceivers
    from imm_tdoa.gaussian_sum import GaussianSum
    from imm_tdoa.recording import Recording
    from imm_tdoa.sequence_filter import SequenceFilter
    from imm_tdoa.tracking import Tracker

_MODULES = (
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
    "study",
    "testing",
    "tracking",
)
_CLASSES = {
    "ConstantReceivers": "constant_receivers",
    "GaussianSum": "gaussian_sum",
    "Recording": "recording",
    "SequenceFilter": "sequence_filter",
    "Tracker": "tracking",
}

__version__ = "0.1.0"
__all__ = [
    "IMM",
    "Bank",
    "ConstantReceivers",
    "GaussianSum",
    "Recording",
    "SequenceFilter",
    "Stations",
    "Track",
    "Tracker",
    "bounds",
    "gaussian_sum",
    "interop",
    "locate",
    "metrics",
    "plot",
    "recording",
    "selection",
    "simulate",
    "study",
    "testing",
    "tracking",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for, and not before."""
    if name in _MODULES:
        return import_module(f"imm_tdoa.{name}")
    if name in _CLASSES:
        return getattr(import_module(f"imm_tdoa.{_CLASSES[name]}"), name)
    raise AttributeError(f"module 'imm_tdoa' has no attribute {name!r}")
