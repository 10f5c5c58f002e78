"""When a confirmed track ends."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.contract import Array
from imm_tdoa.tracking.standing import REMEMBERED, Standing, Verdict


@runtime_checkable
class Deletion(Protocol):
    """Anything that ends confirmed tracks."""

    def __call__(self, standing: Standing, position_std: Array) -> Verdict:
        """Return which confirmed tracks end, and why; `position_std` (N,) m says how vague."""
        ...


@attrs.frozen
class Silence:
    """A confirmed track coasts through gaps, and ends when it was heard too seldom for too long.

    Parameters
    ----------
    hits, scans : int
        It ends with fewer than `hits` hits in the last `scans` scans in which it could be heard.
    seconds : float
        It ends when nothing was heard of it for so long, s.
    position_std : float, optional
        It ends when its position is less certain than that, m (root mean square of all axes).
    """

    hits: int = attrs.field(default=2, kw_only=True)
    scans: int = attrs.field(default=12, kw_only=True)
    seconds: float = attrs.field(default=300.0, kw_only=True)
    position_std: float | None = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        for name, value in (("hits", self.hits), ("scans", self.scans)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")
        if not self.hits <= self.scans <= REMEMBERED:
            raise ValueError(
                f"scans: expected at least {self.hits} (hits) and at most {REMEMBERED}, "
                f"got {self.scans!r}"
            )
        _validate.positive("seconds", self.seconds)
        if self.position_std is not None:
            _validate.positive("position_std", self.position_std)

    def __call__(self, standing: Standing, position_std: Array) -> Verdict:
        """Return who ends."""
        vague = np.inf if self.position_std is None else self.position_std
        seldom = (standing.chances >= self.scans) & (standing.hits_in(self.scans) < self.hits)
        return Verdict.of(
            np.zeros(len(position_std), dtype=bool),
            (seldom, f"fewer than {self.hits} of {self.scans} scans heard it"),
            (standing.time - standing.heard > self.seconds, f"silent for {self.seconds:g} s"),
            (position_std > vague, f"less certain than {vague:g} m"),
        )
