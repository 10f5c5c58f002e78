"""What of Source A may be taken as printed instead of as it should be (ALGORITHMS §15)."""

from __future__ import annotations

from typing import Any, Literal, get_args

import attrs

from imm_tdoa import _validate

Sign = Literal["slave-master", "eq8"]
Columns = Literal["zeros", "dt-scaled"]
Noise = Literal["independent", "correlated"]
NoiseCovariance = Literal["full", "diagonal"]
StaticRow = Literal["per-epoch", "recursive"]
Mixing = Literal["birth", "unbiased", "zero"]


def _one_of(kind: Any) -> Any:
    allowed = get_args(kind)

    def check(_: Any, field: Any, value: Any) -> None:
        if value not in allowed:
            raise ValueError(f"{field.name}: expected one of {', '.join(allowed)}, got {value!r}")

    return check


def _density(value: Any) -> float:
    return _validate.non_negative("process_noise", value)


@attrs.frozen(kw_only=True)
class Switches:
    """How the reproduction departs from what is right; the defaults do not, and give Table 1.

    Parameters
    ----------
    tdoa_sign : "slave-master" or "eq8"
        ``"eq8"``: data and predictions of the static estimators as in the paper's (8) and (15),
        master minus slave, while their Jacobian stays that of slave minus master (3). The moving
        filters follow (21) and (29), which agree.
    jacobian : "zeros" or "dt-scaled"
        ``"dt-scaled"``: the paper's (29), which fills the velocity and acceleration columns.
    noise : "independent" or "correlated"
        Errors of the simulated differences: independent as the paper's R supposes, or those that
        differences have which share a master, with the same variance each.
    noise_covariance : "full" or "diagonal"
        The estimators' R: the covariance that the noise has, or its diagonal only, which is the
        paper's. They differ where the noise is correlated.
    process_noise : float
        Density of every motion model's white noise, km² s^-1, s^-3, s^-5 for static, constant
        velocity and constant acceleration; 0 is the paper's (26).
    static : "per-epoch" or "recursive"
        Which static estimator stands beside the paper's figure.
    mixing : "birth", "unbiased" or "zero"
        Which of the mixing rules is compared with the single filters; all are computed.

    Raises
    ------
    ValueError
        A value that is none of these.
    """

    tdoa_sign: Sign = attrs.field(default="slave-master", validator=_one_of(Sign))
    jacobian: Columns = attrs.field(default="zeros", validator=_one_of(Columns))
    noise: Noise = attrs.field(default="independent", validator=_one_of(Noise))
    noise_covariance: NoiseCovariance = attrs.field(
        default="full", validator=_one_of(NoiseCovariance)
    )
    process_noise: float = attrs.field(default=0.0, converter=_density)
    static: StaticRow = attrs.field(default="per-epoch", validator=_one_of(StaticRow))
    mixing: Mixing = attrs.field(default="birth", validator=_one_of(Mixing))
