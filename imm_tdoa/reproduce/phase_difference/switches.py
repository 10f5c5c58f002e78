"""What may be done the source's way (ALGORITHMS §15)."""

from __future__ import annotations

from typing import Literal, get_args

import attrs

from imm_tdoa import _validate

Shape = Literal["correlated", "diagonal"]
Merging = Literal["euclidean", "mahalanobis"]


@attrs.frozen
class Switches:
    """How the Gaussian sum is made; the defaults are what is right.

    Attributes
    ----------
    covariance : "correlated" or "diagonal"
        Whether a starting component's range goes with its bearing, as the phase rate makes it,
        or is taken for independent of it, as in the source (§7.1-4).
    merging : "euclidean" or "mahalanobis"
        Distance under which components are merged: 3 km between means, or 1 sigma times the root
        of the share of weight.
    platform_noise : bool
        Whether errors of the platform's position and velocity are in R (§7.3); they are in the
        data either way.
    """

    covariance: Shape = "correlated"
    merging: Merging = "euclidean"
    platform_noise: bool = True

    def __attrs_post_init__(self) -> None:
        _validate.one_of("covariance", self.covariance, get_args(Shape))
        _validate.one_of("merging", self.merging, get_args(Merging))
        if not isinstance(self.platform_noise, bool):
            raise ValueError(f"platform_noise: expected True or False, got {self.platform_noise!r}")
