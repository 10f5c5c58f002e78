"""The conformance kit: does a model obey the laws that filters rely on?

For the author of a plug-in, in his own tests:

>>> from imm_tdoa.testing import check_motion_model
>>> from imm_tdoa.models import ConstantVelocity
>>> check_motion_model(ConstantVelocity(psd=1.0))

An AssertionError tells every law that is broken, with its equation, and the simplest values for
which it fails. `imm_tdoa.testing.strategies` has the hypothesis strategies that draw the values.

`exact_posterior` is the exact answer of a small bank, to judge a filter or a smoother by.
"""

from imm_tdoa.testing import strategies
from imm_tdoa.testing.check import (
    broken_laws,
    check_measurement_model,
    check_motion_model,
    measurement_laws,
    motion_laws,
    verdicts,
)
from imm_tdoa.testing.exact import Estimate, ExactPosterior, exact_posterior
from imm_tdoa.testing.laws import BrokenLaw, Law, Verdict
from imm_tdoa.testing.specimen import specimen

__all__ = [
    "BrokenLaw",
    "Estimate",
    "ExactPosterior",
    "Law",
    "Verdict",
    "broken_laws",
    "check_measurement_model",
    "check_motion_model",
    "exact_posterior",
    "measurement_laws",
    "motion_laws",
    "specimen",
    "strategies",
    "verdicts",
]
