"""Filtering the sequences of time differences before locating (Source B; ALGORITHMS §6).

>>> from imm_tdoa import SequenceFilter
>>> filtered = SequenceFilter(stations, toa_sigma=3e-9).run(times, tdoa)
"""

from imm_tdoa.sequence_filter.filtered import FilteredSequence
from imm_tdoa.sequence_filter.loop_gain import kappa
from imm_tdoa.sequence_filter.scalar import steady_gain, steady_lag
from imm_tdoa.sequence_filter.stage import SequenceFilter

__all__ = ["FilteredSequence", "SequenceFilter", "kappa", "steady_gain", "steady_lag"]
