"""Which motion was it? Motion models weighed against each other on the same measurements.

>>> found = compare([Static(psd=0.0), ConstantVelocity(psd=0.0)], measurement, times, values)
>>> print(found)
>>> found.verdict, found.margin, found.probability
"""

from imm_tdoa.selection.best_fit import MaximumLikelihood, maximum_likelihood
from imm_tdoa.selection.comparing import compare
from imm_tdoa.selection.comparison import Comparison
from imm_tdoa.selection.discrimination_table import Discrimination, discrimination
from imm_tdoa.selection.evidence import strength

__all__ = [
    "Comparison",
    "Discrimination",
    "MaximumLikelihood",
    "compare",
    "discrimination",
    "maximum_likelihood",
    "strength",
]
