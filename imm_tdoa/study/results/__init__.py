"""What a study found: from chunks to figures with their uncertainty, as a Dataset and as tables."""

from imm_tdoa.study.results.collecting import collect, write

__all__ = ["collect", "write"]
