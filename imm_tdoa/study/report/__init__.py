"""What a study means: conclusions in words, pictures, and one HTML page that opens offline."""

from imm_tdoa.study.report.document import write

__all__ = ["write"]
