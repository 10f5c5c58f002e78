"""When a track on trial is believed, and when it is given up."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.tracking.standing import REMEMBERED, Standing, Verdict


@runtime_checkable
class Confirmation(Protocol):
    """Anything that decides on tracks on trial."""

    def __call__(self, standing: Standing) -> Verdict:
        """Return which of the tracks on trial are confirmed and which end, and why."""
        ...


@attrs.frozen
class Hits:
    """M of N: confirmed with `hits` hits among the last `scans` scans.

    A track on trial ends when it can no longer get so many in its first `scans` scans, or when
    nothing was heard of it for too long.

    Parameters
    ----------
    hits, scans : int
        M and N. The two fixes that a track began from count as one hit.
    seconds : float
        Longest silence of a track on trial, s.
    """

    hits: int = attrs.field(default=3, kw_only=True)
    scans: int = attrs.field(default=5, kw_only=True)
    seconds: float = attrs.field(default=120.0, kw_only=True)

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

    def __call__(self, standing: Standing) -> Verdict:
        """Return who is confirmed and who ends."""
        got = standing.hits_in(self.scans)
        missed = np.minimum(standing.chances, self.scans) - got
        return Verdict.of(
            got >= self.hits,
            (missed > self.scans - self.hits, f"fewer than {self.hits} of {self.scans} scans hit"),
            (standing.time - standing.heard > self.seconds, "nothing heard while on trial"),
        )


@attrs.frozen
class SequentialRatio:
    """Sequential probability ratio test (Wald 1945): the rows are a target's, or they are false.

    The ratio grows by the likelihood of each row taken over the density of false values, and
    falls by the probability of missing each row that was not.

    Parameters
    ----------
    false_alarm : float
        Probability that a track of false values is confirmed: the upper threshold is
        log((1 - miss) / false_alarm).
    miss : float
        Probability that a target's track is given up: the lower is log(miss / (1 - false_alarm)).
    scans : int
        Longest trial, in scans that could hear it.
    seconds : float
        Longest silence of a track on trial, s.
    least_hits : int
        Scans that must have heard it besides those it began from, however high the ratio.
    """

    false_alarm: float = attrs.field(default=1e-4, kw_only=True)
    miss: float = attrs.field(default=1e-2, kw_only=True)
    scans: int = attrs.field(default=15, kw_only=True)
    seconds: float = attrs.field(default=120.0, kw_only=True)
    least_hits: int = attrs.field(default=1, kw_only=True)

    def __attrs_post_init__(self) -> None:
        for name, value in (("false_alarm", self.false_alarm), ("miss", self.miss)):
            if not _validate.positive(name, value) < 0.5:
                raise ValueError(f"{name}: expected a probability below 0.5, got {value!r}")
        for name, value in (("scans", self.scans), ("least_hits", self.least_hits)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")
        _validate.positive("seconds", self.seconds)

    def __call__(self, standing: Standing) -> Verdict:
        """Return who is confirmed and who ends."""
        upper = np.log((1.0 - self.miss) / self.false_alarm)
        lower = np.log(self.miss / (1.0 - self.false_alarm))
        enough = standing.hits_in(REMEMBERED) > self.least_hits  # the first is its beginning
        return Verdict.of(
            (standing.log_ratio >= upper) & enough,
            (standing.log_ratio <= lower, "its rows look false"),
            (
                (standing.chances > self.scans) & (standing.log_ratio < upper),
                f"undecided after {self.scans} scans",
            ),
            (standing.time - standing.heard > self.seconds, "nothing heard while on trial"),
        )
