"""What a tracker is made of: its exchangeable parts and their numbers."""

from __future__ import annotations

from typing import Any, Literal, get_args

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.imm import IMM
from imm_tdoa.tracking.assignment import GlobalNearest
from imm_tdoa.tracking.births import Initiation
from imm_tdoa.tracking.confirmation import Confirmation, SequentialRatio
from imm_tdoa.tracking.deletion import Deletion, Silence
from imm_tdoa.tracking.duplicates import Duplicates, Merging
from imm_tdoa.tracking.gates import gate_probability
from imm_tdoa.tracking.jpda import Jpda
from imm_tdoa.tracking.nearest import Nearest
from imm_tdoa.tracking.pairing import PairedFixes
from imm_tdoa.tracking.rows import Associator

Named = Literal["jpda", "global", "nearest"]


def _associator(value: Any) -> Any:
    if isinstance(value, str):
        _validate.one_of("associator", value, get_args(Named))
    elif isinstance(value, type) or not isinstance(value, Associator):
        raise ValueError(f"associator: expected a name or an associator, got {value!r}")
    return value


def _detection_probability(value: Any) -> float:
    number = _validate.positive("detection_probability", value)
    if not number < 1.0:
        raise ValueError(
            f"detection_probability: expected a probability above 0 and below 1, got {value!r}"
        )
    return number


def _part(kind: type) -> Any:
    def check(_: Any, field: Any, value: Any) -> None:
        if isinstance(value, type) or not callable(value):
            raise ValueError(
                f"{field.name}: expected an instance of {kind.__name__}, got {value!r}"
            )

    return check


@attrs.frozen(eq=False)
class Settings:
    """How a tracker works, every part of it checked.

    Parameters
    ----------
    imm : IMM
        Predicts the tracks and takes their rows in; its measurement says what is measured.
    associator : "global", "jpda", "nearest" or Associator
        Who takes which rows among confirmed tracks.
    initiation : Initiation
        How tracks begin.
    confirmation : Confirmation
        When a track on trial is believed.
    deletion : Deletion
        When a confirmed track ends.
    merging : Merging
        Which tracks repeat others.
    detection_probability, clutter_density, gate_probability : float
        What is measured of a target, and what else is; as `imm_tdoa.Tracker` explains them.
    overload, most_trials, patience, probation, margin : float or int
        When rows are too many, and how long rivals wait; likewise.

    Raises
    ------
    ValueError
        A part that does not do its work, a number out of its range, an IMM with a robust rule.
    """

    imm: IMM
    associator: Associator | Named = attrs.field(
        default="global", kw_only=True, converter=_associator
    )
    detection_probability: float = attrs.field(
        default=0.9, kw_only=True, converter=_detection_probability
    )
    initiation: Initiation = attrs.field(kw_only=True, validator=_part(Initiation))
    confirmation: Confirmation = attrs.field(
        factory=SequentialRatio, kw_only=True, validator=_part(Confirmation)
    )
    deletion: Deletion = attrs.field(factory=Silence, kw_only=True, validator=_part(Deletion))
    merging: Merging = attrs.field(factory=Duplicates, kw_only=True, validator=_part(Merging))
    clutter_density: Any = attrs.field(default=None, kw_only=True)
    gate_probability: float = attrs.field(default=0.9999, kw_only=True, converter=gate_probability)
    overload: float = attrs.field(default=20.0, kw_only=True)
    most_trials: int = attrs.field(default=400, kw_only=True)
    patience: int = attrs.field(default=8, kw_only=True)
    probation: int = attrs.field(default=25, kw_only=True)
    margin: float = attrs.field(default=6.0, kw_only=True)

    @initiation.default
    def _paired_fixes(self) -> Initiation:
        return PairedFixes(detection_probability=self.detection_probability)

    def __attrs_post_init__(self) -> None:
        if self.imm.robust is not None:
            raise ValueError(
                f"imm: robust = {self.imm.robust!r} is for rows of which it is known whose they "
                f"are: it makes another emitter's rows fit by leaving out what does not; without "
                f"labels association leaves such rows to others (gate_probability)"
            )
        if self.clutter_density is not None:
            density = _validate.array("clutter_density", self.clutter_density)
            size = self.imm.measurement.size
            if density.shape not in ((), (size,)) or np.any(density <= 0.0):
                raise ValueError(
                    f"clutter_density: expected one density above 0 or {size} of them, "
                    f"got {self.clutter_density!r}"
                )
            object.__setattr__(self, "clutter_density", np.broadcast_to(density, (size,)).copy())
        if not _validate.positive("overload", self.overload) > 1.0:
            raise ValueError(f"overload: expected a factor above 1, got {self.overload!r}")
        for name in ("most_trials", "patience", "probation"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")
        _validate.non_negative("margin", self.margin)

    def associate(self, density: Array) -> Associator:
        """Return the associator of confirmed tracks where false values are so dense (m,)."""
        if self.associator == "jpda":
            return Jpda(
                self.detection_probability,
                density,
                gate_probability=self.gate_probability,
                permutations="best",
            )
        if self.associator == "global":
            return GlobalNearest(gate_probability=self.gate_probability)
        if self.associator == "nearest":
            return Nearest()
        assert not isinstance(self.associator, str)
        return self.associator
